"""The dynamics of n environments, in arrays: commands from actions, plants, readings, rewards and ends of episodes."""

import numpy as np

from vpp_fmu.gym.reward import Moment
from vpp_fmu.gym.task import RATE, Task
from vpp_fmu.kernel.effects.policy import LARGEST_INTEGRAL
from vpp_fmu.native.many import ManyPlants

BOUNDS = {"thrust_set": 1e5, "thrust": 1e5, "omega": 4e5, "omega_ref": 4e5, "beta_ref": 180.0, "integral": LARGEST_INTEGRAL}
"""Largest absolute value of an observation, in its unit."""


class Core:
    """n environments of a task. Each draws parameters, set-points and noise of an episode from its own generator at the
    episode's start, so that its numbers do not depend on its neighbours."""

    def __init__(self, task: Task, count: int):
        self.task, self.count, self._pays = task, count, task.pays
        self.plants = plants = ManyPlants(task.plant.model, count, task.step)
        self.generators = [np.random.default_rng() for _ in range(count)]
        self.parameters = np.zeros((count, len(task.plant.model.parameters)))
        self._columns, self._at = task.actions + 1, np.zeros(count, int)
        self._wanted = np.zeros((self._columns, count))
        self._noise = [np.zeros(self._wanted.shape if std else 0) for std in task.noise_std]
        # Quantities in rows, environments in columns: numpy's inner loops then run over all environments.
        self._commands, self._sample = np.zeros((2, count)), np.zeros((3, count))
        self._now = np.zeros((3, count))  # set-point, readings of thrust and speed
        self._integral, self._past = np.zeros(count), np.zeros((task.history, count))
        self._rows = np.arange(count)
        self._order = [list(plants.outputs).index(name) for name in ("thrust", "omega", "beta")]
        self.bounds = np.array([*(BOUNDS[name] for name in task.observe), *[BOUNDS["thrust"]] * task.history])
        self._low, self._high, self._move = (v[:, None] for v in (task.low, task.high, task.rates * task.period))
        self._range = np.where(self._high > self._low, self._high - self._low, 1.0)

    def reset(self, which: np.ndarray) -> None:
        """Begin an episode in the environments `which` (some,), at rest on the lowest commands."""
        task = self.task
        fixed = None if task.randomise else np.array(list(task.plant.values.values()))
        for n in which.tolist():
            rng = self.generators[n]
            self.parameters[n] = task.posterior.draw(rng) if fixed is None else fixed
            self._wanted[:, n] = task.set_points(rng)
            for noise, std in zip(self._noise, task.noise_std, strict=True):
                if std:
                    noise[:, n] = std * rng.standard_normal(self._columns)
        self._at[which], self._integral[which], self._commands[:, which] = 0, 0.0, self._low
        shown = self.plants.begin(which, self.parameters[which], self._commands[:, which].T)
        self._sample[:, which] = shown[:, self._order].T
        self._read()
        self._past[:, which] = self._now[1, which]

    def step(self, actions: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Hold `actions` (n, 2), -1 to 1 of their ranges: (rewards, terminated, truncated), each (n,)."""
        task, before = self.task, self._commands
        wanted, reading = self._now[0].copy(), self._now[1]
        error = wanted - reading
        moves = np.where(error > 0.0, (before < self._high).any(axis=0), (before > self._low).any(axis=0))
        grown = np.minimum(np.maximum(self._integral + error * task.period, -LARGEST_INTEGRAL), LARGEST_INTEGRAL)
        self._integral = np.where(moves, grown, self._integral)
        if task.history:
            self._past = np.vstack([reading, self._past[:-1]])
        self._commands = self._commanded(np.minimum(np.maximum(actions.T, -1.0), 1.0))
        self._sample = self.plants.advance(self._commands.T, task.hold)[:, self._order].T.copy()
        self._at = np.minimum(self._at + 1, task.actions)
        self._read()
        thrust, omega, beta = self._sample
        exceeded = task.exceeded(thrust, omega)
        travel = np.abs(self._commands - before) / self._range
        moment = Moment(wanted, thrust, omega, beta, *travel, task.period, task.rig.scales.thrust_scale, exceeded)
        return np.asarray(self._pays(moment), float), exceeded, (self._at >= task.actions) & ~exceeded

    def observed(self) -> np.ndarray:
        """Observations (n, observed), in the task's order: thrust and speed as read, in N, rpm, deg, N s."""
        wanted, thrust, omega = self._now
        named = {
            "thrust_set": wanted,
            "thrust": thrust,
            "omega": omega,
            "omega_ref": self._commands[0],
            "beta_ref": self._commands[1],
            "integral": self._integral,
        }
        found = np.empty((self.count, len(self.bounds)))
        for k, values in enumerate([*(named[name] for name in self.task.observe), *self._past]):
            found[:, k] = np.fmin(np.fmax(values, -self.bounds[k]), self.bounds[k])
        return found

    def shown(self) -> dict[str, np.ndarray]:
        """Outputs without noise, and commands, by name: (n,) each; the next step makes new arrays."""
        return dict(zip(("thrust", "omega", "beta", "omega_ref", "beta_ref"), (*self._sample, *self._commands), strict=True))

    def _read(self) -> None:
        at = self._at * self.count + self._rows
        self._now = np.stack([self._wanted.take(at), *self._sample[:2]])
        for k, noise in enumerate(self._noise, 1):
            if noise.size:
                self._now[k] += noise.take(at)

    def _commanded(self, actions: np.ndarray) -> np.ndarray:
        """Commands (2, n) [rpm, deg] of actions, as the policy's FMU computes them."""
        before, move = self._commands, self._move
        if self.task.action == RATE:
            wanted = before + actions * move
        else:
            wanted = self._low + (self._high - self._low) * (0.5 * (actions + 1.0))
        if np.isfinite(move).any():
            wanted = np.minimum(np.maximum(wanted, before - move), before + move)
        return np.minimum(np.maximum(wanted, self._low), self._high)
