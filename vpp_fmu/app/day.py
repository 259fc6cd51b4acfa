"""A rig's day: rounds of runs, diagnosis and tuning. A flight is a run of the rig with a controller over a profile, a mission
a flight over random thrust levels beside the twin."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path

import numpy as np
from scipy.stats import ttest_ind

from hil.loop.cycle import PERIOD
from hil.loop.rig import RunEnded
from hil.loop.session import Setup
from hil.run import Run, run_on_rig, write_run
from hil.twin.twin import Alarm, Twin
from identification.tune.objective import ALPHA
from vpp_fmu.files import OutputFolder
from vpp_fmu.kernel.controller import DUAL
from vpp_fmu.parameters import ParameterSet
from vpp_fmu.plants import KernelController
from vpp_fmu.record import Record

GAINS = tuple(DUAL)
"""Names of a controller's gains, which the paper's cost counts."""

BETTER = 0.1
"""Level of the t test that new gains are better than the present ones. A lower level would reject more of the better gains,
which may return in the next round."""

HOLDS = 1.5, 6.0
"""Range of the hold time [s] of a mission's levels on a rig of the paper's time scale: transients settle in the shorter ones,
and the longer ones show the model's error at rest."""

MISSION = 90.0
"""Duration of a mission there, s: some 25 levels, as in a campaign's open loop."""

PRESENT = "what flew"
"""Name of the present gains among those that are compared."""


@dataclass(frozen=True, eq=False)
class Round:
    """A round, its `number` from 1, with the effects `hidden` in the rig.

    `mission`: its first flight, and the twin's `alarms` in it, in s from its record's start; `verdict` of the diagnosis of the
    mission, and the effects that it `named`. `parameters`: the next model; `before`, `after`: rms thrust errors [N] in the
    mission of the present model, which has not seen it, and of the next one. `costs`: by gains, measured costs of the profile's
    repetitions; `winner`: the next `settings` of the controller.
    """

    number: int
    hidden: tuple[str, ...]
    mission: Run
    alarms: tuple[Alarm, ...]
    verdict: str
    named: tuple[str, ...]
    parameters: ParameterSet
    before: float
    after: float
    costs: Mapping[str, tuple[float, ...]]
    winner: str
    settings: Mapping[str, float]

    @property
    def cost(self) -> float:
        """Mean measured cost of the next settings."""
        return float(np.mean(self.costs[self.winner]))


@dataclass(eq=False)
class Day:
    """A day's rounds, its initial model and controller, and the profile over which gains are compared."""

    begun: ParameterSet
    first: Mapping[str, float]
    profile: Record
    rounds: list[Round] = field(default_factory=list)

    @property
    def parameters(self) -> ParameterSet:
        return self.rounds[-1].parameters if self.rounds else self.begun

    @property
    def settings(self) -> Mapping[str, float]:
        return self.rounds[-1].settings if self.rounds else self.first

    @property
    def alarms(self) -> int:
        """Rounds with an alarm."""
        return sum(bool(one.alarms) for one in self.rounds)

    @property
    def added(self) -> list[str]:
        """Effects that were added to the model."""
        return [name for one in self.rounds for name in one.named]

    @property
    def cost(self) -> tuple[float, float]:
        """Mean measured cost of the initial settings, and of those that fly next."""
        return float(np.mean(self.rounds[0].costs[PRESENT])), self.rounds[-1].cost


def fly(setup: Setup, settings: Mapping[str, float], profile: Record, folder: Path, twin: Twin | None = None) -> Run:
    """Close the loop on the rig over a profile by a controller of these settings; log and run.csv go to `folder`. BadInput;
    RunEnded if it ended early."""
    OutputFolder(folder)
    done = run_on_rig(setup, KernelController(settings, PERIOD), profile, folder, twin=twin)
    write_run(folder / "run.csv", done.record)
    if done.ended:
        raise RunEnded(done.ended)
    return done


def repeated(profile: Record, times: int) -> Record:
    """A profile repeated without a pause; its last row replaces the first of the next repetition."""
    length = float(profile.time[-1] - profile.time[0])
    rows = {n: np.concatenate([*(times - 1) * [column[:-1]], column]) for n, column in profile.columns.items()}
    counts = [*(times - 1) * [len(profile) - 1], len(profile)]
    return Record(rows | {"time": rows["time"] + length * np.repeat(np.arange(times), counts)}, profile.source)


def costs_of(record: Record, profile: Record, times: int, settings: Mapping[str, float]) -> tuple[float, ...]:
    """The cost of each repetition of a run over a profile `repeated` `times` times."""
    length = float(profile.time[-1] - profile.time[0])
    edges = np.searchsorted(record.time - record.time[0], length * np.arange(1, times) - 0.5 * PERIOD)
    rows = [slice(a, b) for a, b in pairwise([0, *edges.tolist(), len(record)])]
    return tuple(measured_cost(record.part(each), settings) for each in rows)


def measured_cost(record: Record, settings: Mapping[str, float]) -> float:
    """The paper's cost (eq. 21) of the measured thrust: integral of the squared error over its scale [s], and the gains'."""
    error = (record["thrust_set"] - record["thrust"]) / settings["thrust_scale"]
    gains = np.array([settings[name] for name in GAINS])
    return float(np.sum(error**2) * PERIOD + ALPHA * gains @ gains)


def best_of(costs: Mapping[str, tuple[float, ...]]) -> str:
    """The gains with the lowest mean cost; the first, the present ones, if the test does not find the others better."""
    flew, best = next(iter(costs)), min(costs, key=lambda name: float(np.mean(costs[name])))
    return best if best == flew or ttest_ind(costs[best], costs[flew], alternative="less").pvalue < BETTER else flew


def mission(low: float, high: float, pace: float, seed: int) -> Record:
    """Random levels of the thrust set-point [N] between `low` and `high`, for a rig `pace` times as slow as the
    paper's. `time` [s], `thrust_set` [N]."""
    rng, seconds = np.random.default_rng(seed), MISSION * pace
    time = np.cumsum(np.r_[0.0, rng.uniform(*HOLDS, int(seconds / (HOLDS[0] * pace))) * pace])
    time = np.r_[time[time < seconds - HOLDS[0] * pace], seconds]  # the last level, too, is held as long
    levels = rng.uniform(low, high, len(time))
    levels[-1] = levels[-2]  # the last row ends the record
    return Record({"time": time, "thrust_set": levels}, "mission")
