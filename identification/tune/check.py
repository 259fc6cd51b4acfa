"""Verify tuned gains with exported FMUs: these must reproduce the compiled loop of the search."""

import platform
import tempfile
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from vpp_fmu.export import native_fmu, python_fmu
from vpp_fmu.kernel.measurement import MEASUREMENT
from vpp_fmu.kernel.simulation import Simulation
from vpp_fmu.kernel.types import Model
from vpp_fmu.loop import run
from vpp_fmu.native.closed_loop import Course
from vpp_fmu.plants import Controller, FmuController, FmuPlant
from vpp_fmu.record import Record

WRAPPED = ("x86_64", "AMD64")
"""Machines for which pythonfmu has a wrapper; others use native FMUs."""


class Measured:
    """`controller` with the measurement chain in its feedback, for plants of any kind.

    `chain`: its values; `noise` (points,) N, one for each communication point.
    """

    def __init__(self, controller: Controller, chain: Mapping[str, float], noise: np.ndarray):
        self._controller, self._chain = controller, Simulation(MEASUREMENT, chain)
        self._noise, self._dt = noise, self._chain.parameters["sample_time"]

    def start(self, thrust_set: float, thrust: float) -> None:
        self._noise_ahead = iter(self._noise.tolist())
        self._controller.start(thrust_set, self._chain.start({"thrust": thrust, "noise": 0.0})["reading"])

    def step(self, thrust_set: float, thrust: float) -> tuple[float, float]:
        reading = self._chain.advance({"thrust": thrust, "noise": next(self._noise_ahead)}, self._dt)["reading"]
        return self._controller.step(thrust_set, reading)

    def close(self) -> None:
        self._controller.close()


def through_fmus(
    model: Model,
    values: Mapping[str, float],
    controller: Model,
    settings: Mapping[str, Mapping[str, float]],
    chain: Mapping[str, float],
    courses: Mapping[str, Course],
    profile: Record,
) -> dict[str, Record]:
    """Records of plant and controller FMUs over `profile`, one for each of the controller's `settings`, by name."""
    runs = {}
    with tempfile.TemporaryDirectory() as folder:
        paths = {each.name: Path(folder, f"{each.name}.fmu") for each in (model, controller)}
        make = python_fmu if platform.machine() in WRAPPED else native_fmu
        paths[model.name].write_bytes(make(model, values))
        paths[controller.name].write_bytes(make(controller))
        for name, own in settings.items():
            course = courses[name]
            plant = FmuPlant(paths[model.name], dt=course.dt)
            seen = Measured(FmuController(paths[controller.name], own, dt=course.dt), chain, course.noise)
            runs[name] = run(plant, seen, profile, course.rest)
            plant.close()
            seen.close()
    return runs


def largest_difference(first: Record, second: Record) -> float:
    return float(np.max(np.abs(first["thrust"] - second["thrust"])))
