"""Whether what a set leaves still follows the commands in a way that no candidate has.

Forms that differ little (a play, a dead zone, a stop) leave little beside each other, spread over a whole record: too little to
show in the power of the repeatable error, and with the right form not among the candidates no further name takes it up. But any
hysteresis that does not depend on rate is a sum of plays (Prandtl and Ishlinskii; Brokate and Sprekels, Hysteresis and Phase
Transitions, 1996, chapter 2), and what a drive does late or not at all is a function of the way still to go. A few of each,
as they are and lagged, span what such forms leave.
"""

from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
from scipy.signal import lfilter
from scipy.stats import chi2

from identification.diagnose.evidence.linearised import Linearised
from identification.diagnose.search.fits import Fit
from vpp_fmu.kernel.effects.thrust_map import normalised_thrust
from vpp_fmu.native import Simulator
from vpp_fmu.record import Record

WIDTHS = (0.012, 0.03, 0.08, 0.2)
"""Half widths of plays and of bounds on the way still to go, as shares of the range that the output goes through."""

LAGS = (0.0, 0.06, 0.2)
"""s; about those of the actuators."""

DEPENDENT = 0.05
"""Size of a direction, over that of the strongest, below which columns count as the same one."""

CERTAIN = 0.999
"""Level of the test."""


@dataclass(frozen=True)
class Following:
    """Log-likelihood that `count` columns gain beside a fit, less the half each that noise alone would give them."""

    gain: float
    count: int

    @property
    def significant(self) -> bool:
        """Whether noise alone would hardly ever give as much."""
        return self.count > 0 and bool(2.0 * self.gain + self.count > chi2.ppf(CERTAIN, self.count))


def following(fit: Fit) -> Following:
    """How far the thrust residual of a fit follows the commands still, beyond what its parameters could take up."""
    evidence, about, rows = fit.evidence, Linearised.of(fit.evidence, fit.solution), []
    simulator = Simulator(evidence.model)
    for e in evidence.experiments:
        outputs = simulator.simulate(fit.values, e.record.columns, e.record.steps)
        rows.append(e.thrust_columns(_columns(fit, e.record, outputs)))
    thrust = np.vstack(rows) / evidence.scale["thrust"]
    columns = np.zeros((evidence.size, thrust.shape[1]))
    columns[: len(thrust)] = thrust  # speed's rows come after
    columns = np.column_stack([about.apart(c) for c in columns.T])
    columns /= np.maximum(np.linalg.norm(columns, axis=0), np.finfo(float).tiny)
    directions, size, _ = np.linalg.svd(columns, full_matrices=False)
    directions = directions[:, size > DEPENDENT * size[0]]
    return Following(0.5 * float(np.sum((directions.T @ about.residual) ** 2 - 1.0)), directions.shape[1])


def _columns(fit: Fit, record: Record, outputs: np.ndarray) -> np.ndarray:
    """(rows, columns) N: what a change of pitch or of speed in these forms would do to the thrust."""
    speed, pitch = outputs[:, 1], outputs[:, 2]
    values = SimpleNamespace(**{n: v for n, v in fit.values.items() if "." not in n})
    w, b = speed / values.omega_scale, (pitch + values.beta_offset) / values.beta_scale
    tiny = 1e-30  # the map's slopes by complex step: exact
    to_pitch, to_speed = (
        normalised_thrust(values, w + tiny * 1j * (1 - of_b), b + tiny * 1j * of_b).imag / tiny for of_b in (1, 0)
    )
    step = float(np.median(record.steps))
    shapes = [to_pitch * _lagged(s, lag, step) for s in _shapes(record["beta_ref"], pitch, step) for lag in LAGS]
    shapes += [to_speed * _lagged(s, lag, step) for s in _shapes(record["omega_ref"], speed, step) for lag in LAGS]
    return np.column_stack(shapes)


def _shapes(command: np.ndarray, output: np.ndarray, step: float) -> list[np.ndarray]:
    """The forms (rows,) of one channel."""
    rate, to_go = np.gradient(output, step), command - output
    widths = [share * np.ptp(output) for share in WIDTHS]
    bounded, plays = [np.clip(to_go, -w, w) for w in widths], [output - _play(output, w) for w in widths[:-1]]
    return [*bounded, *plays, rate, np.abs(rate)]


def _play(signal: np.ndarray, width: float) -> np.ndarray:
    """What follows (rows,) a signal with play of `width` to each side."""
    followed, at = np.empty_like(signal), float(signal[0])
    for k, now in enumerate(signal.tolist()):
        at = min(max(at, now - width), now + width)
        followed[k] = at
    return followed


def _lagged(signal: np.ndarray, time_constant: float, step: float) -> np.ndarray:
    if time_constant == 0.0:
        return signal
    kept = np.exp(-step / time_constant)
    return lfilter([1.0 - kept], [1.0, -kept], signal, zi=[kept * signal[0]])[0]
