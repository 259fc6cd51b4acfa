"""Logs of a thrust stand as text, for tests of the import."""

import csv

import numpy as np
from import_zoo import truth

T = truth()
"""The zoo's log, in a record's units."""

HEADERS = {"time": "t [s]", "omega_ref": "speed cmd [rpm]", "beta_ref": "pitch cmd [deg]", "omega": "speed [rpm]"}
HEADERS |= {"thrust": "Fz [N]"}


def named(*names, **more):
    """Columns of the zoo's log under headers with their units; `more`: further columns, or others in their place."""
    return {HEADERS[name]: T[name] for name in names} | more


def table(path, columns, delimiter=","):
    """Columns as text, by the csv module; NaN is an empty cell."""
    with open(path, "w", newline="") as file:
        writer = csv.writer(file, delimiter=delimiter)
        writer.writerow(columns)
        for row in zip(*(np.asarray(c).tolist() for c in columns.values()), strict=True):
            writer.writerow("" if str(v) == "nan" else v for v in row)
    return path


def lagged(commands, step, lag):
    """(n,) a held command behind one lag, exactly: a row is measured before its command acts."""
    kept, out = np.exp(-step / lag), np.empty(len(commands))
    out[0] = commands[0]
    for k in range(1, len(commands)):
        out[k] = commands[k - 1] + kept * (out[k - 1] - commands[k - 1])
    return out


def stand(rows=6000, step=0.01, hold=1.5, lag=0.12, seed=5):
    """A thrust stand of fixed pitch: signal [us], speed [rpm] from a parabola and one lag, thrust [gf]."""
    rng = np.random.default_rng(seed)
    time = np.round(step * np.arange(rows), 6)
    signal = np.repeat(rng.integers(1150, 1900, rows), round(hold / step))[:rows].astype(float)
    speed = lagged(200.0 + 9.5 * (signal - 1000.0) - 0.0025 * (signal - 1000.0) ** 2, step, lag)
    thrust = 8.0 * (speed / 6000.0) ** 2 / 9.80665e-3 + rng.normal(0.0, 5.0, rows)
    return {"Time (s)": time, "ESC (us)": signal, "RPM": np.round(speed), "Thrust (gf)": np.round(thrust, 1)}
