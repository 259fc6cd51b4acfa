"""Static map and time constants of the physical rig model by the paper's protocol."""

import numpy as np
from scipy.optimize import least_squares

from hil.physics.rig_model import FULL_RIG
from vpp_fmu.native import Simulator

UP, DOWN = (2500.0, 3500.0, 4500.0, 5250.0, 6000.0), (5500.0, 4500.0, 3500.0, 2750.0, 2000.0)
PITCH_UP, PITCH_DOWN = (-6.0, -2.0, 2.0, 6.0, 10.0), (6.0, 2.0, -2.0, -6.0, -10.0)
DT, ROWS = 0.004, 626


def paper_thrust(omega, beta):
    """The paper's static map: thrust [N] of speed [rpm] and pitch [deg] (section 4.1)."""
    w, b = omega, beta
    return (0.21 * w**2 - 5.7 * w * b + 0.023 * w**2 * b - 1.25 * w * b**2 - 2.15e-6 * w**3) * 1e-6


def static_map() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(speeds, pitches, settled thrust) of the full model on the paper's 10 x 10 grid, pitch from -5 deg as its fit."""
    w, b = (x.ravel() for x in np.meshgrid(np.linspace(2000.0, 6000.0, 10), np.linspace(-5.0, 10.0, 10)))
    run = Simulator(FULL_RIG)
    points = zip(w, b, strict=True)
    settled = [run.simulate({}, {"omega_ref": np.full(2, x), "beta_ref": np.full(2, y)}, [DT])[0, 0] for x, y in points]
    return w, b, np.array(settled)


def speed_steps(pitches=(-10.0, -5.0, 0.0, 5.0, 10.0)):
    """The paper's speed steps: ((speed, pitch) before, (speed, pitch) after)."""
    return [((w0, b), (w1, b)) for b in pitches for w0, ends in ((2000.0, UP), (6000.0, DOWN)) for w1 in ends]


def pitch_steps(speeds=(2000.0, 3000.0, 4000.0, 5000.0, 6000.0)):
    """The paper's pitch steps."""
    return [((w, b0), (w, b1)) for w in speeds for b0, ends in ((-10.0, PITCH_UP), (10.0, PITCH_DOWN)) for b1 in ends]


def two_lags_fitted(time, y) -> list[float]:
    """Time constants [s] of two lags that fit a step best, the slower first."""
    share = (y - y[0]) / (y[-1] - y[0])

    def error(p):
        a, b = abs(p[0]) + 1e-6, abs(p[1])
        return 1.0 - (a * np.exp(-time / a) - b * np.exp(-time / max(b, 1e-9))) / (a - b) - share

    runs = [least_squares(error, start) for start in ((0.15, 0.04), (0.2, 0.19))]
    return sorted(np.abs(min(runs, key=lambda run: run.cost).x), reverse=True)


def time_constants(steps, column: int) -> np.ndarray:
    """Mean time constants over `steps`: (slow, fast) in thrust, (slow, fast) in output `column` (1 speed, 2 pitch)."""
    found, time, run = [], np.arange(ROWS) * DT, Simulator(FULL_RIG)
    for (w0, b0), (w1, b1) in steps:
        inputs = {"omega_ref": np.r_[w0, np.full(ROWS, w1)], "beta_ref": np.r_[b0, np.full(ROWS, b1)]}
        y = run.simulate({}, inputs, np.r_[1e-9, np.full(ROWS - 1, DT)])[1:]
        found.append([*two_lags_fitted(time, y[:, 0]), *two_lags_fitted(time, y[:, column])])
    return np.mean(found, axis=0)
