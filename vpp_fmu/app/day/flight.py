"""One flight, a run of the rig under a controller over a profile: its cost, and the twins' results."""

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np

from hil.columns import LEARNED
from hil.cycle import PERIOD
from hil.run import run_on_rig, write_run
from hil.session import Setup
from hil.twin.adaptive import Adaptive, adaptable, adaptive
from hil.twin.band import Band
from hil.twin.twin import Twin
from identification.tune.objective import ALPHA
from vpp_fmu.files import OutputFolder
from vpp_fmu.kernel.controller import DUAL
from vpp_fmu.parameters import ParameterSet
from vpp_fmu.plants import KernelController, KernelPlant
from vpp_fmu.policy import Policy
from vpp_fmu.record import Record

GAINS = tuple(DUAL)
"""Names of a controller's gains, which the paper's cost counts."""


@dataclass(frozen=True, eq=False)
class Flight:
    """`record`: as in run.csv; `twin`: outputs of the adaptive twin (rows,) by name, empty without one; `alarms`: (s from the
    record's start, in words) of both twins; `costs`: the paper's cost (eq. 21) of the measured thrust, for each
    repetition of the profile, empty if the flight ended early; `ended`: the reason for that, else ""."""

    record: Record
    twin: Mapping[str, np.ndarray]
    alarms: tuple[tuple[float, str], ...]
    costs: tuple[float, ...]
    ended: str

    @property
    def cost(self) -> float:
        """Mean cost."""
        return float(np.mean(self.costs))


@dataclass(frozen=True, eq=False)
class Twins:
    """The twins beside the rig: a fixed one, which detects deviations, and an adaptive one."""

    parameters: ParameterSet
    band: Band

    def beside(self, setup: Setup) -> tuple[Twin, Adaptive]:
        """Both twins for a flight."""
        as_it_is = Twin(KernelPlant(self.parameters.model, self.parameters.values), self.band, rig=setup.allowed)
        return as_it_is, Adaptive(adaptive(adaptable(self.parameters, "vpp twin"), self.band), PERIOD)


@dataclass(frozen=True, eq=False)
class Law:
    """A control law: the controller's `settings`, or a learned `policy` that falls back on them."""

    settings: Mapping[str, float]
    policy: Policy | None = None

    def controller(self, setup: Setup) -> KernelController:
        """The law for a flight on a rig."""
        if self.policy is None:
            return KernelController(self.settings, PERIOD)
        own = self.policy.parameters(self.settings, setup.allowed.scales)
        return KernelController(own.values, PERIOD, own.model)


def fly(setup: Setup, law: Law, profile: Record, folder: Path, twins: Twins | None = None, times: int = 1) -> Flight:
    """Close the loop on the rig over a profile, repeated `times` times, under a law; log and run.csv go to `folder`.
    BadInput."""
    OutputFolder(folder)
    twin, learning = twins.beside(setup) if twins else (None, None)
    done = run_on_rig(setup, law.controller(setup), repeated(profile, times), folder, twin=twin, adaptive=learning)
    write_run(folder / "run.csv", done.record)
    rows = np.flatnonzero(np.isfinite(done.log["omega_wanted"]))
    learned = {name: done.log[LEARNED + name][rows] for name in learning.outputs} if learning else {}
    found = [(at, f"most like {twin.cause}") for at, _ in done.session.rig.alarms] if twin else []
    found += [(at, f"most like {what}") for at, what in learning.alarms] if learning else []
    began = float(done.log.time[rows[0]]) if len(rows) else 0.0
    alarms = tuple((at - began, what) for at, what in sorted(found))
    went = [] if done.ended else passes(done.record, profile, times)
    costs = tuple(measured_cost(done.record.part(rows), law.settings) for rows in went)
    return Flight(done.record, learned, alarms, costs, done.ended)


def repeated(profile: Record, times: int) -> Record:
    """A profile repeated without a pause; its last row replaces the first of the next repetition."""
    length = float(profile.time[-1] - profile.time[0])
    rows = {n: np.concatenate([*(times - 1) * [column[:-1]], column]) for n, column in profile.columns.items()}
    counts = [*(times - 1) * [len(profile) - 1], len(profile)]
    return Record(rows | {"time": rows["time"] + length * np.repeat(np.arange(times), counts)}, profile.source)


def passes(record: Record, profile: Record, times: int) -> list[slice]:
    """Rows of each repetition of a run over a profile `repeated` `times` times."""
    length = float(profile.time[-1] - profile.time[0])
    edges = np.searchsorted(record.time - record.time[0], length * np.arange(1, times) - 0.5 * PERIOD)
    return [slice(a, b) for a, b in pairwise([0, *edges.tolist(), len(record)])]


def measured_cost(record: Record, settings: Mapping[str, float]) -> float:
    """Integral of the squared error over the thrust's scale [s], and the cost of the gains."""
    error = (record["thrust_set"] - record["thrust"]) / settings["thrust_scale"]
    gains = np.array([settings[name] for name in GAINS])
    return float(np.sum(error**2) * PERIOD + ALPHA * gains @ gains)


HOLDS = 1.5, 6.0
"""Range of the hold time [s] of a mission's levels on a rig of the paper's time scale: transients settle in the shorter ones,
and the longer ones count as a visit for the twin (`hil.twin.directions.SPAN`)."""

MISSION = 90.0
"""Duration of a mission there, s: some 25 levels, as in a campaign's open loop."""


def mission(low: float, high: float, pace: float, seed: int) -> Record:
    """Random levels of the thrust set-point [N] between `low` and `high`, for a rig `pace` times as slow as the
    paper's. `time` [s], `thrust_set` [N]."""
    rng, seconds = np.random.default_rng(seed), MISSION * pace
    time = np.cumsum(np.r_[0.0, rng.uniform(*HOLDS, int(seconds / (HOLDS[0] * pace))) * pace])
    time = np.r_[time[time < seconds - HOLDS[0] * pace], seconds]  # the last level, too, is held as long
    levels = rng.uniform(low, high, len(time))
    levels[-1] = levels[-2]  # the last row ends the record
    return Record({"time": time, "thrust_set": levels}, "mission")
