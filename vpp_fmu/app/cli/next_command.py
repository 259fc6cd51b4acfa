"""The next command: for what a verb has just written, or for what a folder holds."""

import argparse
import shlex
from collections.abc import Callable, Collection, Iterator
from pathlib import Path

from vpp_fmu.campaign import NAMES
from vpp_fmu.parameters import FILE, POLICY

LOOPS = (("VppPlant.fmu", "VppController.fmu"), ("VppPlant.native.fmu", "VppController.native.fmu"))
"""FMUs of the closed loop, of each flavour."""


def next_step(folder: Path, names: Collection[str] | None = None, options: argparse.Namespace | None = None) -> tuple[str, str]:
    """(a command, its reason) for the files `names` of a folder: those that the verb of `options` has written, or all.

    With `options` the command has their campaign, parameters and profile, too.
    """
    found = {path.name for path in folder.iterdir()} if names is None else set(names)
    asked = vars(options) if options else {}

    def at(name: str = "") -> str:
        return shlex.quote(str(folder / name))

    return next(_steps(folder, found, asked, at))


def _steps(folder: Path, names: set[str], asked: dict, at: Callable[..., str]) -> Iterator[tuple[str, str]]:
    """All steps that are possible, the most advanced one first."""
    own = [at("learned_effect.py")] if "learned_effect.py" in names else []
    effects = "".join(f" --effects-from {file}" for file in [*map(shlex.quote, asked.get("effects_from") or ()), *own])
    plant = f" --parameters {shlex.quote(str(asked['parameters']))}" if asked.get("parameters") else ""
    given = asked.get("campaign") or (asked.get("campaigns") or [None])[0]
    tables = {name.removesuffix(".gz").removesuffix(".csv") for name in names if name.removesuffix(".gz").endswith(".csv")}
    profile = "profile.csv" if "profile.csv" in names else None
    beside = Path(str(asked.get("gains"))).with_name("profile.csv")  # vpp tune writes both
    loop = next((pair for pair in LOOPS if names.issuperset(pair)), None)
    if loop and (profile or (asked.get("gains") and beside.is_file())):
        wanted = at(profile) if profile else shlex.quote(str(beside))
        yield f"vpp cosim {' '.join(map(at, loop))} --profile {wanted} -o run", "two FMUs and a profile are here"
    if asked and (fmus := sorted((name for name in names if name.endswith(".fmu")), key=lambda name: "Plant" not in name)):
        inputs = f"{fmus[0].split('.')[0]}_in.csv"
        read = f" --input-file {at(inputs)}" if inputs in names else ""
        yield f"fmpy simulate {at(fmus[0])}{read} --output-file simulated.csv", "an FMU and its inputs are here"
    if names & {"tuning.json", "allocation.json"}:
        yield f"vpp export{plant}{effects} --gains {at()} -o fmus", "gains are here"
    if POLICY in names:
        yield f"vpp export{plant}{effects} --policy {at()} -o fmus", "a learned law is here"
    if FILE in names and "diagnosis.json" in names:
        yield f"vpp tune --parameters {at()}{effects} -o gains", "a diagnosed model is here"
    if FILE in names and given:
        command = f"vpp diagnose {shlex.quote(str(given))} --parameters {at()}{effects} -o diagnosed"
        yield command, "a model of a campaign is here"
    if FILE in names:
        yield f"vpp export --parameters {at()}{effects} -o fmus", "parameters are here"
    if "check.json" in names and given:
        yield f"vpp diagnose {shlex.quote(str(given))} -o out", "the campaign is checked"
    if "plan.json" in names:
        yield f"vpp hil campaign --virtual{plant} --commands {at()} -o measured", "commands of an experiment are here"
    if "prediction.csv" in names and asked.get("record"):
        yield f"vpp compare {shlex.quote(str(asked['record']))} {at()} -o compared", "a prediction of a record is here"
    if "calibration.json" in names:
        kind = "--rig real" if asked.get("rig", [""])[0] == "real" else "--virtual"
        yield f"vpp hil selftest {kind} --calibration {at()} -o selftest", "a calibration is here"
    if parts := sorted(tables & set(NAMES)):
        why = f"a campaign is here: {', '.join(parts)}"
        yield (f"vpp check {at()}" if asked else f"vpp diagnose {at()} -o out"), why
    if "report.html" in names:
        yield f"python -m webbrowser {at('report.html')}", "a report is here"
    if folders := sorted(path.name for path in folder.iterdir() if path.is_dir() and any(path.glob("open_loop.csv*"))):
        yield f"vpp diagnose {at(folders[0])} -o out", f"a campaign is in {folders[0]}"
    if tables:
        log = min(name for name in names if name.removesuffix(".gz").endswith(".csv"))
        yield f"vpp import csv {at(log)} -o mine --as open_loop", "a log is here"
    yield "vpp demo -o demo", "nothing of a campaign is here"
