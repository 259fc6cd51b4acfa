"""Choose the speed command of a record: the commanded or the measured speed, whichever explains the steady thrust.

Poor speed control of a motor looks like errors of the thrust map. With the measured speed as the command, the model excludes
the motor and its errors.
"""

import numpy as np
from scipy.signal import lfilter

from identification.logs.kinds import typical_hold
from identification.logs.speed_map import UNSTEADY
from identification.static.static_map import design
from identification.static.steady import SETTLE, resting
from vpp_fmu.digits import number
from vpp_fmu.record import Record
from vpp_fmu.rig import infer_rig

LAGS = np.geomspace(0.01, 5.0, 40)
"""s, motor time constants to try for a command, which the motor follows."""

POOR = 3.0
"""Ratio of the rms speed error to the scatter within steady parts, from which the motor does not hold its command. Noise and
the end of a transient stay below it."""

PREFERS = 3.0
"""Minimum log-likelihood gain, nats, of the measured speed: odds of 20 to 1 for equal priors."""


def said_of_speed(record: Record) -> list[str]:
    """Propose the measured speed as the command, with the evidence; empty if the motor holds its command or the thrust is not
    explained better."""
    if "omega" not in record:
        return []
    settle = min(SETTLE, 0.5 * typical_hold(record))
    followed = record.with_columns(omega=np.where(np.isfinite(record["omega"]), _followed(record), np.nan))
    pairs = zip(resting(record, settle), resting(followed, settle), strict=True)
    held = [(s, f) for s, f in pairs if len(s.omega) > 1 and s.omega_ref > 0.0 and s.omega.std() < UNSTEADY * s.omega.mean()]
    if not held:
        return []
    found = [s for s, _ in held]
    command, beta = np.array([f.omega.mean() for _, f in held]), np.array([s.beta_ref for s in found])
    omega, thrust = (np.array([getattr(s, name).mean() for s in found]) for name in ("omega", "thrust"))
    misfit = float(np.sqrt(np.mean((command - omega) ** 2)))
    scatter = float(np.sqrt(np.mean([s.omega.var() for s in found])))
    gain = likelihood_gain(command, omega, beta, thrust)
    if misfit < POOR * scatter or gain < PREFERS:
        return []
    return [
        f"speed: at {len(found)} steady parts the measured speed is {number(misfit)} rpm (rms) off omega_ref and scatters by "
        f"{number(scatter)} rpm; it explains their thrust better by {gain:.1f} nats: "
        "--speed-from measured takes it as omega_ref"
    ]


def _followed(record: Record) -> np.ndarray:
    """(n,) rpm: the command after the lag that fits the measured speed best: a motor that still accelerates is not off it."""
    command, seen = record["omega_ref"], np.isfinite(record["omega"])
    tried = (command, *(_behind(lag, record.period, command) for lag in LAGS))
    return min(tried, key=lambda speed: float(np.mean((record["omega"] - speed)[seen] ** 2)))


def likelihood_gain(command: np.ndarray, omega: np.ndarray, beta: np.ndarray, thrust: np.ndarray) -> float:
    """Log-likelihood gain [nats] of steady thrust (n,) N if measured speed `omega` replaces the `command`, both rpm, in the
    thrust map at pitch `beta` [deg]:

        n / 2 log(S_command / S_omega),   S: sum of squared residuals of the fitted map

    Both maps have the same number of parameters, so penalties cancel. 0 if points are too few for a residual, or their
    thrust is 0.
    """
    sums = []
    for speed in (command, omega):
        points = {"omega_ref": speed, "omega": speed, "beta_ref": beta, "thrust": thrust}
        scales = vars(infer_rig([], points, {}).scales)
        found, _, rank, _ = np.linalg.lstsq(a := design(speed, beta, scales), thrust, rcond=1e-9)
        if len(thrust) <= rank + 2 or not thrust.any():
            return 0.0
        sums.append(max(float(np.sum((thrust - a @ found) ** 2)), 1e-12 * float(thrust @ thrust)))
    return 0.5 * len(thrust) * float(np.log(sums[0] / sums[1]))


def _behind(lag: float, step: float, values: np.ndarray) -> np.ndarray:
    """A first-order lag [s] of values (n,) in rows `step` s apart, at rest in the first row."""
    kept = float(np.exp(-step / lag))
    return values[0] + lfilter([0.0, 1.0 - kept], [1.0, -kept], values - values[0], axis=0)
