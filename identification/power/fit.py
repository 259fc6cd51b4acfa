"""Torque and power of a campaign: maps by least squares, and the motor between them, with standard deviations.

Steady points are used if they have torque or power, else the rows of the record that was fitted, at the speed and pitch of the
plant's simulation. Acceleration takes power, too: in a record the rotor's inertia is fitted beside the map and not reported.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import combinations
from types import SimpleNamespace

import numpy as np
from scipy.optimize import least_squares

from identification.assessment.prediction import Prediction
from vpp_fmu.campaign import StaticMap
from vpp_fmu.errors import BadInput
from vpp_fmu.kernel.plant import plant
from vpp_fmu.kernel.power import FIGURE, MOTOR, POWER_MAP, POWER_TERMS, RAD_PER_S, TORQUE_MAP, TORQUE_TERMS
from vpp_fmu.kernel.types import Effect
from vpp_fmu.parameters import ParameterSet

TOLERANCE = 1.05
"""Maximum ratio of shaft to electrical power: both are measured to some per cent."""

TIMES = 4
"""Minimum number of rows per coefficient."""

ROUNDS = 4
"""Number of joint fits of torque and motor. After each, both readings are weighted by their residuals."""

SHARE, EXACT = 0.01, 1e-9
"""Ratio of a reading's noise to its mean: of power before the first fit; minimum, for readings without noise."""

SOLVER = {"x_scale": "jac", "xtol": 1e-12, "ftol": 1e-12}

UNITS = {"torque": "N.m", "power": "W"}


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

    `effects`: names; `rmse`: of "torque" [N.m] and "power" [W]; `points`: readings used.
    """

    effects: tuple[str, ...]
    names: tuple[str, ...]
    values: np.ndarray
    covariance: np.ndarray
    rmse: Mapping[str, float]
    points: int

    @property
    def std(self) -> np.ndarray:
        """(k,)"""
        return np.sqrt(np.diag(self.covariance))

    def added_to(self, parameters: ParameterSet) -> ParameterSet:
        """The plant with these outputs. Its other effects are kept."""
        core, rotor = parameters.without_power, parameters.rig.rotor
        merit = [FIGURE.name] if rotor and TORQUE_MAP.name in self.effects else []
        model = plant([*core.model.optional, *self.effects, *merit], core.model.effects, parameters.rig.scales)
        values, std = (dict(zip(self.names, own.tolist(), strict=True)) for own in (self.values, self.std))
        values |= {f"{FIGURE.name}.{name}": value for name, value in rotor.items() if merit}
        return ParameterSet(model, core.estimates, parameters.source).replaced(values, std)

    def summary(self) -> dict:
        """For identification.json."""
        units = {e.full(p.name): p.unit for e in (TORQUE_MAP, MOTOR, POWER_MAP) for p in e.parameters}
        rows = zip(self.names, self.values.tolist(), self.std.tolist(), strict=True)
        return {
            "effects": list(self.effects),
            "parameters": {n: {"value": v, "std": s, "unit": units[n]} for n, v, s in rows},
            "covariance": self.covariance.tolist(),
            "rmse": {name: {"value": value, "unit": UNITS[name]} for name, value in self.rmse.items()},
            "points": self.points,
        }


def steady_readings(static: StaticMap, scales: Mapping[str, float]) -> Readings | None:
    """Readings of steady points; None without torque and power. `scales`: of the thrust map."""
    of = static.further
    return _readings(static.omega, static.beta_ref, of.get("torque"), electrical(of), static.source, scales)


def moving_readings(prediction: Prediction, scales: Mapping[str, float]) -> Readings | None:
    """Readings of a record's rows, at the speed and pitch of the plant's simulation; None without torque and power."""
    record, omega, beta = prediction.record, prediction.omega, prediction.beta
    columns = np.gradient(omega, record.time) * RAD_PER_S, record.columns.get("torque"), electrical(record.columns)
    kept = np.logical_and.reduce([np.isfinite(c) for c in columns if c is not None])
    rate, torque, power = (c if c is None else c[kept] for c in columns)
    return _readings(omega[kept], beta[kept], torque, power, record.source, scales, rate) if kept.any() else None


def electrical(of: Mapping[str, np.ndarray]) -> np.ndarray | None:
    """Electrical power [W]: as measured, else voltage times current."""
    if "power" in of:
        return of["power"]
    return of["voltage"] * of["current"] if {"voltage", "current"} <= set(of) else None


def _readings(omega, beta, torque, power, source, scales, rate=None) -> Readings | None:
    """None without torque and power. BadInput if a mean is not positive, or if shaft power exceeds electrical power."""
    w, b = omega / scales["omega_scale"], (beta + scales["beta_offset"]) / scales["beta_scale"]
    found = Readings(w, b, omega * RAD_PER_S, torque, power, source, rate)
    for name, unit, values in (("torque", "N.m", torque), ("electrical power", "W", power)):
        if values is not None and not (mean := float(np.mean(values))) > 0.0:
            said = f"{mean:.4g} {unit} in the mean", f"more than 0 {unit}", "the opposite sign of the column"
            raise BadInput(source, name, *said)
    if torque is None or power is None:
        return None if torque is power else found
    shaft, mean = float(np.mean(torque * found.omega)), float(np.mean(power))
    if shaft > TOLERANCE * mean:
        said = f"{shaft:.4g} W of torque and speed in the mean, {mean:.4g} W electrical"
        hint = "other units: torque in N.m, power in W or V and A"
        raise BadInput(source, "torque, power", said, "less power at the shaft than from the supply", hint)
    return found


def figure_of_merit(readings: Readings, thrust: np.ndarray, rotor: Mapping[str, float]) -> float:
    """Mean ratio of a rotor's ideal to its real power over steady points of `thrust` (n,) [N], each weighted by its power."""
    assert readings.torque is not None
    s = SimpleNamespace(torque=readings.torque, thrust=thrust, w=readings.omega / RAD_PER_S, omega_scale=1.0)
    p = SimpleNamespace(**{q.name: rotor.get(q.name, q.default) for q in FIGURE.parameters})
    return float(np.average(FIGURE.step(np, s, None, p, 0.0)[0][FIGURE.name], weights=s.torque * readings.omega))


def fit_power(readings: Readings) -> PowerFit:
    """Fit the map of torque, and the motor if electrical power was measured too; without torque, the map of electrical power.

    The terms of a map are the subset with the smallest BIC. Their powers are below the number of measured speeds, or of
    pitches: with a fixed pitch the map depends on speed alone. BadInput without enough rows.
    """
    if readings.torque is None:
        assert readings.power is not None
        return _map(readings, POWER_MAP, POWER_TERMS, readings.power)
    torque = _map(readings, TORQUE_MAP, TORQUE_TERMS, readings.torque)
    return torque if readings.power is None else _with_motor(readings, torque)


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _map(r: Readings, effect: Effect, terms: Mapping[str, tuple[int, int]], measured: np.ndarray) -> PowerFit:
    """The map of torque or power. If speed changes, every subset has the inertia's term; the result does not.

    The variance of rows in time is multiplied by the ratio of nominal to effective information, (1 + c) / (1 - c) with the
    correlation c of neighbours."""
    speeds, pitches = (len(np.unique(np.round(values, 3))) for values in (r.w, r.b))
    free = {effect.full(n): r.w**i * r.b**j for n, (i, j) in terms.items() if i <= speeds and j < pitches}
    inertia = [] if r.rate is None else [r.rate if effect is TORQUE_MAP else r.rate * r.omega]
    every = np.column_stack([*free.values(), *inertia])
    n, size = every.shape
    rank = int(np.linalg.matrix_rank(every))
    if n < TIMES * size or rank < size:
        allowed = f"{TIMES * size} or more, of independent speeds and pitches"
        raise BadInput(r.source, "rows with torque or power", f"{n} of rank {rank} for {size} terms", allowed)
    triangle, total = np.linalg.qr(np.column_stack([every, measured]), mode="r"), float(measured @ measured)

    def bic(chosen: list[int]) -> float:
        c, *_ = np.linalg.lstsq(triangle[:, chosen], triangle[:, -1], rcond=None)
        rest = float(np.sum((triangle[:, -1] - triangle[:, chosen] @ c) ** 2))
        return n * float(np.log(max(rest, 1e-15 * total))) + len(chosen) * float(np.log(n))

    always = range(len(free), size)
    counts = range(1, len(free) + 1)
    best = min(([*chosen, *always] for k in counts for chosen in combinations(range(len(free)), k)), key=bic)
    a, k = every[:, best], len(best) - len(inertia)
    c, *_ = np.linalg.lstsq(a, measured, rcond=None)
    residual = measured - a @ c
    covariance = np.linalg.inv(a.T @ a) * float(residual @ residual) / (n - len(c))
    if inertia and residual.any():
        shared = float(np.clip(residual[1:] @ residual[:-1] / (residual @ residual), 0.0, 0.999))
        covariance *= (1.0 + shared) / (1.0 - shared)
    chosen = tuple(list(free)[i] for i in best[:k])
    return PowerFit((effect.name,), chosen, c[:k], covariance[:k, :k], {effect.outputs[0].name: _rms(residual)}, n)


def _with_motor(r: Readings, torque: PowerFit) -> PowerFit:
    """Fit the torque's map, and friction, copper loss and idle power of the motor, none below 0, together to both readings,
    each weighted by its noise. The fit starts from the map of torque alone."""
    assert r.power is not None
    powers = {TORQUE_MAP.full(name): ij for name, ij in TORQUE_TERMS.items()}
    columns = np.column_stack([r.w**i * r.b**j for i, j in map(powers.__getitem__, torque.names)])
    k, n, mean, load = len(torque.values), len(r.power), float(np.mean(r.power)), columns @ torque.values
    scale = np.append(np.abs(torque.values), mean / np.array([np.mean(r.omega), np.mean(load**2), 1.0]))
    x, lower = np.append(np.sign(torque.values), [0.05, 0.1, 0.01]), np.append(np.full(k, -np.inf), np.zeros(3))
    noise, least = np.array([torque.rmse["torque"], SHARE * mean]), EXACT * np.array([np.mean(load), mean])

    def residuals(x: np.ndarray) -> np.ndarray:
        aerodynamic, (friction, loss, idle) = columns @ (x * scale)[:k], (x * scale)[k:]
        driven = aerodynamic + friction
        return np.array([aerodynamic - r.torque, driven * r.omega + loss * driven**2 + idle - r.power])

    for _ in range(ROUNDS):
        weight = 1.0 / np.maximum(noise, least)[:, None]
        found = least_squares(lambda x, w: (w * residuals(x)).ravel(), x, args=(weight,), bounds=(lower, np.inf), **SOLVER)
        x, free = found.x, np.append(np.full(k, True), found.x[k:] > 1e-6)
        # Degrees of freedom: the map's terms count for torque, the motor's for power.
        noise = np.sqrt(np.sum(residuals(x) ** 2, axis=1) / np.array([n - k, n - free[k:].sum()]))
    covariance = np.zeros((k + 3, k + 3))
    covariance[np.ix_(free, free)] = np.linalg.pinv(found.jac[:, free].T @ found.jac[:, free])
    names = *torque.names, *(MOTOR.full(p.name) for p in MOTOR.parameters)
    rmse = dict(zip(UNITS, map(_rms, residuals(x)), strict=True))
    return PowerFit((TORQUE_MAP.name, MOTOR.name), names, x * scale, covariance * np.outer(scale, scale), rmse, n)
