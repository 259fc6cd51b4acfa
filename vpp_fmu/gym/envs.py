"""The environments of Gymnasium: one rig, many rigs in one compiled call, and a plant FMU."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from gymnasium.spaces import Box
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from vpp_fmu.errors import BadInput
from vpp_fmu.gym.core import Core, Plants
from vpp_fmu.gym.task import Task
from vpp_fmu.kernel.scales import PAPER
from vpp_fmu.native.many import ManyPlants
from vpp_fmu.plants import MEASURED, FmuPlant
from vpp_fmu.rig import rig_of


def _task(task: Task | None, options: Mapping[str, Any]) -> Task:
    try:
        return replace(task, **options) if task else Task(**options)
    except TypeError as error:
        raise BadInput("vpp_fmu.gym", "options", error, "the fields of vpp_fmu.gym.Task") from error


def _many(task: Task, count: int) -> ManyPlants:
    return ManyPlants(task.plant.model, count, task.step)


def _spaces(core: Core) -> tuple[Box, Box]:
    return Box(-core.bounds, core.bounds, dtype=np.float64), Box(-1.0, 1.0, (2,), dtype=np.float32)


class _Single(gymnasium.Env):
    """One environment on a core of one."""

    metadata: dict[str, Any] = {"render_modes": []}  # noqa: RUF012

    def __init__(self, task: Task, plants: Plants):
        self.task, self._core = task, Core(task, plants, 1)
        self.observation_space, self.action_space = _spaces(self._core)

    def reset(self, *, seed: int | None = None, options: dict | None = None):
        """Begin an episode: (observation (observed,), information by name)."""
        super().reset(seed=seed)
        self._core.generators[0] = self.np_random
        self._core.reset(np.array([0]))
        return self._core.observed()[0], self._information()

    def step(self, action):
        """Hold an action (2,): (observation, reward, terminated, truncated, information)."""
        rewards, terminated, truncated = self._core.step(np.asarray(action, float)[None])
        return self._core.observed()[0], float(rewards[0]), bool(terminated[0]), bool(truncated[0]), self._information()

    def _information(self) -> dict[str, float]:
        return {name: float(values[0]) for name, values in self._core.shown().items()}

    def close(self) -> None:
        """Release the plant."""
        self._core.plants.close()


class VppThrustEnv(_Single):
    """Thrust control of the identified rig. `options`: fields of a `Task`. BadInput.

    >>> import gymnasium, vpp_fmu.gym
    >>> env = gymnasium.make("VppThrust-v0", seconds=2.0)
    >>> observation, _ = env.reset(seed=1)
    >>> observation.shape, env.action_space.shape
    ((3,), (2,))
    """

    def __init__(self, task: Task | None = None, render_mode: None = None, **options):
        own = _task(task, options)
        super().__init__(own, _many(own, 1))
        self.render_mode = render_mode


class VppFmuEnv(_Single):
    """The same with a plant FMU, of this project or any with its variables, stepped through fmpy.

    `parameters`: start values by the FMU's names. Limits of the rig are those of `limits` in `options`, else the ranges of the
    FMU's scales. There is no posterior to draw from. Without a `profile`, set-points are within reach of the FMU.
    """

    def __init__(self, fmu: str | Path, parameters: Mapping[str, float] | None = None, task: Task | None = None, **options):
        own = _task(task, options)
        if own.randomise:
            raise BadInput(fmu, "randomise", True, "False: an FMU has no posterior")
        plants = _OneFmu(fmu, parameters, own.step)
        if own.limits is None:
            own = replace(own, limits=rig_of(PAPER.with_values(plants.starts), {}))
        if own.profile is None:
            own.__dict__["reach"] = plants.reach(own)
        super().__init__(own, plants)


class _OneFmu:
    """One FMU with the interface of `Plants`."""

    outputs = MEASURED

    def __init__(self, fmu: str | Path, parameters: Mapping[str, float] | None, dt: float):
        self._plant = FmuPlant(fmu, parameters, dt)
        self.starts = {**self._plant.starts(), **(parameters or {})}

    def begin(self, which, parameters, commands):
        return np.array([self._plant.start(*commands[0].tolist())])

    def advance(self, commands, hold):
        given = commands[0].tolist()
        for _ in range(hold):
            sample = self._plant.step(*given)
        return np.array([sample])

    def reach(self, task: Task) -> tuple[float, float]:
        """Thrust [N] at rest on the lowest and the highest commands, within the rig's range."""
        ends = [self._plant.start(*commands.tolist()).thrust for commands in (task.low, task.high)]
        low, high = max(ends[0], task.rig.thrust[0]), min(ends[1], task.rig.thrust[1])
        if not low < high:
            raise BadInput(self._plant.path, "thrust in reach", f"{low:.4g} to {high:.4g} N", "thrust that grows with commands")
        return low, high

    def close(self) -> None:
        self._plant.close()


class VppThrustVectorEnv(VectorEnv):
    """`num_envs` rigs, moved by one compiled call, each with its own parameters, set-points and noise.

    With the seed s environment k equals a single one with the seed s + k, to the bit. An ended episode begins anew
    with the next step, whose action is not used (`AutoresetMode.NEXT_STEP`). `options`: fields of a `Task`. BadInput.
    """

    metadata: dict[str, Any] = {"render_modes": [], "autoreset_mode": AutoresetMode.NEXT_STEP}  # noqa: RUF012

    def __init__(self, num_envs: int = 1, task: Task | None = None, render_mode: None = None, **options):
        self.task, self.num_envs, self.render_mode = _task(task, options), num_envs, render_mode
        self._core = Core(self.task, _many(self.task, num_envs), num_envs)
        self.single_observation_space, self.single_action_space = _spaces(self._core)
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

    def close_extras(self, **_) -> None:
        """Release the plants."""
        self._core.plants.close()
