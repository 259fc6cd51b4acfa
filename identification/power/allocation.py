"""Allocation: for each thrust the pair of speed and pitch of least power, within the rig's limits.

Many pairs give the same thrust (paper, section 1). The settled thrust of the plant gives the pairs, the power map their power.
Instead of power alone, a weight also counts the reserve: how much thrust pitch alone, the fast actuator, can add and remove.
"""

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import RectBivariateSpline

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
"""Fine grid on which pairs of equal thrust are found."""

FINER = 2
"""Further grids of pitches, each within a step of the best pitch of the grid before."""

DRAWS = 300
"""Draws of the power's parameters for the bands of speed and pitch."""

BAND = (0.025, 0.975)
"""Quantiles of a 95 % band."""

SLOWER = 5.0
"""Ratio of the time in which speed takes over from pitch to the sum of lags of the slower channel."""


@dataclass(frozen=True, eq=False)
class Surface:
    """Settled thrust [N] of a plant over speed [rpm] and pitch [deg]. `speeds` (m,), `pitches` (k,): a grid in its limits."""

    speeds: np.ndarray
    pitches: np.ndarray
    spline: RectBivariateSpline

    @classmethod
    def of(cls, parameters: ParameterSet) -> "Surface":
        """Of a plant with its effects, on its rig. BadInput for a rig whose speed or pitch is fixed."""
        rig, model, values = parameters.rig, parameters.model, parameters.values
        for name, (low, high) in (("speed", rig.speed), ("pitch", rig.pitch)):
            if not low < high:
                allowed = "a range: with a fixed one there is no pair to choose"
                raise BadInput("parameters", f"range of {name}", f"{low:g}, fixed", allowed)
        rest = {u.name: u.start for u in model.inputs} | model.measured_inputs
        speeds, pitches = np.linspace(*rig.speed, NODES), np.linspace(*rig.pitch, NODES)
        thrust = [
            [start(model, NUMBERS, rest | {"omega_ref": float(w), "beta_ref": float(b)}, values)[0]["thrust"] for b in pitches]
            for w in speeds
        ]
        spline = RectBivariateSpline(speeds, pitches, np.array(thrust))
        return cls(np.linspace(*rig.speed, SPEEDS), np.linspace(*rig.pitch, PITCHES), spline)

    def pairs(self, thrust: float, pitches: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(speeds, pitches) that give a thrust: the lowest speed at each of the pitches (k,), increasing, that reaches it."""
        reached = self.spline(self.speeds, pitches)
        k = np.argmax(reached >= thrust, axis=0)
        at = np.flatnonzero(k)
        low, high = reached[k[at] - 1, at], reached[k[at], at]
        return self.speeds[k[at]] - (high - thrust) / (high - low) * (self.speeds[1] - self.speeds[0]), pitches[at]

    def reserve(self, omega: np.ndarray, beta: np.ndarray) -> np.ndarray:
        """Thrust [N] that pitch alone can both add and remove at pairs (n,); negative pitch of more thrust counts, too."""
        ends, now = self.spline.ev(omega[:, None], self.pitches), self.spline.ev(omega, beta)
        return np.minimum(ends.max(axis=1) - now, now - ends.min(axis=1))


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
    def columns(self) -> dict[str, np.ndarray]:
        """Columns of allocation.csv, (n,) each: `thrust` [N], `omega` [rpm], `beta` [deg], `power` [W], their 95 % limits."""
        half = NORMAL_95 * self.power_std
        found = {"thrust": self.thrust, "omega": self.omega, "beta": self.beta, "power": self.power}
        found |= {"power_low": self.power - half, "power_high": self.power + half}
        bands = {"omega": self.omega_band, "beta": self.beta_band}
        return found | {f"{u}_{end}": band[:, k] for u, band in bands.items() for k, end in enumerate(("low", "high"))}

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
    pitches, grid = surface.pitches, surface.spline(surface.speeds, surface.pitches)
    highest, most = float(power.at(*np.meshgrid(surface.speeds, pitches)).max()), float(grid.max())
    if most <= 0.0:
        raise BadInput("parameters", "settled thrust", f"at most {most:.4g} N within the rig's limits", "more than 0 N")
    thrusts = np.linspace(max(float(grid.min()), 0.0), most, count + 1)[1:]
    random, none = np.random.default_rng(seed), np.zeros(len(power.names))
    draws = random.multivariate_normal(none, power.covariance, DRAWS, method="eigh") if len(none) else np.zeros((DRAWS, 0))

    def cost(omega: np.ndarray, beta: np.ndarray, further: np.ndarray | float = 0.0) -> np.ndarray:
        """Of pairs (n,); of `further` power (draws, n)."""
        watts, reserve = power.at(omega, beta) + further, surface.reserve(omega, beta)
        return (1.0 - weight) * watts / highest - weight * reserve / most

    best, low, high, taken = np.empty((2, count)), np.empty((2, count)), np.empty((2, count)), np.full((count, PITCHES), np.nan)
    for k, thrust in enumerate(thrusts.tolist()):
        omega, beta = surface.pairs(thrust, pitches)
        taken[k, np.isin(pitches, beta)] = power.at(omega, beta)
        drawn = np.argmin(cost(omega, beta, draws @ power.gradient(omega, beta).T), axis=1)
        ends = np.quantile([omega[drawn], beta[drawn]], BAND, axis=1)
        for step in (pitches[1] - pitches[0]) * (2.0 / (PITCHES - 1)) ** np.arange(FINER):
            near = beta[np.argmin(cost(omega, beta))] + step * np.linspace(-1.0, 1.0, PITCHES)
            omega, beta = surface.pairs(thrust, np.clip(near, pitches[0], pitches[-1]))
        at = np.argmin(cost(omega, beta))
        best[:, k] = omega[at], beta[at]
        # Drawn pairs are on the grid, the best is between.
        low[:, k], high[:, k] = np.minimum(ends[0], best[:, k]), np.maximum(ends[1], best[:, k])
    omega, beta = best
    watts = power.at(omega, beta)
    if (least := float(watts.min())) <= 0.0:
        k = int(np.argmin(watts))
        where = f"{least:.4g} W at {omega[k]:.4g} rpm, {beta[k]:.4g} deg"
        raise BadInput("parameters", "power", where, "a positive power", "steady points measured there")
    # The best fixed pitch has the least mean power, among those that reach the most thrusts.
    counts, total = np.isfinite(taken).sum(axis=0), np.nansum(taken, axis=0)
    fixed = int(np.argmin(np.where(counts == counts.max(), total, np.inf)))
    return Allocation(
        surface=surface,
        model=power,
        weight=weight,
        thrust=thrusts,
        omega=omega,
        beta=beta,
        power=watts,
        power_std=power.std(omega, beta),
        omega_band=np.column_stack([low[0], high[0]]),
        beta_band=np.column_stack([low[1], high[1]]),
        reserve=surface.reserve(omega, beta),
        fixed_beta=float(pitches[fixed]),
        fixed=taken[:, fixed],
    )


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
