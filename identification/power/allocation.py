"""Allocation: for each thrust the pair of speed and pitch of least power, within the rig's limits.

Many pairs give the same thrust (paper, section 1). The settled thrust of the plant gives the pairs, the power map their power.
Instead of power alone, a weight also counts the reserve: how much thrust pitch alone, the fast actuator, can add and remove.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.interpolate import RectBivariateSpline
from scipy.optimize import minimize_scalar

from identification.fit.uncertainty import NORMAL_95
from identification.power.model import PowerModel
from identification.tune.controllers import rig_controller
from vpp_fmu.errors import BadInput
from vpp_fmu.kernel.effects.dual_pid import ALLOCATED, PAIRS
from vpp_fmu.kernel.ops import NUMBERS
from vpp_fmu.kernel.types import start
from vpp_fmu.parameters import ParameterSet

NODES = 41
"""Speeds, and pitches, at which the plant is settled: the spline between them is exact for the paper's map."""

SPEEDS, PITCHES = 401, 121
"""Fine grid on which pairs of equal thrust are found before they are refined."""

DRAWS = 300
"""Draws of the power's parameters for the bands of speed and pitch."""

BAND = (0.025, 0.975)
"""Quantiles of a 95 % band."""

SLOWER = 5.0
"""Ratio of the time in which speed takes over from pitch to the sum of lags of the slower channel."""

UNREACHED = 10.0
"""Cost of a pitch at which no speed gives the thrust: far above any other, which is about 1 at most."""


@dataclass(frozen=True, eq=False)
class Surface:
    """Settled thrust [N] of a plant over speed [rpm] and pitch [deg], between the limits `speed` and `pitch`."""

    speed: tuple[float, float]
    pitch: tuple[float, float]
    spline: RectBivariateSpline

    @classmethod
    def of(cls, parameters: ParameterSet) -> "Surface":
        """Of a plant with its effects, on its rig. BadInput for a rig whose speed or pitch is fixed."""
        rig = parameters.rig
        for name, (low, high) in (("speed", rig.speed), ("pitch", rig.pitch)):
            if not low < high:
                raise BadInput(
                    "parameters", f"range of {name}", f"{low:g}, fixed", "a range: with a fixed one there is no pair to choose"
                )
        model, values = parameters.model, parameters.values
        rest = {u.name: u.start for u in model.inputs} | model.measured_inputs
        speeds, pitches = np.linspace(*rig.speed, NODES), np.linspace(*rig.pitch, NODES)
        thrust = [
            [start(model, NUMBERS, rest | {"omega_ref": float(w), "beta_ref": float(b)}, values)[0]["thrust"] for b in pitches]
            for w in speeds
        ]
        return cls(rig.speed, rig.pitch, RectBivariateSpline(speeds, pitches, np.array(thrust)))

    def at(self, omega, beta) -> np.ndarray:
        """Thrust [N] at pairs, which broadcast."""
        return self.spline.ev(omega, beta)

    @cached_property
    def grid(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(speeds (m,), pitches (k,), thrust (m, k)) on the fine grid."""
        speeds, pitches = np.linspace(*self.speed, SPEEDS), np.linspace(*self.pitch, PITCHES)
        return speeds, pitches, self.spline(speeds, pitches)

    def speeds_of(self, thrust: np.ndarray, pitches: np.ndarray) -> np.ndarray:
        """Lowest speed [rpm] (n, k) that gives each thrust (n,) at each pitch (k,); NaN where none does."""
        speeds, found = self.grid[0], []
        for column in self.spline(speeds, pitches).T:
            highest = np.maximum.accumulate(column)
            kept = np.append(True, np.diff(highest) > 0.0)
            found.append(np.interp(thrust, highest[kept], speeds[kept], left=np.nan, right=np.nan))
        return np.array(found).T

    def reserve(self, omega, beta) -> np.ndarray:
        """Thrust [N] that pitch alone can both add and remove at pairs; negative pitch of more thrust counts, too."""
        _, pitches, _ = self.grid
        ends = self.spline.ev(np.asarray(omega)[..., None], pitches)
        now = self.at(omega, beta)
        return np.minimum(ends.max(axis=-1) - now, now - ends.min(axis=-1))


@dataclass(frozen=True, eq=False)
class Allocation:
    """The best pair for each `thrust` (n,) [N]: `omega` [rpm], `beta` [deg], `power` [W], `reserve` [N], each (n,).

    `power_std` (n,) [W]: standard error of the least power. `omega_band`, `beta_band` (n, 2): 95 % of the best pairs under the
    uncertainty of the power. `fixed_beta`, `fixed` (n,): pitch and power of the best fixed pitch, NaN where it does not
    reach the thrust. `weight`: 0 counts power alone, 1 the reserve alone.
    """

    surface: Surface
    model: PowerModel
    weight: float
    thrust: np.ndarray
    omega: np.ndarray
    beta: np.ndarray
    power: np.ndarray
    power_std: np.ndarray
    omega_band: np.ndarray
    beta_band: np.ndarray
    reserve: np.ndarray
    fixed_beta: float
    fixed: np.ndarray

    @property
    def saving(self) -> float:
        """Mean share of the power that the pairs save against the best fixed pitch, over the thrusts that it reaches."""
        there = np.isfinite(self.fixed)
        return float(1.0 - np.mean(self.power[there]) / np.mean(self.fixed[there])) if there.any() else 0.0


def allocate(parameters: ParameterSet, power: PowerModel, weight: float = 0.0, count: int = 41, seed: int = 0) -> Allocation:
    """The best pairs of `count` thrusts, from the least above 0 to the greatest that the rig reaches.

    Minimised is (1 - weight) power / greatest power - weight reserve / greatest thrust. The band of the least power follows
    from the envelope theorem: to first order, a moved optimum does not change it. BadInput if the map does not give a positive
    power at a pair.
    """
    surface = Surface.of(parameters)
    speeds, pitches, grid = surface.grid
    watts = power.at(*np.meshgrid(speeds, pitches, indexing="ij"))
    highest, most = float(watts.max()), float(grid.max())
    if most <= 0.0:
        raise BadInput("parameters", "settled thrust", f"at most {most:.4g} N within the rig's limits", "more than 0 N")
    thrusts = np.linspace(max(float(grid.min()), 0.0), most, count + 1)[1:]
    none, draws = np.zeros(len(power.names)), np.zeros((DRAWS, len(power.names)))
    if len(none):
        draws = np.random.default_rng(seed).multivariate_normal(none, power.covariance, DRAWS, method="eigh")

    def cost(watts, reserve):
        return (1.0 - weight) * watts / highest - weight * reserve / most

    reached = surface.speeds_of(thrusts, pitches)
    taken = power.at(reached, np.broadcast_to(pitches, reached.shape))
    best, low, high = (np.empty((2, count)) for _ in range(3))
    for k, thrust in enumerate(thrusts):
        there = np.isfinite(reached[k])
        omega, beta = reached[k, there], pitches[there]
        spare = surface.reserve(omega, beta)
        best[:, k] = _refined(surface, power, cost, thrust, float(beta[np.argmin(cost(taken[k, there], spare))]))
        drawn = np.argmin(cost(taken[k, there, None] + power.gradient(omega, beta) @ draws.T, spare[:, None]), axis=0)
        ends = np.quantile([omega[drawn], beta[drawn]], BAND, axis=1)
        # Drawn pairs are on the grid, the best is between.
        low[:, k], high[:, k] = np.minimum(ends[0], best[:, k]), np.maximum(ends[1], best[:, k])
    omega, beta = best
    watts = power.at(omega, beta)
    if (least := float(watts.min())) <= 0.0:
        k = int(np.argmin(watts))
        where = f"{least:.4g} W at {omega[k]:.4g} rpm, {beta[k]:.4g} deg"
        raise BadInput("parameters", "power", where, "a positive power", "steady points measured there")
    # The best fixed pitch has the least mean power, among those that reach the most thrusts.
    counts = np.isfinite(taken).sum(axis=0)
    fixed = min(np.flatnonzero(counts == counts.max()).tolist(), key=lambda k: float(np.nansum(taken[:, k])))
    return Allocation(
        surface,
        power,
        weight,
        thrusts,
        omega,
        beta,
        watts,
        power.std(omega, beta),
        np.column_stack([low[0], high[0]]),
        np.column_stack([low[1], high[1]]),
        surface.reserve(omega, beta),
        float(pitches[fixed]),
        taken[:, fixed],
    )


def _refined(surface: Surface, power: PowerModel, cost, thrust: float, beta: float) -> tuple[float, float]:
    """The best pair (speed, pitch) of this thrust within a step of the grid from a pitch."""
    step = (surface.pitch[1] - surface.pitch[0]) / (PITCHES - 1)

    def omega(b: float) -> float:
        return float(surface.speeds_of(np.array([thrust]), np.array([b]))[0, 0])

    def value(b: float) -> float:
        w = omega(b)
        return float(cost(power.at(w, b), surface.reserve(w, b))) if np.isfinite(w) else UNREACHED

    ends = np.clip([beta - step, beta + step], *surface.pitch)
    found = minimize_scalar(value, bounds=ends, method="bounded", options={"xatol": 1e-3 * step})
    b = min((float(found.x), beta), key=value)
    return omega(b), b


COLUMNS = ("thrust", "omega", "beta", "power", "power_low", "power_high", "omega_low", "omega_high", "beta_low", "beta_high")


def table(found: Allocation) -> list[Sequence[float]]:
    """Rows of allocation.csv, in the order of COLUMNS."""
    half = NORMAL_95 * found.power_std
    columns = (found.thrust, found.omega, found.beta, found.power, found.power - half, found.power + half)
    return list(zip(*(c.tolist() for c in (*columns, *found.omega_band.T, *found.beta_band.T)), strict=True))


def allocated_controller(found: Allocation, parameters: ParameterSet) -> ParameterSet:
    """The rig's controller in mode 2 with the pairs as its table.

    The table already gives most of the thrust, so the integral of pitch only removes the model's error. Its time is the pitch's
    sum of lags, which cancels the slow pole. The gain by which speed takes over from pitch gives that loop a crossover of 1 /
    (SLOWER sum of lags) of the slower channel: pitch has then settled.
    """
    base, values = rig_controller(parameters), parameters.values
    knots = np.linspace(found.thrust[0], found.thrust[-1], PAIRS)
    pairs = {u: np.interp(knots, found.thrust, of).tolist() for u, of in (("omega", found.omega), ("beta", found.beta))}
    table = {f"pair_{u}_{k}": value for u, of in pairs.items() for k, value in enumerate(of)}
    slopes = (found.surface.spline.ev(found.omega, found.beta, *d) for d in ((1, 0), (0, 1)))
    ratio = np.divide(*slopes) * values["omega_scale"] / values["beta_scale"]
    lags = {u: values[f"tau_{u}_1"] + values[f"tau_{u}_2"] for u in ("omega", "beta")}
    gains = {
        "ki_beta": base.values["kp_beta"] / lags["beta"],
        "k_mid": 1.0 / (SLOWER * max(lags.values()) * float(np.median(np.abs(ratio)))),
    }
    ends = {"pairs_thrust_min": float(knots[0]), "pairs_thrust_max": float(knots[-1])}
    return base.replaced({"mode": ALLOCATED, "speed_only": 0.0, **gains, **ends, **table})
