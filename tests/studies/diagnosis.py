"""python -m tests.studies diagnosis: does `vpp diagnose` name the hidden effects, and no others, on unknown rigs?

An emulator that shares no code with the project's kernel gives the rigs (rig.py). Each case draws a rig of one of three sizes,
its logger, its noise, the length of its records and its files. It hides one effect (single), a pair, none, one outside the list
(outside), or one that is deleted from the diagnosis' library (deleted). The truth stays in this study. Each case runs in a
separate process and becomes a line of a file as soon as it is done, so that an interrupted study continues where it stopped.
"""

import argparse
import json
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from pathlib import Path

import numpy as np
from tqdm import tqdm

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
from .cases import KINDS, RATES, Case, draw
from .hidden_effects import HIDDEN, LISTED
from .noise import KINDS as NOISES
from .own_process import Failed, apart, peak
from .rig import SIZES, save
from .row_file import kept, read

YES_NO = {"yes": True, "no": False}


def configure(parser: argparse.ArgumentParser) -> None:
    """Options of the study."""
    parser.add_argument("--seeds", type=int, default=4, metavar="N", help="cases of each kind (default: %(default)s)")
    parser.add_argument("--first-seed", type=int, default=0, metavar="K", help="of these (default: %(default)s)")
    parser.add_argument("--kinds", default=",".join(KINDS), metavar="A,B", help="of %(default)s")
    parser.add_argument("--effects", default="", metavar="A,B", help="hide these, each N times, instead of the seeds' turns")
    parser.add_argument("--workers", type=int, default=2, metavar="N", help="cases side by side (default: %(default)s)")
    parser.add_argument("--threads", type=int, default=1, metavar="N", help="fits side by side in each (default: %(default)s)")
    parser.add_argument("--limit", type=float, default=900.0, metavar="S", help="seconds for a case (default: %(default)g)")
    parser.add_argument("--cold", action="store_true", help="each case compiles its models anew")
    parser.add_argument("-o", "--output", default="out/diagnosis.jsonl", metavar="F", help="lines (default: %(default)s)")
    parser.add_argument("--only-table", action="store_true", help="no new cases: the tables of the file's lines, all of them")
    parser.add_argument("--campaigns", metavar="DIR", help="no diagnosis: write the campaigns there, for `vpp diagnose`")
    fixed = parser.add_argument_group("factors that are not drawn")
    fixed.add_argument("--size", choices=SIZES)
    fixed.add_argument("--rate", type=int, choices=RATES)
    fixed.add_argument("--noise", choices=NOISES)
    for name in ("level", "seconds", "strength"):
        fixed.add_argument(f"--{name}", type=float, metavar="X")
    for name in ("repeat", "validation", "static", "steps", "locked"):
        fixed.add_argument(f"--{name}", choices=YES_NO)


def main(parser, arguments):
    configure(parser)
    options = parser.parse_args(arguments)
    path = Path(options.output)
    if options.only_table:
        print(scores.tables(read(path)))
        return
    todo = chosen(options)
    if options.campaigns:
        for case in todo:
            save(case.measured(), case.rig.size, Path(options.campaigns, case.name.replace(" ", "_")))
        return
    known = {e.name for e in LIBRARY if e.off is not None}
    if skipped := [h.name for h in LISTED if h.name not in known]:
        print(f"not in the library, so not studied: {', '.join(skipped)}")
    done = {_key(row): row for row in read(path)}
    wanted = [key for case in todo if (key := _key(case.summary()))]
    missing = [case for case, key in zip(todo, wanted, strict=True) if key not in done]
    for row in kept(path, rows(missing, options.workers, options.threads, options.limit, options.cold)):
        done[_key(row)] = row
    print(scores.tables([done[key] for key in wanted]))


def chosen(options: argparse.Namespace) -> list[Case]:
    """The requested cases."""
    kinds, only = options.kinds.split(","), tuple(filter(None, options.effects.split(",")))
    for asked, allowed in ((kinds, KINDS), (only, HIDDEN)):
        if unknown := set(asked) - set(allowed):
            raise SystemExit(f"not known: {', '.join(sorted(unknown))}; known: {', '.join(allowed)}")
    plain = {n: v for n in ("size", "rate", "noise", "level", "seconds", "strength") if (v := getattr(options, n)) is not None}
    given = plain | {n: YES_NO[v] for n in ("repeat", "validation", "static", "steps", "locked") if (v := getattr(options, n))}
    found = []
    for seed in range(options.first_seed, options.first_seed + options.seeds):
        for kind in kinds:
            hidden = [(name,) for name in only if kind in ("single", "deleted", "outside")] or [None]
            found += [draw(seed, kind, hidden=names, **given) for names in hidden]
    return found


def _key(row: dict) -> str:
    """Identity of a case: its name, factors and deleted effect."""
    return json.dumps([row["name"], row["factors"], row["deleted"]], sort_keys=True)


def outcome(case: Case, threads: int = 1, library: Iterable[Effect] = LIBRARY) -> dict:
    """Measure the case, diagnose it, compare with the truth: a row for the tables."""
    measured, whole = case.measured(), tuple(library)
    began, worked = time.perf_counter(), time.process_time()
    content, before, after = written_results(measured, [e for e in whole if e.name != case.deleted], threads)
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
        again, *_ = written_results(measured, whole, threads)
        row |= {"with_own_name": sorted({e["name"] for e in again["effects"]}.union(*again["family"].values()))}
    return row


def rows(
    cases: Sequence, workers: int, threads: int, limit: float, cold: bool = False, work: Callable = outcome
) -> Iterator[dict]:
    """Rows of the cases in the order in which they end: `work(case, threads)`, or the case's summary with its failure."""

    def one(case) -> dict:
        began = time.perf_counter()
        try:
            with tempfile.TemporaryDirectory() as cache:
                return apart(work, case, threads, limit=limit, environment={"XDG_CACHE_HOME": cache} if cold else None)
        except Failed as failed:
            return case.summary() | {"failed": str(failed), "seconds": time.perf_counter() - began}

    pool = ThreadPoolExecutor(workers)
    try:
        futures = [pool.submit(one, case) for case in cases]
        for future in tqdm(as_completed(futures), total=len(cases), desc="cases", disable=None, leave=False):
            yield future.result()
    finally:
        pool.shutdown(cancel_futures=True)  # if interrupted, running cases end and no other begins


def written_results(measured: Campaign, library: Sequence[Effect], threads: int = 1) -> tuple[dict, ParameterSet, ParameterSet]:
    """Contents of a diagnosis' files: (diagnosis.json, parameters_base.json, parameters.json)."""
    found = diagnose(measured, library, workers=threads)
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
