"""Linear response of thrust and speed to a small term at a port of the fitted model, on block means.

The blocks resolve each lag of a rig (BLOCKS_A_TIME per time scale), and are a tenth as many as the rows. The influence of the
fitted effects on a response is neglected: the responses only rank terms.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
from scipy.sparse import csr_array

from identification.diagnose.command_shapes import lagged
from identification.fit.experiment import Experiment
from identification.fit.noise import blocks
from vpp_fmu.kernel.effects.stage import INNER
from vpp_fmu.kernel.effects.thrust_map import normalised_thrust
from vpp_fmu.kernel.learned import DRIVERS, PORTS

TINY = 1e-30
"""Size of the complex step."""


@dataclass(frozen=True, eq=False)
class Course:
    """Simulation of one experiment with a fitted model, in block means of `step` s: drivers by name, each (blocks,), and the
    linear gains of a port's response."""

    experiment: Experiment
    step: float
    values: Mapping[str, float]
    drivers: Mapping[str, np.ndarray]
    thrust: np.ndarray
    w: np.ndarray
    to_pitch: np.ndarray
    to_speed: np.ndarray
    shows: tuple

    @classmethod
    def of(cls, experiment: Experiment, values: Mapping[str, float], outputs: np.ndarray) -> "Course":
        """`outputs` (rows, 3): thrust, speed and pitch of the model at `values`."""
        record, at = experiment.record, blocks(experiment.record, experiment.noise.block)
        thrust, speed, pitch = (at.mean(column) for column in outputs.T)
        base = SimpleNamespace(**{n: v for n, v in values.items() if "." not in n})
        w, b = speed / base.omega_scale, (pitch + base.beta_offset) / base.beta_scale
        slopes = [normalised_thrust(base, w + TINY * 1j * (1 - k), b + TINY * 1j * k).imag / TINY for k in (1, 0)]
        step = float(at.time[1] - at.time[0])
        commands = {u: at.mean(record[f"{u}_ref"]) for u in ("omega", "beta")}
        drivers = {"speed_command": commands["omega"], "pitch_command": commands["beta"], "speed": speed, "pitch": pitch}
        drivers |= {"thrust": thrust, "time": at.time}
        for name, signal, u in (("speed", speed, "omega"), ("pitch", pitch, "beta")):
            drivers |= {f"{name}_rate": np.gradient(signal, step), f"{name}_to_go": commands[u] - signal}
        grid = _grid(record.time, at.time)
        return cls(
            experiment,
            step,
            values,
            drivers,
            thrust,
            w,
            slopes[0] * base.thrust_scale / base.beta_scale,
            slopes[1] * base.thrust_scale / base.omega_scale,
            tuple(t.matrix @ grid for t in experiment.tachometers) if len(experiment.omega_time) else (),
        )

    def stage(self, u: str, form: float, swapped: bool) -> tuple[np.ndarray, float, float]:
        """(remaining change (blocks,) of a channel's lag, its time constant [s], the other lag's). `swapped`: lags in the other
        order."""
        inner_tau, outer_tau = self.values[f"tau_{u}_2"], self.values[f"tau_{u}_1"]
        inner_tau, outer_tau = (outer_tau, inner_tau) if swapped else (inner_tau, outer_tau)
        word = "speed" if u == "omega" else "pitch"
        command, reached = self.drivers[f"{word}_command"], self.drivers[word]
        inner = lagged(command, inner_tau, self.step)
        return (command - inner, inner_tau, outer_tau) if form == INNER else (inner - reached, outer_tau, inner_tau)

    def driver(self, name: str, port: str, form: float, swapped: bool) -> np.ndarray:
        """A driver (blocks,) at a port."""
        if DRIVERS[name].own_stage(PORTS[port]):
            return self.stage(PORTS[port].channel, form, swapped)[0]
        return self.drivers[name]

    def response(self, port: str, form: float, swapped: bool, terms: np.ndarray) -> tuple[np.ndarray, np.ndarray | None]:
        """(change of the thrust's block means (blocks, k) N, of the speed (blocks, k) rpm or None) for terms (blocks, k)."""
        place = PORTS[port]
        if port in ("thrust", "reading"):
            return terms, None
        if port == "thrust_share":
            return self.thrust[:, None] * terms, None
        u = place.channel
        if port.endswith("command_share"):
            terms = self.drivers["speed_command"][:, None] * terms
        if place.staged:
            remaining, tau, other = self.stage(u, form, swapped)
            terms = remaining[:, None] * terms if port.endswith("share") else tau * terms
            terms = lagged(terms, tau, self.step)
            if form == INNER:
                terms = lagged(terms, other, self.step)
        elif place.whole:
            terms = lagged(lagged(terms, self.values[f"tau_{u}_2"], self.step), self.values[f"tau_{u}_1"], self.step)
        if u == "beta":
            return self.to_pitch[:, None] * terms, None
        return self.to_speed[:, None] * terms, terms

    def speed_rows(self, speed: np.ndarray) -> np.ndarray:
        """Whitened rows (n, k) of a change (blocks, k) of the speed, rpm."""
        return self.experiment.white_speed([shows @ speed for shows in self.shows])


def _grid(time: np.ndarray, at: np.ndarray) -> csr_array:
    """Matrix (rows, blocks) that interpolates block means at the rows."""
    right = np.clip(np.searchsorted(at, time), 1, len(at) - 1)
    share = np.clip((time - at[right - 1]) / (at[right] - at[right - 1]), 0.0, 1.0)
    rows = np.arange(len(time))
    places = np.concatenate([rows, rows]), np.concatenate([right - 1, right])
    return csr_array((np.concatenate([1.0 - share, share]), places), shape=(len(time), len(at)))


def hats(v: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Linear B-splines (n, knots): each is 1 at its knot and 0 at the others, and constant beyond the ends."""
    k = np.clip(np.searchsorted(at, v) - 1, 0, len(at) - 2)
    share = np.clip((v - at[k]) / (at[k + 1] - at[k]), 0.0, 1.0)
    found = np.zeros((len(v), len(at)))
    rows = np.arange(len(v))
    found[rows, k], found[rows, k + 1] = 1.0 - share, share
    return found


def plays(v: np.ndarray, widths: np.ndarray) -> np.ndarray:
    """(n, widths): output of a play (backlash) of each half width, minus its input v (n,)."""
    at, found = np.full(len(widths), v[0]), np.empty((len(v), len(widths)))
    for k, now in enumerate(v.tolist()):
        at = np.minimum(np.maximum(at, now - widths), now + widths)
        found[k] = at
    return found - v[:, None]


def holds(v: np.ndarray, widths: np.ndarray) -> np.ndarray:
    """(n, widths): v (n,) held until it differs by more than a width, minus v."""
    at, found = np.full(len(widths), v[0]), np.empty((len(v), len(widths)))
    for k, now in enumerate(v.tolist()):
        at = np.where(np.abs(now - at) > widths, now, at)
        found[k] = at
    return found - v[:, None]


def relay(v: np.ndarray, lower: float, upper: float) -> np.ndarray:
    """Relay with hysteresis (n,): 1 from v > upper until v < lower; between them it starts at 0."""
    decided = (v > upper) | (v < lower)
    last = np.maximum.accumulate(np.where(decided, np.arange(len(v)), -1))
    return np.where(last >= 0, v[np.maximum(last, 0)] > upper, False).astype(float)


def knots_of(v: np.ndarray, signed: bool) -> np.ndarray:
    """Knots over the range of a driver (n,): equidistant, or denser about 0 for a signed driver."""
    low, high = np.quantile(v, [0.005, 0.995])
    if not signed:
        return np.linspace(low, high, 6) if high > low else np.zeros(0)
    reach = max(-low, high)
    if reach <= 0.0:
        return np.zeros(0)
    above = reach * np.array([0.04, 0.15, 0.4, 1.0])
    return np.concatenate([-above[::-1], [0.0], above])
