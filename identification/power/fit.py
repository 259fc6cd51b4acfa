"""Torque and power of a campaign: maps by least squares, and the motor between them, with standard deviations.

Steady points are used if they have torque or power, else the rows of the record that was fitted, at the speed and pitch of the
plant's simulation. Acceleration takes power, too: in a record the rotor's inertia is fitted beside the map and not reported.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from scipy.optimize import least_squares

from identification.assessment.prediction import Prediction
from vpp_fmu.campaign import StaticMap
from vpp_fmu.errors import BadInput
from vpp_fmu.kernel.plant import plant
from vpp_fmu.kernel.power import FIGURE, MOTOR, POWER_MAP, POWER_TERMS, RAD_PER_S, TORQUE_MAP, TORQUE_TERMS, polynomial
from vpp_fmu.parameters import ParameterSet

TOLERANCE = 1.05
"""Maximum ratio of shaft to electrical power: both are measured to some per cent."""

AIR_DENSITY = next(p.default for p in FIGURE.parameters if p.name == "air_density")
"""kg/m^3, for a rig that does not declare it."""

TIMES = 4
"""Minimum number of rows per coefficient."""

ROUNDS = 4
"""Number of joint fits of torque and motor. After each, both readings are weighted by their residuals."""

SHARE, EXACT = 0.01, 1e-9
"""Ratio of a reading's noise to its mean: of power before the first fit; minimum, for readings without noise."""


@dataclass(frozen=True, eq=False)
class Readings:
    """Torque [N.m] and electrical power [W] (n,), None if not measured, at normalised speed `w` and pitch `b` (n,), and at
    `omega` (n,) [rad/s]. `rate` (n,) [rad/s^2]: of the speed, None for steady points. `source`: the file."""

    w: np.ndarray
    b: np.ndarray
    omega: np.ndarray
    torque: np.ndarray | None
    power: np.ndarray | None
    source: str
    rate: np.ndarray | None = None


@dataclass(frozen=True, eq=False)
class PowerFit:
    """Parameters of effects of `vpp_fmu.kernel.power`: full `names` (k,), `values` (k,) and their `covariance` (k, k), in the
    units of the effects. Coefficients that were not selected are not among them: they are 0.

    `effects`: names; `rmse`: of "torque" [N.m] and "power" [W]; `points`: readings used, of the file `source`.
    """

    effects: tuple[str, ...]
    names: tuple[str, ...]
    values: np.ndarray
    covariance: np.ndarray
    rmse: Mapping[str, float]
    points: int
    source: str

    def added_to(self, parameters: ParameterSet) -> ParameterSet:
        """The plant with these outputs. Its other effects are kept."""
        core, rotor = parameters.without_power.model, parameters.rig.rotor
        merit = [FIGURE.name] if rotor and TORQUE_MAP.name in self.effects else []
        model = plant([*core.optional, *self.effects, *merit], core.effects, parameters.rig.scales)
        std = dict(zip(self.names, np.sqrt(np.diag(self.covariance)).tolist(), strict=True))
        own = dict(zip(self.names, self.values.tolist(), strict=True))
        own |= {f"{FIGURE.name}.{name}": value for name, value in rotor.items() if merit}
        return ParameterSet(model, parameters.without_power.estimates, parameters.source).replaced(own, std)

    def summary(self) -> dict:
        """For identification.json."""
        units = {e.full(p.name): p.unit for e in (TORQUE_MAP, MOTOR, POWER_MAP) for p in e.parameters}
        std = np.sqrt(np.diag(self.covariance)).tolist()
        rows = zip(self.names, self.values.tolist(), std, strict=True)
        shown = {"torque": "N.m", "power": "W"}
        return {
            "effects": list(self.effects),
            "parameters": {n: {"value": v, "std": s, "unit": units[n]} for n, v, s in rows},
            "covariance": self.covariance.tolist(),
            "rmse": {name: {"value": value, "unit": shown[name]} for name, value in self.rmse.items()},
            "points": self.points,
        }


def steady_readings(static: StaticMap, scales: Mapping[str, float]) -> Readings | None:
    """Readings of steady points; None without torque and power. `scales`: of the thrust map."""
    of = static.further
    return _readings(static.omega, static.beta_ref, of.get("torque"), electrical(of), static.source, scales)


def moving_readings(prediction: Prediction, scales: Mapping[str, float]) -> Readings | None:
    """Readings of a record's rows, at the speed and pitch of the plant's simulation; None without torque and power."""
    record = prediction.record
    of = {name: record[name] for name in ("torque", "voltage", "current", "power") if name in record}
    rate = np.gradient(prediction.omega, record.time) * RAD_PER_S
    columns = [of.get("torque"), electrical(of)]
    kept = np.logical_and.reduce([np.isfinite(c) for c in (rate, *columns) if c is not None])
    if not kept.any():
        return None
    torque, power = (None if c is None else c[kept] for c in columns)
    return _readings(prediction.omega[kept], prediction.beta[kept], torque, power, record.source, scales, rate[kept])


def electrical(of: Mapping[str, np.ndarray]) -> np.ndarray | None:
    """Electrical power [W]: as measured, else voltage times current."""
    if "power" in of:
        return of["power"]
    return of["voltage"] * of["current"] if {"voltage", "current"} <= set(of) else None


def _readings(omega, beta, torque, power, source, scales, rate=None) -> Readings | None:
    if torque is None and power is None:
        return None
    w, b = omega / scales["omega_scale"], (beta + scales["beta_offset"]) / scales["beta_scale"]
    found = Readings(w, b, omega * RAD_PER_S, torque, power, source, rate)
    _check(found)
    return found


def _check(r: Readings) -> None:
    """BadInput if a mean is not positive, or if shaft power exceeds electrical power."""
    for name, unit, values in (("torque", "N.m", r.torque), ("electrical power", "W", r.power)):
        if values is not None and not (mean := float(np.mean(values))) > 0.0:
            raise BadInput(
                r.source, name, f"{mean:.4g} {unit} in the mean", f"more than 0 {unit}", "the opposite sign of the column"
            )
    if r.torque is not None and r.power is not None:
        gives, gets = float(np.mean(r.torque * r.omega)), float(np.mean(r.power))
        if gives > TOLERANCE * gets:
            found = f"{gives:.4g} W of torque and speed in the mean, {gets:.4g} W electrical"
            raise BadInput(
                r.source,
                "torque, power",
                found,
                "less power at the shaft than from the supply",
                "other units: torque in N.m, power in W or V and A",
            )


def figure_of_merit(readings: Readings, thrust: np.ndarray, rotor: Mapping[str, float]) -> float:
    """Mean ratio of a rotor's ideal to its real power over steady points of `thrust` (n,) [N], each weighted by its power."""
    assert readings.torque is not None
    disc = 0.25 * np.pi * rotor["diameter"] ** 2
    ideal = np.maximum(thrust, 0.0) ** 1.5 / np.sqrt(2.0 * rotor.get("air_density", AIR_DENSITY) * disc)
    return float(ideal.sum() / (readings.torque * readings.omega).sum())


def fit_power(readings: Readings) -> PowerFit:
    """Fit the map of torque, and the motor if electrical power was measured too; without torque, the map of electrical power.

    The terms of a map are the subset with the smallest BIC. Their powers are below the number of measured speeds, or of
    pitches: with a fixed pitch the map depends on speed alone. BadInput without enough rows.
    """
    if readings.torque is None:
        assert readings.power is not None
        return _map(readings, POWER_MAP.name, POWER_TERMS, readings.power)
    torque = _map(readings, TORQUE_MAP.name, TORQUE_TERMS, readings.torque)
    return torque if readings.power is None else _with_motor(readings, torque)


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _map(readings: Readings, effect: str, terms, measured: np.ndarray) -> PowerFit:
    """The map of torque or power. If speed changes, every subset has the inertia's term; the result does not."""
    first = min(i for i, _ in terms)
    speeds, pitches = (len(np.unique(np.round(values, 3))) for values in (readings.w, readings.b))
    terms = [(i, j) for i, j in terms if i - first < speeds and j < pitches]
    columns = [polynomial((term,), (1.0,), readings.w, readings.b) for term in terms]
    held = []
    if readings.rate is not None:
        held = [readings.rate if effect == TORQUE_MAP.name else readings.rate * readings.omega]
    every = np.column_stack([*columns, *held])
    n, size = every.shape
    rank = int(np.linalg.matrix_rank(every))
    if n < TIMES * size or rank < size:
        allowed = f"{TIMES * size} or more, of independent speeds and pitches"
        raise BadInput(readings.source, "rows with torque or power", f"{n} of rank {rank} for {size} terms", allowed)
    gram, moment, total = every.T @ every, every.T @ measured, float(measured @ measured)
    always = range(len(terms), size)

    def bic(chosen: Sequence[int]) -> float:
        at = [*chosen, *always]
        rest = total - moment[at] @ np.linalg.solve(gram[np.ix_(at, at)], moment[at])
        return n * float(np.log(max(rest, 1e-15 * total))) + len(at) * float(np.log(n))

    subsets = (chosen for k in range(1, len(terms) + 1) for chosen in combinations(range(len(terms)), k))
    best = list(min(subsets, key=bic))
    a = every[:, [*best, *always]]
    c, *_ = np.linalg.lstsq(a, measured, rcond=None)
    residual = measured - a @ c
    covariance = np.linalg.inv(a.T @ a) * _variance(residual, len(c), readings.rate is not None)
    k, (letter, reading) = len(best), ("q", "torque") if effect == TORQUE_MAP.name else ("p", "power")
    names = tuple(f"{effect}.{letter}{terms[i][0]}{terms[i][1]}" for i in best)
    return PowerFit((effect,), names, c[:k], covariance[:k, :k], {reading: _rms(residual)}, n, readings.source)


def _variance(residual: np.ndarray, count: int, in_time: bool) -> float:
    """Variance of the residual (n,), for the covariance of `count` coefficients. For rows in time it is multiplied by the ratio
    of nominal to effective information, (1 + r) / (1 - r) with the correlation r of neighbours."""
    variance = float(residual @ residual) / (len(residual) - count)
    if not in_time or variance == 0.0:
        return variance
    r = float(np.clip(residual[1:] @ residual[:-1] / (residual @ residual), 0.0, 0.999))
    return variance * (1.0 + r) / (1.0 - r)


def _with_motor(readings: Readings, torque: PowerFit) -> PowerFit:
    """Fit the torque's map, and friction, copper loss and idle power of the motor, none below 0, together to both readings,
    each weighted by its noise. The fit starts from the map of torque alone."""
    omega, power = readings.omega, readings.power
    assert power is not None
    assert readings.rate is None
    k, n, mean = len(torque.values), len(power), float(np.mean(power))
    columns = np.column_stack([polynomial([(int(q[-2]), int(q[-1]))], (1.0,), readings.w, readings.b) for q in torque.names])
    load = columns @ torque.values
    motor = mean * np.array([1.0 / float(np.mean(omega)), 1.0 / float(np.mean(load**2)), 1.0])
    scale, bounds = np.append(np.abs(torque.values), motor), (np.append(np.full(k, -np.inf), np.zeros(3)), np.inf)
    x = np.append(np.sign(torque.values), [0.05, 0.1, 0.01])
    noise, least = np.array([torque.rmse["torque"], SHARE * mean]), EXACT * np.array([float(np.mean(load)), mean])

    def residuals(x: np.ndarray) -> np.ndarray:
        aerodynamic = columns @ (x * scale)[:k]
        friction, loss, idle = (x * scale)[k:]
        driven = aerodynamic + friction
        return np.array([aerodynamic - readings.torque, driven * omega + loss * driven**2 + idle - power])

    def weighted(x: np.ndarray) -> np.ndarray:
        return (residuals(x) / noise[:, None]).ravel()

    for _ in range(ROUNDS):
        noise = np.maximum(noise, least)
        found = least_squares(weighted, x, bounds=bounds, x_scale="jac", xtol=1e-12, ftol=1e-12)
        x, free = found.x, np.append(np.full(k, True), found.x[k:] > 1e-6)
        # Degrees of freedom: the map's terms count for torque, the motor's for power.
        noise = np.sqrt(np.sum(residuals(x) ** 2, axis=1) / np.array([n - k, n - free[k:].sum()]))
    covariance = np.zeros((k + 3, k + 3))
    covariance[np.ix_(free, free)] = np.linalg.pinv(found.jac[:, free].T @ found.jac[:, free])
    names = *torque.names, *(MOTOR.full(p.name) for p in MOTOR.parameters)
    rmse = dict(zip(("torque", "power"), map(_rms, residuals(x)), strict=True))
    effects = TORQUE_MAP.name, MOTOR.name
    return PowerFit(effects, names, x * scale, covariance * np.outer(scale, scale), rmse, n, readings.source)
