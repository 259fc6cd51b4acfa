"""What records of the same commands tell of a model, as whitened residuals: the rows of every fit and of every judgement.

Records of the same commands are one experiment: they are simulated once, and their thrust is averaged, which divides the
noise's power by their number, and leaves what they share beyond the model what it is. Speed is compared as the tachometer
shows it, in each record by itself.
"""

from collections.abc import Callable, Mapping, Sequence
from copy import copy
from dataclasses import replace

import numpy as np
from scipy.linalg import helmert

from identification.fit.converter import Converter
from identification.fit.noise import Noise, blocks
from identification.fit.tachometer import Tachometer
from identification.roles import Fitted
from vpp_fmu.native import Simulator
from vpp_fmu.native.simulator import PIECE
from vpp_fmu.record import Record
from vpp_fmu.sensors import SpeedSensor
from vpp_fmu.tracer import LANES

CHANNELS = ("thrust", "omega")
"""What a record may measure, and a fit may take, of a model's outputs."""

CACHED = 65536
"""Numbers that are whitened at once, where they are columns: half a MB."""


class Experiment:
    """Fitted records of the same commands, and what of them counts. TypeError for a record of another role.

    `channels`: what of "thrust", "omega" counts where a record has it.
    """

    def __init__(self, records: Sequence[Fitted], noise: Noise, channels: Sequence[str] = CHANNELS):
        if not all(isinstance(r, Fitted) for r in records):
            raise TypeError("only records that are there to be fitted may be fitted")
        own = [r.record for r in records]
        self.records, self.record, self.noise, self.channels = tuple(records), own[0], noise, tuple(channels)
        thrust = np.stack([_thrust(r, "thrust" in channels) for r in own])
        self._there = np.isfinite(thrust).all(axis=0)
        self.thrust_rows = np.where(self._there, thrust.mean(axis=0), np.nan)
        self.converter = Converter.of(np.concatenate(thrust), noise.floor)
        self._blocks = blocks(self.record, noise.block)
        self.thrust = self._blocks.mean(self.thrust_rows)
        order = noise.colour.order
        self._seen = _indexed(np.isfinite(noise.colour.whiten(self.thrust)))
        self._share = 1.0 / np.sqrt(len(own))  # the mean's noise
        self.thrust_time = self._blocks.time[order:][self._seen]
        self._read_speed([Tachometer(r) for r in own if "omega" in r and "omega" in channels])

    def _read_speed(self, tachometers: list[Tachometer]) -> None:
        self.tachometers = tachometers
        self.omega_times = [t.times[self.noise.speed.order :] for t in tachometers]
        self.omega_time = np.concatenate(self.omega_times) if tachometers else np.zeros(0)
        self.sizes = {"thrust": len(self.thrust_time)}
        if len(self.omega_time):
            self.sizes["omega"] = len(self.omega_time)

    def measured_by(self, sensor: SpeedSensor) -> "Experiment":
        """The same records, their speed read by another sensor."""
        other = copy(self)
        own = [replace(r.record, sensor=sensor) for r in self.records]
        other._read_speed([Tachometer(r) for r in own if "omega" in r and "omega" in self.channels])
        return other

    def of_noise(self, noise: Noise) -> "Experiment":
        """The same of other noise."""
        return Experiment(self.records, noise, self.channels)

    @property
    def compared(self) -> list[int]:
        """Columns of the model's outputs (rows, 3) that these records measure: thrust, and speed where it is there."""
        return [0, 1] if len(self.omega_time) else [0]

    def thrust_residual(self, predicted: np.ndarray) -> np.ndarray:
        """Whitened predicted less measured thrust (n, ...), from thrust (rows, ...) N."""
        means = self._blocks.mean(self._where_measured(self.converter.reads(predicted)))
        return self._white((means.T - self.thrust).T)

    def differences(self) -> np.ndarray:
        """(records - 1, n) samples of the noise that the whitened thrust residual has, from what the records don't share."""
        thrust = np.stack([_thrust(one.record, "thrust" in self.channels) for one in self.records])
        apart = self._where_measured(self._share * (helmert(len(thrust)) @ thrust).T)
        return self._white(self._blocks.mean(apart)).T

    def thrust_columns(self, tangents: np.ndarray) -> np.ndarray:
        """Whitened change of the residual (n, ...) for a change, or for sensitivities, of the thrust (rows, ...) N."""
        if not tangents.any():  # what runs into nothing changes nothing
            return np.zeros((self.sizes["thrust"], *tangents.shape[1:]))
        return self._white(self._blocks.mean(self._where_measured(tangents)))

    def sensitivities(self, simulator: Simulator, values: Mapping[str, float]) -> tuple[np.ndarray, dict[str, np.ndarray]]:
        """(outputs (rows, 3), whitened sensitivities (n, k) by channel) of a simulator's model.

        The record is run in pieces: of a long one, sensitivities are by far the largest thing in memory, and only block means
        of those of thrust are kept.
        """
        length, k = int(self._blocks.edges[1]), len(simulator.wrt)
        means, speed = np.empty((len(self._blocks.time), k)), np.empty((len(self.record) * bool(len(self.omega_time)), k))
        outputs, first = np.empty((len(self.record), len(simulator.outputs))), 0
        rows = max(1, PIECE // length) * length
        for at, shown, tangents in simulator.pieces(values, *self.record.run, rows=rows):
            outputs[at] = shown
            own = self._blocks.part(at)
            if len(own.time):
                thrust = (tangents[:, 0].T * self.converter.slope(shown[:, 0])).T
                means[first : first + len(own.time)] = own.mean(self._where_measured(thrust, at))
                first += len(own.time)
            if len(speed):
                speed[at] = tangents[:, 1]
        found = {"thrust": self._white(means, means)}
        return outputs, found | ({"omega": self.omega_columns(speed)} if len(self.omega_time) else {})

    def omega_residual(self, predicted: np.ndarray) -> np.ndarray:
        """Whitened predicted less measured speed (n, ...), from speed (rows, ...) rpm."""
        return self._heard([((t.shows(predicted).T - t.measured) / t.std).T for t in self.tachometers])

    def omega_columns(self, tangents: np.ndarray) -> np.ndarray:
        """Whitened change of the residual (n, ...) for a change, or for sensitivities, of the speed (rows, ...) rpm."""
        if not tangents.any():
            return np.zeros((len(self.omega_time), *tangents.shape[1:]))
        return self._heard([(t.shows(tangents).T / t.std).T for t in self.tachometers])

    def white_thrust(self, means: np.ndarray) -> np.ndarray:
        """Whitened change of the residual (n, ...) for a change of the thrust's block means (blocks, ...) N."""
        return self._white(means)

    def white_speed(self, shown: Sequence[np.ndarray]) -> np.ndarray:
        """Whitened change of the residual (n, ...) for one of what each tachometer shows (readings, ...) rpm."""
        return self._heard([(part.T / t.std).T for t, part in zip(self.tachometers, shown, strict=True)])

    def slow_thrust(self, rows: np.ndarray) -> np.ndarray:
        """Means of a thrust (rows,) [N] over 50 ms, what is below 10 Hz of it; blocks without a reading left out."""
        means = blocks(self.record, 0.05).mean(self._where_measured(rows))
        return means[np.isfinite(means)]

    def _where_measured(self, predicted, at=slice(None)):
        """NaN where no thrust was read, so that block means of both are over the same rows."""
        there = self._there[at]
        return predicted if there.all() else np.where(there.reshape(-1, *[1] * (predicted.ndim - 1)), predicted, np.nan)

    def pull_back(self, weights: Mapping[str, np.ndarray], outputs: np.ndarray) -> np.ndarray:
        """The transpose of the sensitivities: cotangents (rows, outputs) such that their product with any change of the outputs
        is that of `weights` (n,), by channel, with what it does to the residual. For white noise.

        `outputs` (rows, outputs): where the change is taken, for what a coarse converter makes of it.
        """
        cotangents, noise = np.zeros_like(outputs), self.noise
        if noise.colour.order or noise.speed.order:
            raise NotImplementedError("an adjoint goes through white noise only")
        means = np.zeros(len(self._blocks.time))
        means[self._seen] = weights["thrust"] / (self._share * noise.colour.innovation)
        cotangents[:, 0] = self._blocks.spread(means, self._there) * self.converter.slope(outputs[:, 0])
        ends = np.cumsum([len(time) for time in self.omega_times])
        parts = np.split(weights["omega"], ends[:-1]) if len(self.omega_time) else []
        for t, own in zip(self.tachometers, parts, strict=False):
            cotangents[:, 1] += t.transpose(own / (noise.speed.innovation * t.std))
        return cotangents

    def _white(self, means, into=None):
        def white(columns):
            found = self.noise.colour.whiten(columns)[self._seen]
            return np.divide(found, self._share, out=found)

        return _some_columns(white, means, into)

    def _heard(self, parts):
        return np.concatenate([_some_columns(self.noise.speed.whiten, part) for part in parts])


def _thrust(record: Record, counts: bool) -> np.ndarray:
    """(rows,) N; of a record without it, or where it does not count, none was read."""
    return record["thrust"] if counts and "thrust" in record else np.full(len(record), np.nan)


def _indexed(mask: np.ndarray) -> np.ndarray | slice:
    """What takes the same rows: a slice, which copies nothing, where they stand together."""
    there = np.flatnonzero(mask)
    whole = len(there) and there[-1] - there[0] == len(there) - 1
    return slice(int(there[0]), int(there[-1]) + 1) if whole else mask


def _some_columns(change: Callable[[np.ndarray], np.ndarray], values: np.ndarray, into: np.ndarray | None = None) -> np.ndarray:
    """`change` of (rows,) or (rows, k), some columns at a time: as many as stay in a core's cache, of a long record one by one
    where there are more than LANES, so that what it needs beside them is small. `into`: an array, `values` itself for one, that
    the result may overwrite."""
    if values.ndim == 1 or not values.size:
        return change(values)
    columns = values.reshape(len(values), -1)
    width = CACHED // len(columns)
    if columns.shape[1] <= max(LANES, width):
        return change(columns).reshape(-1, *values.shape[1:])
    found, width = into, max(1, width)
    for at in range(0, columns.shape[1], width):
        part = change(columns[:, at : at + width])
        if not at:
            found = np.empty((len(part), columns.shape[1])) if into is None else into[: len(part)]
        found[:, at : at + width] = part
    return found.reshape(len(found), *values.shape[1:])
