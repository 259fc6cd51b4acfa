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
from vpp_fmu.gym.core import Core
from vpp_fmu.gym.task import Task


class VppThrustVectorEnv(VectorEnv):
    """`num_envs` rigs, moved by one compiled call, each with its own parameters, set-points and noise.

    With the seed s environment k equals a single one with the seed s + k, to the bit. An ended episode begins anew
    with the next step, whose action is not used (`AutoresetMode.NEXT_STEP`). `options`: fields of a `Task`. BadInput.
    """

    metadata: dict[str, Any] = {"render_modes": [], "autoreset_mode": AutoresetMode.NEXT_STEP}  # noqa: RUF012

    def __init__(self, num_envs: int = 1, task: Task | None = None, render_mode: None = None, **options):
        try:
            self.task = replace(task, **options) if task else Task(**options)
        except TypeError as error:
            raise BadInput("vpp_fmu.gym", "options", error, "the fields of vpp_fmu.gym.Task") from error
        self.num_envs, self.render_mode, self._core = num_envs, render_mode, Core(self.task, num_envs)
        self.single_observation_space = Box(-self._core.bounds, self._core.bounds, dtype=np.float64)
        self.single_action_space = Box(-1.0, 1.0, (2,), dtype=np.float32)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._ended = np.zeros(num_envs, bool)

    def reset(self, *, seed: int | Sequence[int | None] | None = None, options: dict | None = None):
        """Begin an episode in each: (observations (num_envs, observed), information by name)."""
        seeds = [None if seed is None else seed + k for k in range(self.num_envs)] if not isinstance(seed, Sequence) else seed
        for k, own in enumerate(seeds):
            if own is not None:
                self._core.generators[k] = gymnasium.utils.seeding.np_random(own)[0]
        self._ended[:] = False
        self._core.reset(np.arange(self.num_envs))
        return self._core.observed(), self._core.shown()

    def step(self, actions):
        """Hold actions (num_envs, 2): (observations, rewards, terminated, truncated, information)."""
        rewards, terminated, truncated = self._core.step(np.asarray(actions, float))
        if self._ended.any():
            self._core.reset(np.flatnonzero(self._ended))
            rewards[self._ended], terminated[self._ended], truncated[self._ended] = 0.0, False, False
        self._ended = terminated | truncated
        return self._core.observed(), rewards, terminated, truncated, self._core.shown()

    @property
    def parameters(self) -> np.ndarray:
        """Parameters of the present episodes (num_envs, parameters), in the model's order."""
        return self._core.parameters.copy()


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
