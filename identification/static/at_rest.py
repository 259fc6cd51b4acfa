"""What steady points tell of a model's parameters: of the thrust map alone, and of what bends it."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from identification.fit.problem import Prior
from identification.static.static_map import ROUNDING, StaticFit, regression
from vpp_fmu.campaign import StaticMap
from vpp_fmu.kernel.plant import BETA_REF, OMEGA_REF
from vpp_fmu.kernel.types import Effect, Model
from vpp_fmu.native import Simulator

STEPS, NEARER = 8, 1e-4
"""Steps of Gauss and Newton at most, and the share of the sum of squares that one must bring for the next."""

SAME = 1e-6
"""Share of a speed as which another one counts."""

Knowledge = Callable[[Model, Mapping[str, float], Sequence[str]], Prior | None]
"""What is known beforehand of a model's free parameters, by name, about their values."""


@dataclass(frozen=True)
class AtRest:
    """Steady points of a campaign as knowledge; `fit`: of the paper's map to them; `scales`: the parameters of its
    normalisation, by name.

    Called with a model, values and the names of what is free, it gives what the points tell of these beside the model's
    effects: a map whose polynomial was fitted to points that a further term has bent has wrong coefficients, and is sure of
    them. So the term is fitted to the points with them. An effect with memory, or of the reading, is not: nobody says how long
    a point was held, or when the cell was tared.
    """

    static: StaticMap
    fit: StaticFit
    scales: Mapping[str, float]

    def __call__(self, model: Model, values: Mapping[str, float], names: Sequence[str]) -> Prior | None:
        """None where the points tell nothing of `names`."""
        coefficients = self.fit.coefficients
        alone = Prior(tuple(coefficients), np.array(list(coefficients.values())), self.fit.covariance).of(names)
        bending = {e.full(p.name) for e in model.effects if _at_once(e) for p in e.parameters}.intersection(names)
        bending -= set(coefficients)
        if alone is None or not bending:
            return alone
        still = {e.full(n): v for e in model.effects if not _at_once(e) for n, v in (e.off or {}).items()}
        return self._together(model, {**values, **still}, names, bending) or alone

    def _together(self, model, values, names, bending) -> Prior | None:
        """Of coefficients and of what bends the map, about where both fit the points best; None where they do not hold it."""
        known = regression(self.static, self.scales, self.fit.pitch)
        weight, thrust = known.weight / self.scales["thrust_scale"], self.static.thrust[known.used]
        simulator, start = Simulator(model, names), {**values, **self.fit.coefficients}
        shown, slopes = self._settled(simulator, start, known.used)
        told = [n for n, column in zip(names, slopes.T, strict=True) if column.any()]
        free = [n for n in told if n in self.fit.coefficients or n in bending]
        same_speed = np.allclose(shown[:, 1], self.static.omega[known.used], rtol=SAME)
        if bending.isdisjoint(free) or not same_speed or len(thrust) <= len(free):
            return None
        columns, bounds = [list(names).index(n) for n in free], {p.name: p for p in model.parameters}
        lower, upper = (np.array([getattr(bounds[n], side) for n in free]) for side in ("minimum", "maximum"))
        wide = upper - lower  # what the points leave open stays within its bounds

        def at(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            """Residual, and its derivatives in units of `wide`."""
            shown, slopes = self._settled(simulator, {**start, **dict(zip(free, x, strict=True))}, known.used)
            return weight * (shown[:, 0] - thrust), weight[:, None] * slopes[:, columns] * wide

        def scatter(left: np.ndarray) -> float:
            return max(float(left @ left) / (len(left) - len(free)), ROUNDING)

        x = np.array([start[n] for n in free])
        left, slopes = at(x)
        for _ in range(STEPS):
            normal = slopes.T @ slopes + scatter(left) * np.eye(len(free))
            there = np.clip(x - wide * np.linalg.solve(normal, slopes.T @ left), lower, upper)
            nearer, steeper = at(there)
            fell = 1.0 - float(nearer @ nearer) / max(float(left @ left), 1e-300)
            if fell > 0.0:
                x, left, slopes = there, nearer, steeper
            if fell < NEARER:
                break
        covariance = np.linalg.inv(slopes.T @ slopes / scatter(left) + np.eye(len(free)))
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
    """Whether what an effect does to the thrust is there as soon as commands rest."""
    return not (effect.reading or effect.states or effect.delays or effect.inputs)
