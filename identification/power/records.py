"""Power and voltage of records for their regression: the residual, its base, and the signals that effects depend on.

The residual of the identified model (fit.py) at the simulated speed and pitch is regressed on nuisance terms: a map, the
copper loss, the acceleration of the rotor (J omega domega/dt and its copper loss), and errors of the lags of speed and pitch.
The voltage has a line in time as its base. The current is predicted from the fitted power, so the noise of its reading does not
bias the resistance (two-stage least squares).
"""

from dataclasses import replace

import numpy as np

from identification.assessment.prediction import Prediction
from identification.diagnose.command_shapes import output_shapes
from identification.fit.coordinates import slowest
from identification.fit.noise import blocks
from identification.power.effects import Signals
from identification.power.fit import electrical
from identification.power.model import PowerModel
from identification.power.regression import STEP, Part, RegressionFit
from vpp_fmu.kernel.power import MOTOR, POWER_TERMS, RAD_PER_S
from vpp_fmu.native import Simulator
from vpp_fmu.parameters import ParameterSet
from vpp_fmu.record import Record

STATIC = ((0, 0), *POWER_TERMS.values(), *((4, j) for j in range(5)))
"""Powers (i, j) of the terms w^i b^j of the map that is refined on the records: a constant, the terms of a map of power, and
those of the copper loss of a torque of degree 2."""

FINE = 0.01
"""Largest step of a difference quotient, as a share of the slowest time constant."""

LEAST_SPEED = 0.02
"""Minimum speed, as a share of the speed scale, by which power is divided."""


def respond(parameters: ParameterSet, record: Record) -> tuple[Prediction, np.ndarray, np.ndarray]:
    """(response of a plant to a record; rates (rows, 2) of speed [rpm/s] and pitch [deg/s]; derivatives (rows, k) by its
    lags: of the power, and of the rate of speed times speed). Rates have kinks where a command steps, so they are forward
    differences over fractions of a row."""
    values, model = parameters.values, parameters.model
    wrt = tuple(f"tau_{u}_{k}" for u in ("omega", "beta") for k in (1, 2))
    parts = max(int(np.ceil(record.period / (FINE * slowest(values, values)))), 3)
    split = {name: np.repeat(column, parts) for name, column in record.columns.items() if column.dtype.kind == "f"}
    steps = np.append(record.steps, record.period) / parts
    split["time"] = record.time[0] + np.append(0.0, np.cumsum(np.repeat(steps, parts))[:-1])
    fine = replace(record, columns=split, late=0.0).commands_later(parts * record.late)
    names = [y.name for y in model.outputs]
    simulated = Simulator(model, wrt).pieces(values, *fine.run, of=[names.index("omega"), names.index("power")])
    whole = np.vstack([np.hstack([outputs, slopes[:, 0, :2], slopes[:, 1]]) for _, outputs, slopes in simulated])
    rates = (4.0 * whole[1::parts] - whole[2::parts] - 3.0 * whole[::parts]) / (2.0 * steps[:, None])
    (thrust, omega, beta, *further), count = whole[::parts, : len(names)].T, len(names)
    shown = Prediction(record, thrust, omega, beta, dict(zip(names[3:], further, strict=True)))
    turns = omega[:, None] / values["omega_scale"] * rates[:, count : count + 2]
    return shown, rates[:, 1:3], np.hstack([whole[::parts, count + 2 :], turns])


def squared_torque(model: PowerModel, p: Prediction) -> np.ndarray:
    """Squared torque (rows,) of the motor; without a measured torque, squared electrical power over speed."""
    values = model.parameters.values
    if MOTOR.name in model.parameters.model.optional:
        return (p.further["torque"] + values[MOTOR.full("friction")]) ** 2
    speed = np.maximum(np.abs(p.omega), LEAST_SPEED * values["omega_scale"])
    return (p.further["power"] / (speed * RAD_PER_S)) ** 2


def power_part(name: str, response: tuple, model: PowerModel, block: float, largest: float) -> Part:
    """The power of a record, minus that of the identified model. `response`: of `respond`."""
    p, (faster, rate), lags = response[0], response[1].T, response[2].T
    values, time = model.parameters.values, p.record.time
    expected, load = p.further["power"], squared_torque(model, p) / largest
    near, by = STEP * values["omega_scale"], STEP * values["beta_scale"]
    to_speed = (model.at(p.omega + near, p.beta) - model.at(p.omega - near, p.beta)) / (2.0 * near)
    to_pitch = (model.at(p.omega, p.beta + by) - model.at(p.omega, p.beta - by)) / (2.0 * by)
    w, b = p.omega / values["omega_scale"], p.beta / values["beta_scale"]
    static = [w**i * b**j for i, j in STATIC]
    driven = [faster * term for term in (1.0, w, w**2, w**2 * b, w**2 * b**2, faster)]
    base = [*static, load, *driven, *lags]
    step, loss = float(np.median(p.record.steps)), values.get(MOTOR.full("loss"), 0.0)
    feedback = 1.0 / (loss * largest) if loss > 0.0 else 0.0
    signals = Signals(time, expected, load, rate, p.thrust, np.zeros(len(time)), step, feedback)
    outputs = np.column_stack([expected, p.omega, p.beta])
    reading, at = electrical(p.record.columns), blocks(p.record, block)
    shapes = output_shapes(p.record, outputs, (to_pitch, to_speed), slowest(values, values))
    return Part(
        name=name,
        record=p.record,
        at=at,
        measured=reading - expected,
        base=np.column_stack(base),
        signals=signals,
        shapes=np.column_stack([at.mean(shape) for shape in shapes]),
        largest=float(np.nanmax(np.abs(reading))),
    )


def supply_parts(power: RegressionFit) -> list[Part]:
    """The voltages of the records of a fit of power that have voltage and current. The current is regressed on the power that
    the fit predicts. Each record has its own line in time as base."""
    parts = [p for p in power.problem.parts if {"voltage", "current"} <= set(p.record.columns)]
    found = []
    for part, own in zip(parts, np.eye(len(parts)), strict=True):
        volts, measured, since = part.record["voltage"], part.record["current"], part.record.time / part.record.time[-1]
        predicted = part.signals.power + part.base @ power.coefficients + part.response(power.effects, power.x)
        seen, terms = np.isfinite(measured), np.vander(predicted / np.max(np.abs(predicted)), 3)
        current = terms @ np.linalg.lstsq(terms[seen], measured[seen], rcond=None)[0]
        shapes, signals = part.at.mean(np.column_stack([since**2, current])), replace(part.signals, current=current)
        base, largest = np.kron(own, np.vander(since, 2)), float(np.nanmax(np.abs(volts)))
        found.append(replace(part, measured=volts, base=base, signals=signals, shapes=shapes, largest=largest))
    return found
