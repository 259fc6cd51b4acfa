"""The dynamics of n environments, in arrays: commands from actions, plants, readings, rewards and ends of episodes."""

from collections.abc import Sequence
from typing import Protocol

import numpy as np

from vpp_fmu.gym.reward import Moment
from vpp_fmu.gym.task import RATE, Task

BOUNDS = {"thrust_set": 1e5, "thrust": 1e5, "omega": 4e5, "omega_ref": 4e5, "beta_ref": 180.0, "integral": 1e6}
"""Largest absolute value of an observation, in its unit."""


class Plants(Protocol):
    """Plants that are moved together: those of `vpp_fmu.native.many`, or one FMU."""

    outputs: Sequence[str]

    def begin(self, which: np.ndarray, parameters: np.ndarray, commands: np.ndarray) -> np.ndarray:
        """Start some at rest."""

    def advance(self, commands: np.ndarray, hold: int) -> np.ndarray:
        """Hold commands for some steps."""

    def close(self) -> None:
        """Let go of whatever is held."""


class Core:
    """n environments of a task. Each draws parameters, set-points and noise of an episode from its own generator at the
    episode's start, so that its numbers do not depend on its neighbours."""

    def __init__(self, task: Task, plants: Plants, count: int):
        self.task, self.plants, self.count = task, plants, count
        self.generators = [np.random.default_rng() for _ in range(count)]
        columns = task.actions + 1
        self.wanted, self.at = np.zeros((count, columns)), np.zeros(count, int)
        self._noise = np.zeros((count, columns, 2))
        self.parameters = np.zeros((count, len(task.plant.model.parameters)))
        self.commands, self._sample = np.zeros((count, 2)), np.zeros((count, 3))
        self._integral, self._past = np.zeros(count), np.zeros((count, task.history))
        self._rows = np.arange(count)
        self._order = [list(plants.outputs).index(name) for name in ("thrust", "omega", "beta")]
        self.bounds = np.array([*(BOUNDS[name] for name in task.observe), *[BOUNDS["thrust"]] * task.history])

    def reset(self, which: np.ndarray) -> None:
        """Begin an episode in the environments `which` (some,), at rest on the lowest commands."""
        task, (thrust, speed) = self.task, self.task.noise_std
        fixed = None if task.randomise else np.array(list(task.plant.values.values()))
        for n in which.tolist():
            rng = self.generators[n]
            self.parameters[n] = task.posterior.draw(rng) if fixed is None else fixed
            self.wanted[n] = task.set_points(rng)
            if thrust or speed:
                self._noise[n] = rng.standard_normal(self._noise.shape[1:]) * (thrust, speed)
        self.at[which], self._integral[which], self.commands[which] = 0, 0.0, task.low
        shown = self.plants.begin(which, self.parameters[which], self.commands[which])
        self._sample[which] = shown[:, self._order]
        self._past[which] = self._reading()[which, None]

    def step(self, actions: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Hold `actions` (n, 2), -1 to 1 of their ranges: (rewards, terminated, truncated), each (n,)."""
        task, rows = self.task, self._rows
        before, wanted = self.commands.copy(), self.wanted[rows, self.at]
        reading = self._reading()
        self._integral = np.clip(self._integral + (wanted - reading) * task.period, -BOUNDS["integral"], BOUNDS["integral"])
        if task.history:
            self._past[:, 1:], self._past[:, 0] = self._past[:, :-1].copy(), reading
        self.commands = self._commanded(np.clip(actions, -1.0, 1.0))
        self._sample = self.plants.advance(self.commands, task.hold)[:, self._order]
        self.at = np.minimum(self.at + 1, task.actions)
        thrust, omega, beta = self._sample.T
        exceeded = task.exceeded(thrust, omega, beta)
        travel = np.abs(self.commands - before) / np.where(task.high > task.low, task.high - task.low, 1.0)
        scale = task.rig.scales.thrust_scale
        moment = Moment(wanted, thrust, omega, beta, travel[:, 0], travel[:, 1], task.period, scale, exceeded)
        return np.asarray(task.reward(moment), float), exceeded, (self.at >= task.actions) & ~exceeded

    def observed(self) -> np.ndarray:
        """Observations (n, observed), in the task's order: thrust and speed as read, in N, rpm, deg, N s."""
        named = {
            "thrust_set": self.wanted[self._rows, self.at],
            "thrust": self._reading(),
            "omega": self._sample[:, 1] + self._noise[self._rows, self.at, 1],
            "omega_ref": self.commands[:, 0],
            "beta_ref": self.commands[:, 1],
            "integral": self._integral,
        }
        found = np.column_stack([*(named[name] for name in self.task.observe), self._past])
        return np.clip(np.nan_to_num(found), -self.bounds, self.bounds)

    def shown(self) -> dict[str, np.ndarray]:
        """What the plants do, without noise, by name: (n,) each."""
        thrust, omega, beta = self._sample.T.copy()
        return {"thrust": thrust, "omega": omega, "beta": beta, "omega_ref": self.commands[:, 0], "beta_ref": self.commands[:, 1]}

    def _reading(self) -> np.ndarray:
        return self._sample[:, 0] + self._noise[self._rows, self.at, 0]

    def _commanded(self, actions: np.ndarray) -> np.ndarray:
        """Commands (n, 2) [rpm, deg] of actions, as the policy's FMU computes them."""
        task = self.task
        move = task.rates * task.period
        if task.action == RATE:
            wanted = self.commands + actions * move
        else:
            wanted = task.low + (task.high - task.low) * (0.5 * (actions + 1.0))
        wanted = np.minimum(np.maximum(wanted, self.commands - move), self.commands + move)
        return np.minimum(np.maximum(wanted, task.low), task.high)
