"""The paper's campaign on the emulated rig, and its closed loops there; both in virtual time."""

import json
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from importlib.resources import files
from pathlib import Path

import numpy as np

from hil.calibration import read_calibration
from hil.campaign import PARTS, Plan, measure, steep
from hil.emulator.rig import Rig
from hil.rig import RunEnded
from hil.run import run_on_rig
from hil.safety.limits import Limits
from hil.session import Setup, session
from vpp_fmu.campaign import Campaign, read_campaign
from vpp_fmu.files import OutputFolder
from vpp_fmu.plants import KernelController
from vpp_fmu.record import Record, write_record


def emulated(limits: Limits, seed: int, map_is_known: bool = True) -> Setup:
    """The emulated rig in virtual time, nothing hidden in it. `seed`: of its noise."""
    calibration = read_calibration(str(files("hil.emulator") / "calibration.json"))
    return Setup(calibration, limits, Rig(seed=seed), virtual=True, map_is_known=map_is_known)


def recorded(folder: OutputFolder, plan: Plan, seed: int, stage: Callable[[str], None]) -> Campaign:
    """Measure a campaign into a folder, file by file as `vpp hil campaign --virtual --seed` does, and read it back."""
    told = {"format": "vpp-hil/1", "plan": asdict(plan), "parts": {}}
    for k, part in enumerate(PARTS):
        setup = emulated(steep(Limits()), 100 * seed + k, map_is_known=False)
        with session(setup, folder.path, f"log_{part}.csv.gz", watch=False) as one:
            record = measure(one.rig, part, plan, lambda share, part=part: stage(f"{part} {share:.0%}"))
        told["parts"][part] = one.told() | {"ended": ""}
        write_record(folder, f"{part}.csv", record)
    folder.write("hil.json", json.dumps(told, indent=2) + "\n")
    return read_campaign(folder.path)


def loops(settings: Mapping[str, float], profile: Record, limits: Limits, seeds: Sequence[int]) -> list[Record]:
    """The loop of a controller with these settings on the emulated rig, once for each seed of its noise. RunEnded."""
    speed_only = settings["speed_only"] > 0.5
    start = (settings["omega_min"], settings["beta_fixed"] if speed_only else 0.0)
    found = []
    with tempfile.TemporaryDirectory() as folder:
        for seed in seeds:
            done = run_on_rig(emulated(limits, seed), KernelController(settings), profile, Path(folder), start)
            if done.ended:
                raise RunEnded(done.ended)
            found.append(done.record)
    return found


def mean(records: Sequence[Record]) -> Record:
    """The mean of records over the same times: their noise falls with the root of their number."""
    columns = {name: np.mean([record[name] for record in records], axis=0) for name in records[0].columns}
    return Record(columns, f"mean of {len(records)} runs")
