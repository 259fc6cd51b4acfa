"""The environments of Gymnasium: many rigs in one compiled call, and one of them alone."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import gymnasium
import numpy as np
from gymnasium.spaces import Box
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from vpp_fmu.errors import BadInput
from vpp_fmu.gym.reward import Moment
from vpp_fmu.gym.task import RATE, Task
from vpp_fmu.kernel.effects.policy import LARGEST_INTEGRAL
from vpp_fmu.native.many import ManyPlants

BOUNDS = {"thrust_set": 1e5, "thrust": 1e5, "omega": 4e5, "omega_ref": 4e5, "beta_ref": 180.0, "integral": LARGEST_INTEGRAL}
"""Largest absolute value of an observation, in its unit."""


class VppThrustVectorEnv(VectorEnv):
    """`num_envs` rigs, moved by one compiled call. Each draws parameters, set-points and noise of an episode from its own
    generator at the episode's start, so that its numbers do not depend on its neighbours.

    With the seed s environment k equals a single one with the seed s + k, to the bit. An ended episode begins anew
    with the next step, whose action is not used (`AutoresetMode.NEXT_STEP`). `options`: fields of a `Task`. BadInput.
    """

    metadata: dict[str, Any] = {"render_modes": [], "autoreset_mode": AutoresetMode.NEXT_STEP}  # noqa: RUF012

    def __init__(self, num_envs: int = 1, task: Task | None = None, render_mode: None = None, **options):
        try:
            self.task = task = replace(task, **options) if task else Task(**options)
        except TypeError as error:
            raise BadInput("vpp_fmu.gym", "options", error, "the fields of vpp_fmu.gym.Task") from error
        self.num_envs, self.render_mode, self._pays = num_envs, render_mode, task.pays
        bounds = np.array([*(BOUNDS[name] for name in task.observe), *[BOUNDS["thrust"]] * task.history])
        self.single_observation_space = Box(-bounds, bounds, dtype=np.float64)
        self.single_action_space = Box(-1.0, 1.0, (2,), dtype=np.float32)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._plants = plants = ManyPlants(task.plant.model, num_envs, task.step)
        self._generators = [np.random.default_rng() for _ in range(num_envs)]
        self._parameters = np.zeros((num_envs, len(task.plant.model.parameters)))
        self._ended, self._at, self._rows = np.zeros(num_envs, bool), np.zeros(num_envs, int), np.arange(num_envs)
        self._wanted = np.zeros((task.actions + 1, num_envs))
        self._noise = [np.zeros(self._wanted.shape if std else 0) for std in task.noise_std]
        # Quantities in rows, environments in columns: numpy's inner loops then run over all environments.
        self._commands, self._sample = np.zeros((2, num_envs)), np.zeros((3, num_envs))
        self._now = np.zeros((3, num_envs))  # set-point, readings of thrust and speed
        self._integral, self._past = np.zeros(num_envs), np.zeros((task.history, num_envs))
        self._order = [list(plants.outputs).index(name) for name in ("thrust", "omega", "beta")]
        self._low, self._high, self._move = (v[:, None] for v in (task.low, task.high, task.rates * task.period))
        self._range = np.where(self._high > self._low, self._high - self._low, 1.0)

    def reset(self, *, seed: int | Sequence[int | None] | None = None, options: dict | None = None):
        """Begin an episode in each: (observations (num_envs, observed), information by name)."""
        seeds = [None if seed is None else seed + k for k in range(self.num_envs)] if not isinstance(seed, Sequence) else seed
        for k, own in enumerate(seeds):
            if own is not None:
                self._generators[k] = gymnasium.utils.seeding.np_random(own)[0]
        self._ended[:] = False
        self._begin(np.arange(self.num_envs))
        return self._observed(), self._shown()

    def step(self, actions):
        """Hold actions (num_envs, 2): (observations, rewards, terminated, truncated, information)."""
        task, before = self.task, self._commands
        wanted, reading = self._now[0].copy(), self._now[1]
        error = wanted - reading
        moves = np.where(error > 0.0, (before < self._high).any(axis=0), (before > self._low).any(axis=0))
        grown = np.minimum(np.maximum(self._integral + error * task.period, -LARGEST_INTEGRAL), LARGEST_INTEGRAL)
        self._integral = np.where(moves, grown, self._integral)
        if task.history:
            self._past = np.vstack([reading, self._past[:-1]])
        self._commands = self._commanded(np.minimum(np.maximum(np.asarray(actions, float).T, -1.0), 1.0))
        self._sample = self._plants.advance(self._commands.T, task.hold)[:, self._order].T.copy()
        self._at = np.minimum(self._at + 1, task.actions)
        self._read()
        thrust, omega, beta = self._sample
        terminated = task.exceeded(thrust, omega)
        travel = np.abs(self._commands - before) / self._range
        moment = Moment(wanted, thrust, omega, beta, *travel, task.period, task.rig.scales.thrust_scale, terminated)
        rewards, truncated = np.asarray(self._pays(moment), float), (self._at >= task.actions) & ~terminated
        if self._ended.any():
            self._begin(np.flatnonzero(self._ended))
            rewards[self._ended], terminated[self._ended], truncated[self._ended] = 0.0, False, False
        self._ended = terminated | truncated
        return self._observed(), rewards, terminated, truncated, self._shown()

    @property
    def parameters(self) -> np.ndarray:
        """Parameters of the present episodes (num_envs, parameters), in the model's order."""
        return self._parameters.copy()

    def _begin(self, which: np.ndarray) -> None:
        """Begin an episode in the environments `which` (some,), at rest on the lowest commands."""
        task = self.task
        for n in which.tolist():
            rng = self._generators[n]
            self._parameters[n] = task.parameters_of(rng)
            self._wanted[:, n] = task.set_points(rng)
            for noise, std in zip(self._noise, task.noise_std, strict=True):
                if std:
                    noise[:, n] = std * rng.standard_normal(len(noise))
        self._at[which], self._integral[which], self._commands[:, which] = 0, 0.0, self._low
        shown = self._plants.begin(which, self._parameters[which], self._commands[:, which].T)
        self._sample[:, which] = shown[:, self._order].T
        self._read()
        self._past[:, which] = self._now[1, which]

    def _observed(self) -> np.ndarray:
        """Observations (num_envs, observed), in the task's order: thrust and speed as read, in N, rpm, deg, N s."""
        names = ("thrust_set", "thrust", "omega", "omega_ref", "beta_ref", "integral")
        named = dict(zip(names, (*self._now, *self._commands, self._integral), strict=True))
        found = np.array([*(named[name] for name in self.task.observe), *self._past]).T
        bounds = self.single_observation_space.high
        return np.fmin(np.fmax(found, -bounds), bounds)

    def _shown(self) -> dict[str, np.ndarray]:
        """Outputs without noise, and commands, by name: (num_envs,) each; the next step makes new arrays."""
        return dict(zip(("thrust", "omega", "beta", "omega_ref", "beta_ref"), (*self._sample, *self._commands), strict=True))

    def _read(self) -> None:
        at = self._at * self.num_envs + self._rows
        self._now = np.stack([self._wanted.take(at), *self._sample[:2]])
        for k, noise in enumerate(self._noise, 1):
            if noise.size:
                self._now[k] += noise.take(at)

    def _commanded(self, actions: np.ndarray) -> np.ndarray:
        """Commands (2, num_envs) [rpm, deg] of actions, as the policy's FMU computes them."""
        before, move = self._commands, self._move
        if self.task.action == RATE:
            wanted = before + actions * move
        else:
            wanted = self._low + (self._high - self._low) * (0.5 * (actions + 1.0))
        if np.isfinite(move).any():
            wanted = np.minimum(np.maximum(wanted, before - move), before + move)
        return np.minimum(np.maximum(wanted, self._low), self._high)


class VppThrustEnv(gymnasium.Env):
    """Thrust control of the identified rig. `options`: fields of a `Task`. BadInput.

    >>> import gymnasium, vpp_fmu.gym
    >>> env = gymnasium.make("VppThrust-v0", seconds=2.0)
    >>> observation, _ = env.reset(seed=1)
    >>> observation.shape, env.action_space.shape
    ((3,), (2,))
    """

    metadata: dict[str, Any] = {"render_modes": []}  # noqa: RUF012

    def __init__(self, task: Task | None = None, render_mode: None = None, **options):
        self._one, self.render_mode = VppThrustVectorEnv(1, task, **options), render_mode
        self.task = self._one.task
        self.observation_space, self.action_space = self._one.single_observation_space, self._one.single_action_space

    def reset(self, *, seed: int | None = None, options: dict | None = None):
        """Begin an episode: (observation (observed,), information by name)."""
        super().reset(seed=seed)
        seen, shown = self._one.reset(seed=seed)
        return seen[0], _first(shown)

    def step(self, action):
        """Hold an action (2,): (observation, reward, terminated, truncated, information)."""
        seen, rewards, terminated, truncated, shown = self._one.step(np.asarray(action, float)[None])
        return seen[0], float(rewards[0]), bool(terminated[0]), bool(truncated[0]), _first(shown)


def _first(shown: Mapping[str, np.ndarray]) -> dict[str, float]:
    return {name: float(values[0]) for name, values in shown.items()}
