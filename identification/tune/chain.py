"""A controller with the measurement chain in its feedback, for simulation with plants of any kind."""

from collections.abc import Mapping

import numpy as np

from vpp_fmu.kernel.measurement import MEASUREMENT
from vpp_fmu.kernel.simulation import Simulation
from vpp_fmu.plants import Controller


class Measured:
    """`controller` after the measurement chain. `chain`: its values; `noise` (points,) N, one for each communication point."""

    def __init__(self, controller: Controller, chain: Mapping[str, float], noise: np.ndarray):
        self._controller, self._chain = controller, Simulation(MEASUREMENT, chain)
        self._noise, self._dt = noise, self._chain.parameters["sample_time"]

    def start(self, thrust_set: float, thrust: float) -> None:
        """Reset to the steady state at this thrust [N]."""
        self._noise_ahead = iter(self._noise.tolist())
        self._controller.start(thrust_set, self._chain.start({"thrust": thrust, "noise": 0.0})["reading"])

    def step(self, thrust_set: float, thrust: float) -> tuple[float, float]:
        """The next commands [rpm, deg]."""
        reading = self._chain.advance({"thrust": thrust, "noise": next(self._noise_ahead)}, self._dt)["reading"]
        return self._controller.step(thrust_set, reading)

    def close(self) -> None:
        """Release the controller."""
        self._controller.close()
