"""Fisher information of commands about a model's parameters, before an experiment.

    F = sum over samples of s s^T / noise^2,   s = d output / d parameter at the given values;   covariance = F^-1

Exact for small errors under white noise (Cramer and Rao). It ignores model error, and a threshold that is not crossed has zero
information. All matrices are in relative units: each parameter divided by its size.
"""

import os
from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import dataclass

import numpy as np

from identification.fit.problem import Prior
from identification.fit.uncertainty import NORMAL_95
from vpp_fmu.errors import BadInput
from vpp_fmu.kernel.types import Model
from vpp_fmu.native import Simulator
from vpp_fmu.structured import read_object, shown

SMALLEST = 0.05
"""Minimum size of a parameter, as a share of its nominal value: 0 has no relative error."""

NOTHING = 1e-8
"""Information added to every parameter before inversion: a standard deviation of 10 000 times its size."""


@dataclass(frozen=True, eq=False)
class Forecast:
    """Forecast for the parameters `names` after an experiment: `values` and `size` (n,), `covariance` (n, n), in their
    units."""

    names: tuple[str, ...]
    values: np.ndarray
    size: np.ndarray
    covariance: np.ndarray

    @property
    def std(self) -> np.ndarray:
        """(n,)"""
        return np.sqrt(np.diag(self.covariance))

    @property
    def intervals(self) -> np.ndarray:
        """(n, 2) 95 % intervals."""
        half = NORMAL_95 * self.std
        return np.column_stack([self.values - half, self.values + half])

    @property
    def relative(self) -> np.ndarray:
        """(n,): standard deviations divided by the parameters' sizes."""
        return self.std / self.size

    @property
    def typical(self) -> float:
        """Root mean square of the relative standard deviations, which a plan minimises."""
        return float(np.sqrt(np.mean(self.relative**2)))

    def weakest(self) -> tuple[np.ndarray, float]:
        """(weakest direction (n,) of unit length in relative units, its standard deviation)."""
        spread, vectors = np.linalg.eigh(self.covariance / np.outer(self.size, self.size))
        direction = vectors[:, -1]
        return direction * np.sign(direction[np.argmax(np.abs(direction))]), float(np.sqrt(spread[-1]))


class Information:
    """Fisher information of commands for a model at `values` (all of its parameters), in the parameters `names`.

    `noise_std` N: white noise of a thrust reading, one every `sampling` seconds. `omega_std` rpm: of a tachometer's reading, at
    most one a revolution; its averaging over the revolution is neglected. None: speed is not measured. Inputs of the model
    other than the commands have their nominal value.
    """

    def __init__(
        self,
        model: Model,
        values: Mapping[str, float],
        names: Sequence[str],
        noise_std: float,
        sampling: float,
        omega_std: float | None = None,
    ):
        self.model, self.names = model, tuple(names)
        self.all_values = model.values(values)
        declared = {p.name: p for p in model.parameters}
        self.values = np.array([self.all_values[n] for n in self.names])
        self.size = np.maximum(np.abs(self.values), SMALLEST * np.array([declared[n].nominal for n in self.names]))
        self._noise, self._omega_noise, self._sampling = noise_std, omega_std, sampling
        self._simulator, self._columns = Simulator(model, self.names), np.arange(len(self.names))
        self._thrust, self._omega = (self._simulator.outputs.index(n) for n in ("thrust", "omega"))

    def only(self, names: Sequence[str]) -> "Information":
        """The same for the parameters `names` alone; the others are known."""
        chosen = [self.names.index(name) for name in names]
        fewer = copy(self)
        fewer.names, fewer._columns = tuple(names), self._columns[chosen]
        fewer.values, fewer.size = self.values[chosen], self.size[chosen]
        return fewer

    def thrust(self, commands: np.ndarray, step: float) -> np.ndarray:
        """Predicted thrust (rows,) N."""
        return self._response(commands, step)[0][:, self._thrust]

    def of(self, commands: np.ndarray, step: float) -> np.ndarray:
        """F (n, n) in relative units of `commands` (rows, 2) [rpm, deg], one row every `step` seconds.

        A step longer than the sampling period counts as several equal readings.
        """
        outputs, tangents = self._response(commands, step)
        readings = step / self._sampling
        rows = tangents[:, self._thrust] * (self.size * (np.sqrt(readings) / self._noise))
        if self._omega_noise is not None:
            pulses = np.minimum(outputs[:, self._omega] / 60.0 * step, readings)
            speed = tangents[:, self._omega] * self.size * (np.sqrt(pulses) / self._omega_noise)[:, None]
            rows = np.vstack([rows, speed])
        return np.einsum("ri,rj->ij", rows, rows)  # not BLAS: its threads are slower at this size

    def known(self, knowledge: Prior | None) -> np.ndarray:
        """F (n, n) of a prior in relative units, without parameters that are not in `names`."""
        information = np.zeros((len(self.names), len(self.names)))
        if knowledge is not None:
            rows = [k for k, n in enumerate(knowledge.names) if n in self.names]
            at = np.ix_(*[[self.names.index(knowledge.names[k]) for k in rows]] * 2)
            size = np.array([self.size[self.names.index(knowledge.names[k])] for k in rows])
            information[at] = np.linalg.inv(knowledge.covariance[np.ix_(rows, rows)]) * np.outer(size, size)
        return information

    def forecast(self, information: np.ndarray) -> Forecast:
        """Forecast after an experiment of this information (n, n)."""
        covariance = np.linalg.inv(information + NOTHING * np.eye(len(self.names)))
        return Forecast(self.names, self.values, self.size, covariance * np.outer(self.size, self.size))

    def _response(self, commands: np.ndarray, step: float) -> tuple[np.ndarray, np.ndarray]:
        """Outputs (rows, outputs) and their derivatives (rows, outputs, n) under commands."""
        inputs = {u.name: np.full(len(commands), u.nominal) for u in self.model.inputs if not u.clock}
        inputs |= {"omega_ref": commands[:, 0], "beta_ref": commands[:, 1]}
        outputs, tangents = self._simulator.sensitivities(self.all_values, inputs, np.full(len(commands) - 1, step))
        return outputs, tangents[:, :, self._columns]


def read_knowledge(path: str | os.PathLike) -> tuple[Prior, float]:
    """(prior, median inflation of the standard deviations by coloured residuals) from an `identification.json`. BadInput for
    another file."""
    allowed = "an identification.json, as vpp identify writes it"
    content = read_object(path, allowed=allowed)
    try:
        names = content["correlation"]["names"]
        fitted = [content["parameters"][name] for name in names]
        mean, std = (np.array([float(entry[key]) for entry in fitted]) for key in ("value", "std"))
        correlation = np.array(content["correlation"]["matrix"], float).reshape(len(names), len(names))
        inflation = [float(x) for x in content.get("inflation_by_coloured_residuals", {}).values()] or [1.0]
    except (AttributeError, KeyError, TypeError, ValueError) as error:
        raise BadInput(path, "parameters, correlation", f"{type(error).__name__} {error}", allowed) from error
    determined = np.flatnonzero(std > 0)
    covariance = correlation[np.ix_(determined, determined)] * np.outer(std[determined], std[determined])
    if (
        not len(determined)
        or not np.isfinite(covariance).all()
        or np.linalg.eigvalsh(correlation[np.ix_(determined, determined)])[0] <= 0.0
    ):
        raise BadInput(path, "correlation", "no covariance that can be inverted", allowed)
    return Prior(tuple(names[k] for k in determined), mean[determined], covariance), float(np.median(inflation))


def read_noise(path: str | os.PathLike) -> tuple[float, str] | None:
    """(standard deviation of a thrust reading [N], its source) from an `identification.json`; None if the file has none.
    BadInput for another file or value."""
    content = read_object(path, allowed="an identification.json, as vpp identify writes it")
    noise = content.get("noise_floor_thrust")
    if noise is None:
        return None
    if isinstance(noise, bool) or not isinstance(noise, int | float) or noise < 0.0:
        raise BadInput(path, "noise_floor_thrust", shown(noise), "a number in N, from 0")
    return float(noise), str(content.get("noise_floor_thrust_from", path))
