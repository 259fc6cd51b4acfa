"""python -m tests.studies diagnosis: does `vpp diagnose` name the hidden effects, and no others, on unknown rigs?

An emulator that shares no code with the project's kernel gives the rigs (rig.py). Each case draws a rig of one of three sizes,
its logger, its noise, the length of its records and its files. It hides one effect (single), a pair, none, one outside the list
(outside), or one that is deleted from the diagnosis' library (deleted). The truth stays in this study. Each case runs in a
separate process and becomes a line of a file as soon as it is done, so that an interrupted study continues where it stopped.
"""

import json
import tempfile
import time
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

from identification.diagnose.diagnose import diagnose
from identification.diagnose.learned.description import FILE
from vpp_fmu.app.report.summary import write_diagnosis
from vpp_fmu.campaign import Campaign
from vpp_fmu.files import OutputFolder
from vpp_fmu.kernel.plant import LIBRARY, plant
from vpp_fmu.kernel.types import Effect
from vpp_fmu.native import Simulator
from vpp_fmu.own_effects import library_with
from vpp_fmu.parameters import ParameterSet, read_parameters
from vpp_fmu.record import Record

from . import scores
from .cases import KINDS, Case, draw
from .hidden_effects import HIDDEN, LISTED
from .rows import add_options, completed, peak


def main(parser, arguments):
    parser.add_argument("--seeds", type=int, default=4, metavar="N", help="cases of each kind (default: %(default)s)")
    parser.add_argument("--kinds", default=",".join(KINDS), metavar="A,B", help="of %(default)s")
    parser.add_argument("--effects", default="", metavar="A,B", help="hide these, each N times, instead of the seeds' turns")
    add_options(parser, "out/diagnosis.jsonl")
    options = parser.parse_args(arguments)
    known = {e.name for e in LIBRARY if e.off is not None}
    if skipped := [h.name for h in LISTED if h.name not in known]:
        print(f"not in the library, so not studied: {', '.join(skipped)}")
    seeds = range(options.first_seed, options.first_seed + options.seeds)
    found = chosen(seeds, options.kinds.split(","), tuple(filter(None, options.effects.split(","))))
    print(scores.tables(completed(options, found, outcome)))


def chosen(seeds: Iterable[int], kinds: Sequence[str], only: Sequence[str] = ()) -> list[Case]:
    """The cases of these seeds and kinds. `only`: effects to hide; none: those of the seeds' turns."""
    for asked, allowed in ((kinds, KINDS), (only, HIDDEN)):
        if unknown := set(asked) - set(allowed):
            raise SystemExit(f"not known: {', '.join(sorted(unknown))}; known: {', '.join(allowed)}")
    found = []
    for seed in seeds:
        for kind in kinds:
            hidden = [(name,) for name in only if kind in ("single", "deleted", "outside")] or [None]
            found += [draw(seed, kind, hidden=names) for names in hidden]
    return found


def outcome(case: Case, library: Iterable[Effect] = LIBRARY) -> dict:
    """Measure the case, diagnose it, compare with the truth: a row for the tables."""
    measured, whole = case.measured(), tuple(library)
    began, worked = time.perf_counter(), time.process_time()
    content, before, after = written_results(measured, [e for e in whole if e.name != case.deleted])
    costs = {"seconds": time.perf_counter() - began, "cpu": time.process_time() - worked, "mb": peak()}
    row = case.summary() | {"failed": None} | costs
    row |= {"readings": sum(len(r) for r in (measured.open_loop, measured.repeat) if r is not None)}
    row |= {"evidence": case.evidence(measured.open_loop), "equal": case.equals(measured.open_loop)}
    row |= {"verdict": content["verdict"], "effects": [e["name"] for e in content["effects"]]}
    row |= {"family": content["family"], "lack_of_fit": content.get("lack_of_fit")}
    row |= {"learned": (term := content["learned"]) and [term["port"], term["driver"]]}
    record, true = case.unseen()
    errors = [_outputs(found, record)[:, 0] - true for found in (before, after)]
    row |= {"parameters": compared(content, case.truth())}
    row |= {"true_error": [float(np.sqrt(np.mean(error**2))) for error in errors]}  # rms N, on a record that no fit has seen
    row |= {"behind": case.behind(measured.open_loop, *_outputs(after, measured.open_loop)[:, :2].T)}
    if case.deleted and scores.wrong(row):
        # The names that the diagnosis gives if the library has the true effect.
        again, *_ = written_results(measured, whole)
        row |= {"with_own_name": sorted({e["name"] for e in again["effects"]}.union(*again["family"].values()))}
    return row


def written_results(measured: Campaign, library: Sequence[Effect]) -> tuple[dict, ParameterSet, ParameterSet]:
    """Contents of a diagnosis' files: (diagnosis.json, parameters_base.json, parameters.json)."""
    found = diagnose(measured, library, workers=1)
    with tempfile.TemporaryDirectory() as folder:
        write_diagnosis(OutputFolder(folder), found)
        content = json.loads(Path(folder, "diagnosis.json").read_text())
        own = library_with(Path(folder).glob(FILE), library)
        sets = [
            read_parameters(Path(folder, name), lambda names: plant(names, own))
            for name in ("parameters_base.json", "parameters.json")
        ]
    return content, *sets


def _outputs(found: ParameterSet, record: Record) -> np.ndarray:
    """(rows, 3) thrust [N], speed [rpm], pitch [deg]."""
    return Simulator(found.model).simulate(found.values, *record.run)


def compared(content: dict, truth: dict[str, float]) -> dict[str, list]:
    """For each parameter with a true value and a standard deviation in the diagnosis: [true, found, std, whether within 10 % or
    the 95 % interval]."""
    found = {}
    for effect in content["effects"]:
        for name, entry in effect["parameters"].items():
            true = truth.get(f"{effect['name']}.{name}")
            if true is None or entry["std"] is None:
                continue
            value, half = entry["value"], 1.96 * entry["std"]
            low, high = effect.get("intervals", {}).get(name) or (value - half, value + half)
            good = abs(value - true) <= 0.1 * abs(true) or low <= true <= high
            found[f"{effect['name']}.{name}"] = [true, value, entry["std"], bool(good)]
    return found
