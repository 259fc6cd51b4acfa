"""Fit the map from a motor's signal to a speed command, for logs that contain the signal only."""

import os
from pathlib import Path

import numpy as np

from identification.logs.speed_map import (
    SignalRange,
    SpeedMap,
    SteadyPoints,
    fit_speed_map,
    read_speed_map,
    said_of_fit,
    steady_points,
)
from vpp_fmu.errors import BadInput

FILE = "speed_map.json"
"""File of the map that all logs of a folder share."""


def map_beside(folder: str | os.PathLike, span: SignalRange, log: str | os.PathLike) -> SpeedMap | None:
    """The speed map of a folder if it is from another log and for the same kind of signal, else None. BadInput: invalid file.

    A command must mean the same in all records of a rig, so their logs share one map.
    """
    path = Path(folder) / FILE
    if not path.exists():
        return None
    found = read_speed_map(path)
    return found if found.signal == span and found.source != Path(log).name else None


def map_of_signal(
    source: str,
    known: SpeedMap | None,
    span: SignalRange,
    time: np.ndarray | None,
    signal: np.ndarray,
    speed: np.ndarray | None,
    voltage: np.ndarray | None,
    usable: np.ndarray | bool = True,
) -> tuple[SpeedMap, str]:
    """(the map for a log of rows (n,), its origin and its fit to the log in words): the map of another log, if `known`,
    extended to the smallest signal at which the rotor turns here; else fitted to the log's steady parts. `time`: None if each
    row is a steady point; `speed`, `voltage`: None if not measured. `usable` (n,): rows whose speed belongs to their signal.

    Without voltage the map depends on the signal only, at a nominal 1 V. BadInput if the log gives no increasing map.
    """
    turning = np.zeros(len(signal), bool) if speed is None else np.isfinite(speed) & (speed > 0.0)
    text = f"taken over from {known.source} (there rms {known.rms:.3g} rpm)" if known else ""
    if not turning.any():
        if known:
            return known, text
        hint = "--speed-map M.json of another log of the stand, or --map omega=COLUMN:rpm"
        field, found = (
            ("omega_ref", "a signal and no measured speed") if speed is None else ("omega", "a motor that never turns")
        )
        raise BadInput(source, field, found, "a measured speed, to which the signal's map is fitted", hint)
    volts = np.full(len(signal), known.nominal_voltage if known else 1.0) if voltage is None else voltage
    if time is None:
        points = SteadyPoints(signal[turning], volts[turning], speed[turning], float(signal[turning].min()))
    else:
        points = steady_points(time, signal, speed, volts, np.isfinite(speed) & usable, span.low)
    if known:
        found = known.reaching(points.turns_from)
    else:
        found = fit_speed_map(points, span, float(np.median(volts[turning])), Path(source).name)
        text = f"fitted to {found.points} steady parts"
    text += said_of_fit(points, found)
    if known and found is not known:
        text += f"; here the rotor turns from signal {found.turns_from:.6g} on, there from {known.turns_from:.6g}"
    if beyond := int(np.sum(signal > found.fitted_to)):
        text += f"; {beyond} rows have a higher signal than it was fitted to"
    return found, text if voltage is not None else f"{text}; without a voltage it is of the signal alone"
