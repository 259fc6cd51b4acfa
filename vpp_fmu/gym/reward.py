"""The reward of a step, from tracking error, energy and wear of the actuators."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

Power = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""Power [W] (n,) at rotor speeds [rpm] (n,) and blade pitches [deg] (n,)."""


class Moment(NamedTuple):
    """The end of an action in n environments: all (n,).

    `thrust_set`, `thrust` [N]: the set-point while the action was held, the plant's thrust without noise; `omega` [rpm], `beta`
    [deg]: reached; `speed_travel`, `pitch_travel`: change of the commands by the action as shares of their ranges; `seconds`:
    duration of an action; `error_scale` [N]; `exceeded`: a limit of the rig was exceeded.
    """

    thrust_set: np.ndarray
    thrust: np.ndarray
    omega: np.ndarray
    beta: np.ndarray
    speed_travel: np.ndarray
    pitch_travel: np.ndarray
    seconds: float
    error_scale: float
    exceeded: np.ndarray


@dataclass(frozen=True)
class Reward:
    """Negative costs of a moment:

        -(error |thrust_set - thrust| / error_scale + energy P seconds + wear (speed_travel + pitch_travel)) - limit [exceeded]

    `energy` [1/J]: of `power`, by default the identified one. Without the cost `limit`, an early end of an episode would avoid
    the cost of further errors. Any other function of a Moment that returns (n,) serves as a reward, too.
    """

    error: float = 1.0
    energy: float = 0.0
    wear: float = 0.01
    limit: float = 100.0
    power: Power | None = None

    def __call__(self, m: Moment) -> np.ndarray:
        cost = self.error * np.abs(m.thrust_set - m.thrust) / m.error_scale
        cost += self.wear * (m.speed_travel + m.pitch_travel) + self.limit * m.exceeded
        if self.energy and self.power is not None:
            cost += self.energy * m.seconds * self.power(m.omega, m.beta)
        return -cost
