"""Whitened residuals of a model against records of the same commands: the rows of every fit and of every test.

Records of the same commands are one experiment: they are simulated once, and their thrust is averaged. This divides the power
of the noise by their number and keeps the model error that they share. Speed is compared in each record separately, as the
tachometer reads it.
"""

from collections.abc import Callable, Mapping, Sequence
from copy import copy
from dataclasses import replace
from functools import cached_property

import numpy as np
from scipy.linalg import helmert
from scipy.sparse import csr_array

from identification.fit.converter import Converter
from identification.fit.noise import Noise, blocks
from identification.fit.tachometer import Tachometer, row_means
from identification.roles import Fitted
from vpp_fmu.native import Simulator
from vpp_fmu.native.simulator import PIECE
from vpp_fmu.record import Record
from vpp_fmu.sensors import SpeedSensor
from vpp_fmu.tracer import LANES

CHANNELS = ("thrust", "omega")
"""Outputs of a model that a record may measure and a fit may use."""

CACHED = 65536
"""Numbers in columns that are whitened together: half a MB."""


class Experiment:
    """Fitted records of the same commands. TypeError for a record of another role.

    `channels`: which of "thrust", "omega" the fit uses if a record has it.
    """

    def __init__(self, records: Sequence[Fitted], noise: Noise, channels: Sequence[str] = CHANNELS):
        if not all(isinstance(r, Fitted) for r in records):
            raise TypeError("a fit takes only records with the role of fitted ones")
        self.records = tuple(map(_on_ticks, records))
        own = [r.record for r in self.records]
        self.record, self.noise, self.channels = own[0], noise, tuple(channels)
        thrust = np.stack([_thrust(r, "thrust" in channels) for r in own])
        self._measured = np.isfinite(thrust).all(axis=0)
        self._there = np.isfinite(np.stack([_thrust(r, True) for r in own])).all(axis=0)
        self.thrust_rows = np.where(self._measured, thrust.mean(axis=0), np.nan)
        self._blocks = blocks(self.record, noise.block)
        self.thrust = self._blocks.mean(self.thrust_rows)
        order = noise.colour.order
        self._complete = _index(np.isfinite(noise.colour.whiten(self.thrust)))
        self._share = 1.0 / np.sqrt(len(own))  # standard deviation of the mean over that of one record
        self._averages = self.record.sensor.averaged
        self.thrust_time = self._blocks.time[order:][self._complete]
        self._read_speed([Tachometer(r) for r in own if "omega" in r and "omega" in channels])

    @cached_property
    def converter(self) -> Converter:
        """Converter of the thrust readings of all records."""
        thrust = [_thrust(r.record, "thrust" in self.channels) for r in self.records]
        return Converter.of(np.concatenate(thrust), self.noise.floor)

    @property
    def _is_fine(self) -> bool:
        """Whether the converter is assumed fine. The search for the readings' grid, which needs a sort, is then omitted."""
        return bool(np.isinf(self.noise.floor))

    def _read_speed(self, tachometers: list[Tachometer]) -> None:
        self.tachometers = tachometers
        self.omega_times = [t.times[self.noise.speed.order :] for t in tachometers]
        self.omega_time = np.concatenate(self.omega_times) if tachometers else np.zeros(0)
        self.sizes = {"thrust": len(self.thrust_time)}
        if len(self.omega_time):
            self.sizes["omega"] = len(self.omega_time)

    def measured_by(self, sensor: SpeedSensor) -> "Experiment":
        """The same records with their speed measured by another sensor."""
        other = copy(self)
        other._averages = sensor.averaged
        own = [replace(r.record, sensor=sensor) for r in self.records]
        other._read_speed([Tachometer(r) for r in own if "omega" in r and "omega" in self.channels])
        return other

    def of_noise(self, noise: Noise) -> "Experiment":
        """The same records with another noise model."""
        return Experiment(self.records, noise, self.channels)

    @property
    def compared(self) -> list[int]:
        """Columns of the model's outputs (rows, 3) that the fit compares: thrust, speed, or both."""
        return [i for i, channel in enumerate(CHANNELS) if self.sizes.get(channel)]

    def thrust_residual(self, predicted: np.ndarray) -> np.ndarray:
        """Whitened residual, predicted minus measured thrust (n, ...), from predicted thrust (rows, ...) N."""
        if not self.sizes["thrust"]:
            return np.zeros((0, *predicted.shape[1:]))
        shown = self._over_rows(predicted)
        shown = shown if self._is_fine else self.converter.reads(shown)
        means = self._blocks.mean(self._where_measured(shown))
        return self._white((means.T - self.thrust).T)

    def differences(self) -> np.ndarray:
        """(records - 1, n): samples of the noise of the whitened thrust residual, from orthonormal contrasts of the records."""
        thrust = np.stack([_thrust(one.record, "thrust" in self.channels) for one in self.records])
        contrasts = self._where_measured(self._share * (helmert(len(thrust)) @ thrust).T)
        return self._white(self._blocks.mean(contrasts)).T

    def thrust_columns(self, tangents: np.ndarray) -> np.ndarray:
        """Whitened change of the residual (n, ...) for a change, or for sensitivities, of the thrust (rows, ...) N."""
        if not (self.sizes["thrust"] and tangents.any()):
            return np.zeros((self.sizes["thrust"], *tangents.shape[1:]))
        return self._white(self._blocks.mean(self._where_measured(self._over_rows(tangents))))

    @cached_property
    def _row_means(self) -> csr_array:
        read = self.record.time[self._there]
        return row_means(self.record.time, float(np.median(np.diff(read))))

    def _over_rows(self, thrust: np.ndarray) -> np.ndarray:
        """Thrust (rows, ...) as the logger reads it: at its instants, or as means over the rows."""
        return self._row_means @ thrust if self._averages else thrust

    def sensitivities(
        self, simulator: Simulator, values: Mapping[str, float], into: np.ndarray | None = None
    ) -> tuple[np.ndarray, dict[str, np.ndarray]]:
        """(outputs (rows, 3), whitened sensitivities (n, wrt) by channel) of a simulator's model.

        `into` (n, wrt): an array for the sensitivities of thrust. The sensitivities of a long record need by far the most
        memory. If a block has several rows, the record is simulated in pieces, and only block means of the thrust's
        sensitivities are kept. A logger's means over its rows are then negligible, and omitted.
        """
        k, count, length = len(simulator.wrt), len(self._blocks.time), int(self._blocks.edges[1])
        speed = np.empty((len(self.record) * bool(len(self.omega_time)), k))
        wanted = {1: speed} if len(speed) else {}
        if not self.sizes["thrust"]:
            return simulator.simulate(values, *self.record.run, wanted), {"omega": self.omega_columns(speed)}
        means = np.empty((count, k)) if into is None or len(into) < count else into
        if length == 1:
            outputs = simulator.simulate(values, *self.record.run, {0: means} | wanted)
            thrust = self._thrust_tangents(slice(None), outputs, self._over_rows(means))
        else:
            outputs, first, rows = np.empty((len(self.record), len(simulator.outputs))), 0, max(1, PIECE // length) * length
            for at, shown, tangents in simulator.pieces(values, *self.record.run, rows=rows, of=self.compared):
                outputs[at] = shown
                own = self._blocks.part(at)
                if len(own.time):
                    means[first : first + len(own.time)] = own.mean(self._thrust_tangents(at, shown, tangents[:, 0]))
                    first += len(own.time)
                if len(speed):
                    speed[at] = tangents[:, 1]
            thrust = means
        found = {"thrust": self._white(thrust, means)}
        return outputs, found | ({"omega": self.omega_columns(speed)} if len(self.omega_time) else {})

    def _thrust_tangents(self, rows: slice, outputs: np.ndarray, tangents: np.ndarray) -> np.ndarray:
        """Sensitivities (rows, k) of the mean thrust reading in some rows, NaN where there is none."""
        shown = tangents if self._is_fine else self.converter.reading_tangents(tangents, outputs[:, 0])
        return self._where_measured(shown, rows)

    def omega_residual(self, predicted: np.ndarray) -> np.ndarray:
        """Whitened residual, predicted minus measured speed (n, ...), from predicted speed (rows, ...) rpm."""
        return self._white_readings([((t.shows(predicted).T - t.measured) / t.std).T for t in self.tachometers])

    def omega_columns(self, tangents: np.ndarray) -> np.ndarray:
        """Whitened change of the residual (n, ...) for a change, or for sensitivities, of the speed (rows, ...) rpm."""
        if not (len(self.omega_time) and tangents.any()):
            return np.zeros((len(self.omega_time), *tangents.shape[1:]))
        return self._white_readings([(t.shows(tangents).T / t.std).T for t in self.tachometers])

    def white_thrust(self, means: np.ndarray) -> np.ndarray:
        """Whitened change of the residual (n, ...) for a change of the thrust's block means (blocks, ...) N."""
        return self._white(means)

    def white_speed(self, shown: Sequence[np.ndarray]) -> np.ndarray:
        """Whitened change of the residual (n, ...) for a change of the readings (readings, ...) rpm of each tachometer."""
        return self._white_readings([(part.T / t.std).T for t, part in zip(self.tachometers, shown, strict=True)])

    def slow_thrust(self, rows: np.ndarray) -> np.ndarray:
        """Means of a thrust (rows,) [N] over 50 ms: its part below 10 Hz. Blocks without a reading are omitted."""
        means = blocks(self.record, 0.05).mean(np.where(self._there, rows, np.nan))
        return means[np.isfinite(means)]

    def _where_measured(self, predicted, at=slice(None)):
        """NaN at rows without a thrust reading, so that block means of prediction and reading use the same rows."""
        there = self._measured[at]
        return predicted if there.all() else np.where(there.reshape(-1, *[1] * (predicted.ndim - 1)), predicted, np.nan)

    def pull_back(self, weights: Mapping[str, np.ndarray], outputs: np.ndarray) -> np.ndarray:
        """The transpose of the sensitivities, for white noise: cotangents (rows, outputs). Their product with a change of the
        outputs equals the product of `weights` (n,), by channel, with the change of the residual.

        `outputs` (rows, outputs): the point of linearisation of a coarse converter.
        """
        cotangents, noise = np.zeros_like(outputs), self.noise
        if noise.colour.order or noise.speed.order:
            raise NotImplementedError("the adjoint gradient supports white noise only")
        means = np.zeros(len(self._blocks.time))
        means[self._complete] = weights["thrust"] / (self._share * noise.colour.innovation)
        slope = self.converter.slope(self._over_rows(outputs[:, 0]))
        cotangents[:, 0] = self._blocks.spread(means, self._measured) * slope
        if self._averages:
            cotangents[:, 0] = self._row_means.T @ cotangents[:, 0]
        ends = np.cumsum([len(time) for time in self.omega_times])
        parts = np.split(weights["omega"], ends[:-1]) if len(self.omega_time) else []
        for t, own in zip(self.tachometers, parts, strict=False):
            cotangents[:, 1] += t.transpose(own / (noise.speed.innovation * t.std))
        return cotangents

    def _white(self, means, into=None):
        colour = self.noise.colour
        if colour.is_white:
            return np.multiply(means, 1.0 / (colour.innovation * self._share), out=into)[self._complete]

        def white(columns):
            found = colour.whiten(columns)[self._complete]
            return np.divide(found, self._share, out=found)

        return _some_columns(white, means, into)

    def _white_readings(self, parts):
        return np.concatenate([_some_columns(self.noise.speed.whiten, part) for part in parts])


def _thrust(record: Record, counts: bool) -> np.ndarray:
    """(rows,) N; NaN if the record has no thrust or the fit does not use it."""
    return record["thrust"] if counts and "thrust" in record else np.full(len(record), np.nan)


TICKS = 256
"""Ticks of a row, to which the times of uneven rows are rounded. It moves a time by 1/512 of a row at most."""


def _on_ticks(one: Fitted) -> Fitted:
    """The record with its times rounded to TICKS of a row, if very many of its steps differ: a simulation then needs constants
    for some hundred steps, not for each row. Rounding does not add up over rows."""
    record, tick = one.record, round(one.record.period / TICKS, 9)
    if len(np.unique(record.steps)) <= 2 * TICKS or not tick > 0.0:
        return one
    time = np.round(np.round(record.time / tick) * tick, 9)
    return replace(one, record=record.with_columns(time=time)) if np.all(np.diff(time) > 0.0) else one


def _index(mask: np.ndarray) -> np.ndarray | slice:
    """Index of the rows in a mask: a slice, which copies nothing, if they are contiguous; else the mask."""
    there = np.flatnonzero(mask)
    whole = len(there) and there[-1] - there[0] == len(there) - 1
    return slice(int(there[0]), int(there[-1]) + 1) if whole else mask


def _some_columns(change: Callable[[np.ndarray], np.ndarray], values: np.ndarray, into: np.ndarray | None = None) -> np.ndarray:
    """Apply `change` to (rows,) or (rows, k), some columns at a time: as many as fit into a core's cache. More than LANES
    columns of a long record are taken one by one, to need little memory. `into`: an array that the result may overwrite; it may
    be `values`."""
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
