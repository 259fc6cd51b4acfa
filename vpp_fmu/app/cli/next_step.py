"""The next command for the files of a folder."""

from pathlib import Path

from vpp_fmu.campaign import NAMES
from vpp_fmu.parameters import FILE


def next_step(folder: Path) -> str:
    """A command and its reason: for FMUs, parameters, a campaign, a log, or an empty folder, in this order."""
    names = {path.name for path in folder.iterdir()}
    files = {name.removesuffix(".gz").removesuffix(".csv") for name in names if name.removesuffix(".gz").endswith(".csv")}
    if {"VppPlant.fmu", "VppController.fmu"} <= names and "profile.csv" in names:
        return "vpp cosim VppPlant.fmu VppController.fmu --profile profile.csv -o run (two FMUs and a profile are here)"
    if FILE in names:
        return "vpp export --parameters . -o fmus (parameters are here)"
    if own := sorted(files & set(NAMES)):
        return f"vpp diagnose . -o out (a campaign is here: {', '.join(own)})"
    if folders := sorted(path.name for path in folder.iterdir() if path.is_dir() and any(path.glob("open_loop.csv*"))):
        return f"vpp diagnose {folders[0]} -o out (a campaign is in {folders[0]})"
    if files:
        log = min(name for name in names if name.removesuffix(".gz").endswith(".csv"))
        return f"vpp import csv {log} -o mine --as open_loop (a log is here)"
    return "vpp demo -o demo (nothing of a campaign is here)"
