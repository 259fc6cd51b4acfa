"""One step of effects that declare the derivatives of their states.

    euler   x + h f(x),                                        error of a run ~ h
    rk4     x + h (k1 + 2 k2 + 2 k3 + k4) / 6,                 error of a run ~ h^4     (Kutta 1901)
    exact   x + h phi(h J) f(x),  phi(Z) = (e^Z - 1) / Z,  J = df/dx    (exponential Rosenbrock-Euler)

The first two take all effects of a chain together, and the signals between them at the time of each stage. The last takes an
effect alone, under held signals: it is exact where f is linear in the states, for any step, and of second order elsewhere
(Hochbruck and Ostermann, Acta Numerica 19, 2010). phi by its series at Z / 2^k, |Z / 2^k| <= 1/2, then k times
phi(2Z) = phi(Z) (e^Z + 1) / 2.
"""

from collections.abc import Callable, Collection, Mapping
from types import SimpleNamespace
from typing import Any

from vpp_fmu.kernel.duals import Duals
from vpp_fmu.kernel.vector import Vector

METHODS = ("rk4", "euler", "exact")

LARGEST_EXACT = 6
"""Most states of the method "exact", whose operations grow with the cube of their number."""

TERMS = 14
"""Terms of the series: 0.5**14 / 15! < 1e-16."""

HALVINGS = 20
"""Largest k: |h J| up to 5e5, in the norm of the largest row sum."""


def run_stages(rates: Callable, states: Mapping[str, Any], h: Any, euler: Collection[str]) -> dict[str, Any]:
    """The states after h s by Runge-Kutta's method, those named in `euler` by Euler's.

    `rates(c, at)`: the derivatives after c s, with states `at`; c None: at the start.
    """
    k1 = rates(None, {})

    def ahead(c: Any, k: Mapping) -> dict:
        return {name: states[name] + c * (k1 if name in euler else k)[name] for name in k1}

    if len(euler) == len(k1):
        return ahead(h, k1)
    k2 = rates(0.5 * h, ahead(0.5 * h, k1))
    k3 = rates(0.5 * h, ahead(0.5 * h, k2))
    k4 = rates(h, ahead(h, k3))
    mean = {name: (k1[name] + 2.0 * (k2[name] + k3[name]) + k4[name]) / 6.0 for name in k1}
    return ahead(h, mean)


def exact_step(e: Any, ops: Any, s: Any, x: SimpleNamespace, p: Any, h: Any) -> dict:
    """The states of an effect `e` of the method "exact" after h s: of those that no signal closes."""
    names = [q.name for q in e.states if q.closed_by is None]
    values = [a for name in names for a in _listed(getattr(x, name))]
    n = len(values)
    duals = Duals(ops, n)
    seeded = [duals.seeded(a, i) for i, a in enumerate(values)]
    at = SimpleNamespace(**{**vars(duals.constants(x)), **_placed(x, names, seeded)})
    rates = e.derivative(duals, duals.constants(s), at, duals.constants(p))
    slopes = [duals.constant(a) for name in names for a in _listed(rates[name])]
    z = [[0.0 if d is None else h * d for d in a.tangents] for a in slopes]
    step = _times(_phi(ops, z), [[a.value] for a in slopes])
    return _placed(x, names, [a + h * row[0] for a, row in zip(values, step, strict=True)])


def _placed(x: SimpleNamespace, names: list, values: list) -> dict:
    """Values by the names of the states; vectors as such."""
    rest = iter(values)
    return {
        name: Vector(next(rest) for _ in old) if isinstance(old, tuple) else next(rest)
        for name in names
        for old in [getattr(x, name)]
    }


def _listed(value: Any) -> list:
    return list(value) if isinstance(value, list | tuple) else [value]


def _phi(ops: Any, z: list) -> list:
    """phi of a square matrix (n, n)."""
    n = len(z)
    one = [[1.0 if i == j else 0.0 for j in range(n)] for i in range(n)]
    size = ops.maximum(0.0, *(_sum([ops.abs(a) for a in row]) for row in z))
    share, halved = 1.0, []
    for _ in range(HALVINGS):
        halved.append(size * share > 0.5)
        share = ops.where(halved[-1], 0.5 * share, share)
    small = [[a * share if not _is_zero(a) else 0.0 for a in row] for row in z]
    series = one
    for k in range(TERMS, 1, -1):
        product = _times(small, series)
        series = [[one[i][j] + product[i][j] / float(k) for j in range(n)] for i in range(n)]
    for again in reversed(halved):
        power = _times(small, series)  # e^Z - 1
        doubled = [
            [a + 0.5 * b for a, b in zip(*rows, strict=True)] for rows in zip(series, _times(series, power), strict=True)
        ]
        series = [[ops.where(again, a, b) for a, b in zip(*rows, strict=True)] for rows in zip(doubled, series, strict=True)]
        small = [[ops.where(again, 2.0 * a, a) if not _is_zero(a) else 0.0 for a in row] for row in small]
    return series


def _times(a: list, b: list) -> list:
    columns = list(zip(*b, strict=True))
    return [[_dot(row, column) for column in columns] for row in a]


def _dot(row: list, column: tuple) -> Any:
    return _sum([x * y for x, y in zip(row, column, strict=True) if not (_is_zero(x) or _is_zero(y))])


def _sum(values: list) -> Any:
    total = values[0] if values else 0.0
    for value in values[1:]:
        total = total + value
    return total


def _is_zero(x: Any) -> bool:
    """Whether it is the number 0 in every run: the structure must not depend on the numbers."""
    return type(x) is float and x == 0.0
