"""One flight: the rig under a controller over a profile, what it cost, and what the adaptive twin beside it made of it."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from hil.columns import LEARNED
from hil.cycle import PERIOD
from hil.run import run_on_rig, write_run
from hil.session import Setup
from hil.twin.adaptive import Adaptive
from identification.tune.objective import ALPHA
from vpp_fmu.files import OutputFolder
from vpp_fmu.kernel.controller import DUAL
from vpp_fmu.parameters import ParameterSet
from vpp_fmu.plants import KernelController
from vpp_fmu.record import Record

GAINS = tuple(DUAL)
"""Names of a controller's gains, which the paper's cost counts."""


@dataclass(frozen=True, eq=False)
class Flight:
    """`record`: as run.csv has it; `twin`: outputs of the adaptive twin (rows,) by name, none where none ran; `alarms`: (time
    [s], what it points to); `cost`: the paper's (eq. 21), of measured thrust; `ended`: why it ended early, ""."""

    record: Record
    twin: Mapping[str, np.ndarray]
    alarms: tuple[tuple[float, str], ...]
    cost: float
    ended: str


def fly(setup: Setup, settings: Mapping[str, float], profile: Record, folder: Path, twin: ParameterSet | None = None) -> Flight:
    """Close the loop on the rig over a profile under the controller's `settings`; log and run.csv go to `folder`. BadInput."""
    OutputFolder(folder)
    learning = Adaptive(twin, PERIOD) if twin else None
    done = run_on_rig(setup, KernelController(settings, PERIOD), profile, folder, adaptive=learning)
    write_run(folder / "run.csv", done.record)
    rows = np.flatnonzero(np.isfinite(done.log["omega_wanted"]))
    told = {name: done.log[LEARNED + name][rows] for name in learning.outputs} if learning else {}
    cost = np.inf if done.ended else measured_cost(done.record, settings)
    return Flight(done.record, told, tuple(learning.alarms) if learning else (), cost, done.ended)


def measured_cost(record: Record, settings: Mapping[str, float]) -> float:
    """Integral of the squared error over the thrust's scale [s], and what the gains cost."""
    error = (record["thrust_set"] - record["thrust"]) / settings["thrust_scale"]
    gains = np.array([settings[name] for name in GAINS])
    return float(np.sum(error**2) * PERIOD + ALPHA * gains @ gains)


def mission(low: float, high: float, time_scale: float, seconds: float, seed: int) -> Record:
    """Random levels of wanted thrust [N] between `low` and `high`, each held for 3 to 8 of the rig's time scales: what a twin
    can learn from. `time` [s], `thrust_set` [N]."""
    rng = np.random.default_rng(seed)
    time = np.cumsum(np.r_[0.0, rng.uniform(3.0, 8.0, int(seconds / (3.0 * time_scale))) * time_scale])
    time = np.r_[time[time < seconds], seconds]
    levels = rng.uniform(low, high, len(time))
    levels[-1] = levels[-2]  # the last row ends the record
    return Record({"time": time, "thrust_set": levels}, "mission")
