"""Stability margins of a sampled loop: gain, phase and delay margin, and largest sensitivity."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

POINTS = 1000
"""Number of frequencies of a response."""

LOWEST = 0.025
"""Lowest frequency, rad per time scale of the rig: there the integrator dominates the loop."""


@dataclass(frozen=True)
class Margins:
    """Margins of a loop.

    `gain`: factor by which the loop's gain may increase; `reduction`: factor to which it may decrease (0: without limit).
    `phase` deg, at the `crossover` rad/s. `delay` s: additional dead time at the stability limit. `sensitivity`: largest
    |1 / (1 + L)|, the worst amplification of a disturbance. None: the loop has no such crossing.
    """

    stable: bool
    gain: float | None
    reduction: float
    phase: float | None
    crossover: float | None
    delay: float | None
    sensitivity: float


def frequencies(dt: float, time_scale: float) -> np.ndarray:
    """(POINTS,) rad/s, from far below the bandwidth of a rig of `time_scale` [s] to the Nyquist frequency."""
    return np.geomspace(LOWEST / time_scale, np.pi / dt * (1.0 - 1e-9), POINTS)


def margins(omega: np.ndarray, loop: np.ndarray, integrators: int = 1) -> Margins:
    """Margins of the open loop's response `loop` (n,) at `omega` (n,) rad/s, a grid fine enough to resolve its phase.

    The open loop must be stable except for its `integrators`. The closed loop is stable if the angle of 1 + L goes from -90 deg
    for each integrator, at low frequencies, to 0 at the highest (Nyquist).
    """
    ends = np.angle(1.0 + loop[-1])
    stable = bool(holds(loop, integrators) and abs(ends) < np.pi / 2.0)
    at, size = _crossings(loop.imag, np.log(omega), np.where(loop.real < 0.0, np.log(np.abs(loop)), np.nan))
    up, down = size[size < 0.0], size[size >= 0.0]
    at, angle = _crossings(np.log(np.abs(loop)), np.log(omega), np.unwrap(np.angle(loop)))
    at, phase = np.exp(at), np.mod(np.degrees(angle) + 180.0, 360.0)
    delay = np.radians(phase) / at
    near = np.minimum(phase, 360.0 - phase)
    first = int(np.argmin(near)) if len(near) else None
    return Margins(
        stable=stable,
        gain=float(np.exp(-up.max())) if len(up) else None,
        reduction=float(np.exp(-down.min())) if len(down) else 0.0,
        phase=None if first is None else float(near[first]),
        crossover=None if first is None else float(at[first]),
        delay=float(delay.min()) if len(delay) else None,
        sensitivity=float(1.0 / np.abs(1.0 + loop).min()),
    )


def holds(loop: np.ndarray, integrators: int | np.ndarray = 1) -> bool:
    """Whether all closed loops of the open loops (..., m), with so many `integrators` each, are stable, as in `margins`."""
    from_critical = 1.0 + loop
    turned = np.angle(from_critical[..., 1:] * from_critical[..., :-1].conj()).sum(axis=-1)
    return bool((np.abs(turned - integrators * np.pi / 2.0) < np.pi / 2.0).all())


def _crossings(values: np.ndarray, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """x and y, linearly interpolated, at the zeros of `values`; each (n,). Zeros at which y is NaN are left out."""
    k = np.flatnonzero(np.sign(values[:-1]) * np.sign(values[1:]) < 0.0)
    share = values[k] / (values[k] - values[k + 1])
    found_x, found_y = (each[k] + share * (each[k + 1] - each[k]) for each in (x, y))
    known = np.isfinite(found_y)
    return found_x[known], found_y[known]


def least(found: Sequence[Margins]) -> Margins | None:
    """The worst of each margin over several loops; None for no loop."""
    if not found:
        return None

    def smallest(name: str) -> float | None:
        return min((v for m in found if (v := getattr(m, name)) is not None), default=None)

    return Margins(
        stable=all(m.stable for m in found),
        gain=smallest("gain"),
        reduction=max(m.reduction for m in found),
        phase=smallest("phase"),
        crossover=smallest("crossover"),
        delay=smallest("delay"),
        sensitivity=max(m.sensitivity for m in found),
    )
