"""A control task: the plant, its limits, the set-points of an episode, the observations and the actions."""

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from hil.safety.limits import Limits, limits_of
from identification.assessment.information import read_knowledge, read_noise
from identification.power.model import PowerModel
from identification.tune.draws import Posterior, standard_deviations
from identification.tune.profile import common_reach
from vpp_fmu.errors import BadInput
from vpp_fmu.gym.reward import Moment, Reward
from vpp_fmu.kernel.controller import CONTROLLER
from vpp_fmu.kernel.effects.policy import OBSERVABLE
from vpp_fmu.kernel.plant import plant
from vpp_fmu.parameters import ParameterSet, beside, check_same_model, parameters_file, read_parameters
from vpp_fmu.record import Record, held, read_profile
from vpp_fmu.rig import Rig

RATE, ABSOLUTE = "rate", "absolute"

HOLDS = 2.0, 6.0
"""Shortest and longest hold of a random set-point, in time scales of the rig: a step takes about one."""

QUICK = 5.0
"""Maximum change of a command, in ranges per second, if actions are rates and the rig declares no slew rate."""


@dataclass(frozen=True, eq=False)
class Task:
    """The definition of an environment.

    `parameters`: the plant, a set or a file or folder; None: the paper's. `randomise`: each episode draws its parameters from
    the posterior (standard deviations of the parameters, correlation of the identification.json beside it). `profile`:
    set-points as a Record or CSV with `time` [s], `thrust_set` [N]; None: random steps within reach. `seconds`: length of an
    episode; None: the profile's, else 10. `hold`: plant steps of `dt` [s] for each action; `dt` None: the period of the
    identification, else 0.004. `noise` [N, rpm]: standard deviations of the readings of thrust and speed; None: that of the
    identification for thrust, none for speed. `observe`: names of OBSERVABLE; `history`: number of earlier thrust readings
    behind them. `action`: "absolute" commands or their "rate", both as -1 to 1 of their range. BadInput.
    """

    parameters: ParameterSet | str | None = None
    randomise: bool = False
    profile: Record | str | None = None
    seconds: float | None = None
    dt: float | None = None
    hold: int = 1
    noise: tuple[float, float] | None = None
    observe: tuple[str, ...] = ("thrust_set", "thrust", "omega")
    history: int = 0
    action: str = ABSOLUTE
    reward: Callable[[Moment], np.ndarray] = field(default_factory=Reward)

    def __post_init__(self):
        known = bool(self.observe) and set(self.observe) <= set(OBSERVABLE)
        _check("observe", self.observe, known, f"names of {', '.join(OBSERVABLE)}")
        _check("action", self.action, self.action in (RATE, ABSOLUTE), f"{ABSOLUTE!r} or {RATE!r}")
        for name, low, high in (("hold", 1, 10_000), ("history", 0, 1000)):
            value = getattr(self, name)
            _check(name, value, isinstance(value, int) and low <= value <= high, f"a whole number from {low} to {high}")
        for name in ("dt", "seconds"):
            value = getattr(self, name)
            _check(name, value, value is None or 1e-6 <= value <= 1e6, "seconds from 1e-6 to 1e6")
        noise = self.noise or (0.0, 0.0)
        _check("noise", self.noise, len(noise) == 2 and min(noise) >= 0.0, "two numbers from 0, in N and rpm")

    @cached_property
    def _given(self) -> tuple[ParameterSet, str | None]:
        """The parameters, and the path of the identification.json beside their file."""
        if self.parameters is None or isinstance(self.parameters, ParameterSet):
            return self.parameters or ParameterSet(plant()), None
        file = parameters_file(self.parameters)
        found, knowledge = read_parameters(file, plant), beside(file)
        if not knowledge.is_file():
            return found, None
        check_same_model(knowledge, found.without_power, file)
        return found, str(knowledge)

    @cached_property
    def plant(self) -> ParameterSet:
        """The plant and its parameters, without torque and power."""
        return self._given[0].without_power

    @property
    def rig(self) -> Rig:
        """The rig, with its ranges."""
        return self.plant.rig

    @cached_property
    def pays(self) -> Callable[[Moment], np.ndarray]:
        """The reward, with the identified power if it has none of its own. BadInput if there is none."""
        reward = self.reward
        if isinstance(reward, Reward) and reward.energy and reward.power is None:
            return replace(reward, power=PowerModel.of(self._given[0]).at)
        return reward

    @cached_property
    def _posterior(self) -> Posterior:
        known_in = self._given[1]
        std = {name: s for name, s in standard_deviations(self.plant, (), 0.0).items() if s > 0.0}
        allowed = "parameters with standard deviations, as vpp identify writes them"
        _check("randomise", "no standard deviation in the parameters", bool(std), allowed)
        return Posterior(self.plant, std, read_knowledge(known_in)[0] if known_in else None)

    def parameters_of(self, rng: np.random.Generator) -> np.ndarray:
        """Parameters of an episode (parameters,), in the model's order."""
        return self._posterior.draw(rng, 1)[0] if self.randomise else np.array(list(self.plant.values.values()))

    @cached_property
    def noise_std(self) -> tuple[float, float]:
        """Standard deviations of a reading of thrust [N] and of speed [rpm]."""
        known_in = self._given[1]
        return self.noise or (((known_in and read_noise(known_in)) or (0.0,))[0], 0.0)

    @cached_property
    def step(self) -> float:
        """Communication step of the plant, s."""
        return self.dt or self.plant.sample_period or 0.004

    @property
    def period(self) -> float:
        """Duration of an action, s."""
        return self.step * self.hold

    @cached_property
    def low(self) -> np.ndarray:
        """Least commands (2,) [rpm, deg]."""
        return np.array([self.rig.speed[0], self.rig.pitch[0]])

    @cached_property
    def high(self) -> np.ndarray:
        """Greatest commands (2,) [rpm, deg]."""
        return np.array([self.rig.speed[1], self.rig.pitch[1]])

    @cached_property
    def rates(self) -> np.ndarray:
        """Fastest change of the commands (2,) [rpm/s, deg/s]."""
        slew = np.array([self.rig.speed_slew, self.rig.pitch_slew])
        return np.where(np.isfinite(slew), slew, QUICK * (self.high - self.low)) if self.action == RATE else slew

    @cached_property
    def _profile(self) -> np.ndarray | None:
        """Set-points (actions + 1,) of the profile."""
        if self.profile is None:
            return None
        profile = self.profile if isinstance(self.profile, Record) else read_profile(self.profile)
        found = held(profile, self.period)[1]
        count = len(found) - 1 if self.seconds is None else self._count(self.seconds)
        _check("profile", f"{profile.time[-1]:g} s", count > 0, f"{self.period:g} s or more")
        return np.append(found, np.full(max(0, count + 1 - len(found)), found[-1]))[: count + 1]

    def _count(self, seconds: float) -> int:
        return max(1, math.ceil(seconds / self.period - 1e-9))

    @cached_property
    def actions(self) -> int:
        """Actions of an episode."""
        return self._count(self.seconds or 10.0) if self._profile is None else len(self._profile) - 1

    @cached_property
    def _reach(self) -> tuple[float, float]:
        """Thrust [N] at rest on the lowest and on the highest commands, within the rig's range. BadInput if it is empty."""
        names = ("omega_min", "beta_min", "omega_max", "beta_max")
        ends = dict(zip(names, (*self.low.tolist(), *self.high.tolist()), strict=True))
        return common_reach(self.plant, {"": {**CONTROLLER.values(), **ends}})

    def set_points(self, rng: np.random.Generator) -> np.ndarray:
        """Set-points of an episode (actions + 1,) N."""
        if self._profile is not None:
            return self._profile
        scale = self.rig.scales.time_scale
        most = math.ceil((self.actions + 1) * self.period / (HOLDS[0] * scale)) + 1
        ends = np.cumsum(rng.uniform(*HOLDS, most) * scale)
        levels = rng.uniform(*self._reach, most)
        return levels[np.searchsorted(ends, self.period * np.arange(self.actions + 1), side="right")]

    def exceeded(self, thrust: np.ndarray, omega: np.ndarray) -> np.ndarray:
        """Whether thrust [N], of either sign, or speed [rpm] stops the rig, as `hil.safety.limits` has it."""
        return (np.abs(thrust) >= self._trips.thrust_trip) | (omega >= self._trips.omega_trip) | ~np.isfinite(thrust)

    @cached_property
    def _trips(self) -> Limits:
        return limits_of(self.rig, "vpp_fmu.gym")


def _check(field_name: str, found: object, good: bool, allowed: str) -> None:
    if not good:
        raise BadInput("vpp_fmu.gym", field_name, found, allowed)
