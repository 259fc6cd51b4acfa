"""Allocation: for each thrust the pair of speed and pitch of least power, within the rig's limits.

Many pairs give the same thrust (paper, section 1). The settled thrust of the plant gives the pairs, the power map their power.
Instead of power alone, a weight also counts the reserve: how much thrust pitch alone, the fast actuator, can add and remove.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import RectBivariateSpline
from scipy.optimize import brentq, minimize_scalar

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

    @property
    def grid(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(speeds (m,), pitches (k,), thrust (m, k)) on the fine grid."""
        speeds, pitches = np.linspace(*self.speed, SPEEDS), np.linspace(*self.pitch, PITCHES)
        return speeds, pitches, self.spline(speeds, pitches)

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

    found = []
    for thrust in thrusts:
        omega, beta = _pairs(speeds, pitches, grid, thrust)
        spare = surface.reserve(omega, beta)
        here = power.at(omega, beta)
        at = int(np.argmin(cost(here, spare)))
        best = _refined(surface, power, cost, thrust, (float(omega[at]), float(beta[at])))
        drawn = np.argmin(cost(here[:, None] + power.gradient(omega, beta) @ draws.T, spare[:, None]), axis=0)
        low, high = np.quantile([omega[drawn], beta[drawn]], BAND, axis=1)
        found.append([best, np.minimum(low, best), np.maximum(high, best)])  # drawn pairs are on the grid, the best is between
    best, low, high = np.moveaxis(np.array(found), 0, -1)
    omega, beta = best
    watts = power.at(omega, beta)
    if (least := float(watts.min())) <= 0.0:
        k = int(np.argmin(watts))
        where = f"{least:.4g} W at {omega[k]:.4g} rpm, {beta[k]:.4g} deg"
        raise BadInput("parameters", "power", where, "a positive power", "steady points measured there")
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
        *_fixed(power, speeds, pitches, grid, thrusts),
    )


def _pairs(speeds: np.ndarray, pitches: np.ndarray, grid: np.ndarray, thrust: float) -> tuple[np.ndarray, np.ndarray]:
    """All pairs (omega (n,), beta (n,)) of a thrust on the pitches of the grid, interpolated between its speeds."""
    over = grid - thrust
    row, column = np.nonzero((over[:-1] * over[1:] <= 0.0) & (over[:-1] != over[1:]))
    share = over[row, column] / (over[row, column] - over[row + 1, column])
    omega, beta = speeds[row] + share * (speeds[1] - speeds[0]), pitches[column]
    if not len(omega):  # the greatest thrust of all is at one point of the grid
        at = np.unravel_index(np.argmin(np.abs(over)), over.shape)
        return speeds[at[0] : at[0] + 1], pitches[at[1] : at[1] + 1]
    return omega, beta


def _refined(surface: Surface, power: PowerModel, cost, thrust: float, pair: tuple[float, float]) -> tuple[float, float]:
    """The best pair near one of the grid, exactly of this thrust."""
    omega, beta = pair
    step = ((surface.speed[1] - surface.speed[0]) / (SPEEDS - 1), (surface.pitch[1] - surface.pitch[0]) / (PITCHES - 1))

    def speed_at(b: float) -> float | None:
        """Speed of this thrust at a pitch, near the pair's."""
        for width in (2.0, 8.0, 32.0):
            low, high = (float(np.clip(omega + s * width * step[0], *surface.speed)) for s in (-1.0, 1.0))
            ends = [float(surface.at(w, b)) - thrust for w in (low, high)]
            if ends[0] * ends[1] <= 0.0:
                return float(brentq(lambda w: float(surface.at(w, b)) - thrust, low, high))
        return None

    def value(b: float) -> float:
        w = speed_at(b)
        return UNREACHED if w is None else float(cost(power.at(w, b), surface.reserve(w, b)))

    ends = [float(np.clip(beta + s * step[1], *surface.pitch)) for s in (-1.0, 1.0)]
    best = minimize_scalar(value, bounds=ends, method="bounded", options={"xatol": 1e-3 * step[1]})
    b = min((float(best.x), beta), key=value)
    return speed_at(b) or omega, b


def _fixed(
    power: PowerModel, speeds: np.ndarray, pitches: np.ndarray, grid: np.ndarray, thrusts: np.ndarray
) -> tuple[float, np.ndarray]:
    """(pitch [deg], power (n,) [W] over the thrusts) of the fixed pitch with the least mean power, among those that reach the
    most thrusts; NaN where it does not reach a thrust."""
    watts = np.full((len(pitches), len(thrusts)), np.nan)
    for k, beta in enumerate(pitches):
        monotone = np.maximum.accumulate(grid[:, k])
        kept = np.append(True, np.diff(monotone) > 0.0)
        omega = np.interp(thrusts, monotone[kept], speeds[kept], left=np.nan, right=np.nan)
        watts[k] = power.at(omega, np.full(len(thrusts), beta))
    reached = np.isfinite(watts).sum(axis=1)
    widest = np.flatnonzero(reached == reached.max())
    best = min(widest.tolist(), key=lambda k: float(np.nanmean(watts[k])) if reached[k] else np.inf)
    return float(pitches[best]), watts[best]


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
