"""Prior of a model's parameters from steady points: of the thrust map, and of memoryless effects that change it."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from identification.fit.problem import Prior
from identification.static.static_map import ROUNDING, StaticFit, regression
from vpp_fmu.campaign import StaticMap
from vpp_fmu.kernel.signals import BETA_REF, OMEGA_REF
from vpp_fmu.kernel.types import Effect, Model
from vpp_fmu.native import Simulator

STEPS, NEARER = 8, 1e-4
"""Maximum number of Gauss-Newton steps, and minimum relative decrease of the sum of squares to continue."""

SAME = 1e-6
"""Relative tolerance of equal speeds."""

Knowledge = Callable[[Model, Mapping[str, float], Sequence[str]], Prior | None]
"""Gives the prior of a model's free parameters, by name, near their values."""


@dataclass(frozen=True)
class AtRest:
    """Steady points of a campaign as prior; `fit`: the paper's map fitted to them; `scales`: the parameters of its
    normalisation, by name.

    Called with a model, values and the names of free parameters, it gives their prior in the presence of the model's effects.
    If an effect changes the map, a fit of the polynomial alone is biased, with too small a covariance. So the effect is fitted
    to the points together with the coefficients. Effects with memory, or of the reading, are not: it is unknown how long a
    point was held, or when the cell was tared.
    """

    static: StaticMap
    fit: StaticFit
    scales: Mapping[str, float]

    def __call__(self, model: Model, values: Mapping[str, float], names: Sequence[str]) -> Prior | None:
        """None if the points determine none of `names`."""
        coefficients = self.fit.coefficients
        of_map = Prior(tuple(coefficients), np.array(list(coefficients.values())), self.fit.covariance).of(names)
        bending = {e.full(p.name) for e in model.effects if _at_once(e) for p in e.parameters}.intersection(names)
        bending -= set(coefficients)
        if of_map is None or not bending:
            return of_map
        still = {e.full(n): v for e in model.effects if not _at_once(e) for n, v in (e.off or {}).items()}
        return self._together(model, {**values, **still}, names, bending) or of_map

    def _together(self, model, values, names, bending) -> Prior | None:
        """Prior of the coefficients and of the parameters `bending`, from their joint fit; None if the points cannot determine
        it."""
        known = regression(self.static, self.scales, self.fit.pitch)
        weight, thrust = known.weight / self.scales["thrust_scale"], self.static.thrust[known.used]
        simulator, start = Simulator(model, names), {**values, **self.fit.coefficients}
        shown, slopes = self._settled(simulator, start, known.used)
        determined = [n for n, column in zip(names, slopes.T, strict=True) if column.any()]
        free = [n for n in determined if n in self.fit.coefficients or n in bending]
        same_speed = np.allclose(shown[:, 1], self.static.omega[known.used], rtol=SAME)
        if bending.isdisjoint(free) or not same_speed or len(thrust) <= len(free):
            return None
        columns, bounds = [list(names).index(n) for n in free], {p.name: p for p in model.parameters}
        lower, upper = (np.array([getattr(bounds[n], side) for n in free]) for side in ("minimum", "maximum"))
        wide = upper - lower  # the bounds are a weak prior of undetermined parameters

        def at(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            """Residual, and its derivatives in units of `wide`."""
            shown, slopes = self._settled(simulator, {**start, **dict(zip(free, x, strict=True))}, known.used)
            return weight * (shown[:, 0] - thrust), weight[:, None] * slopes[:, columns] * wide

        def scatter(residual: np.ndarray) -> float:
            return max(float(residual @ residual) / (len(residual) - len(free)), ROUNDING)

        x = np.array([start[n] for n in free])
        residual, slopes = at(x)
        for _ in range(STEPS):
            normal = slopes.T @ slopes + scatter(residual) * np.eye(len(free))
            there = np.clip(x - wide * np.linalg.solve(normal, slopes.T @ residual), lower, upper)
            nearer, steeper = at(there)
            decrease = 1.0 - float(nearer @ nearer) / max(float(residual @ residual), 1e-300)
            if decrease > 0.0:
                x, residual, slopes = there, nearer, steeper
            if decrease < NEARER:
                break
        covariance = np.linalg.inv(slopes.T @ slopes / scatter(residual) + np.eye(len(free)))
        return Prior(tuple(free), x, covariance * np.outer(wide, wide))

    def _settled(self, simulator: Simulator, values: Mapping[str, float], used: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(outputs (points, 3), derivatives of the thrust (points, k)) at the speeds and pitches of the points."""
        outputs, slopes = [], []
        for speed, pitch in zip(self.static.omega[used], self.static.beta_ref[used], strict=True):
            inputs = {OMEGA_REF.name: np.array([speed]), BETA_REF.name: np.array([pitch])}
            shown, tangents = simulator.sensitivities(values, inputs, np.zeros(0))
            outputs.append(shown[0])
            slopes.append(tangents[0, 0])
        return np.array(outputs), np.array(slopes)


def _at_once(effect: Effect) -> bool:
    """Whether an effect changes the thrust without memory."""
    return not (effect.reading or effect.states or effect.delays or effect.inputs)
