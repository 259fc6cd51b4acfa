"""python -m tests.studies diagnosis: does `vpp diagnose` name what is missing, and nothing else, on rigs it knows nothing of?

The rigs are an emulator that shares no code with the project's kernel (rig.py). Each case hides one effect (singles; faint: as
small as can just be seen), a pair, none, one that is in no list (outside), or one that the library given to the diagnosis lacks
(deleted). The truth stays in this study.
"""

import argparse
import json
import time
from collections.abc import Iterable
from functools import partial
from pathlib import Path

import numpy as np

from identification.diagnose.diagnose import Diagnosis, diagnose
from identification.workers import spread
from vpp_fmu.campaign import Campaign
from vpp_fmu.kernel.plant import LIBRARY
from vpp_fmu.kernel.types import Effect

from . import scores
from .cases import KINDS, Case, cases
from .missing import HIDDEN, LISTED
from .rig import Rig


def configure(parser: argparse.ArgumentParser) -> None:
    """Options of the study."""
    parser.add_argument("--seeds", type=int, default=2, metavar="N", help="rigs per effect (default: %(default)s)")
    parser.add_argument("--first-seed", type=int, default=0, metavar="N", help="of these (default: %(default)s)")
    parser.add_argument("--effects", default="", metavar="A,B", help="only cases that hide one of these")
    parser.add_argument("--only", default=",".join(KINDS), metavar="KINDS", help="of %(default)s")
    parser.add_argument("--workers", type=int, default=2, metavar="N", help="cases side by side (default: %(default)s)")
    parser.add_argument("--scheduler", metavar="ADDR", help="Dask scheduler instead of processes")
    parser.add_argument("-o", "--output", metavar="DIR", help="write cases.json and confusion.csv there")


def run(options: argparse.Namespace) -> None:
    """Run the cases and print what came out."""
    kinds, only = options.only.split(","), tuple(filter(None, options.effects.split(",")))
    for asked, allowed in ((kinds, KINDS), (only, HIDDEN)):
        if unknown := set(asked) - set(allowed):
            raise SystemExit(f"not known: {', '.join(sorted(unknown))}; known: {', '.join(allowed)}")
    known = {e.name for e in LIBRARY if e.off is not None}
    if skipped := [h.name for h in LISTED if h.name not in known]:
        print(f"not in the library, so not studied: {', '.join(skipped)}")
    seeds = range(options.first_seed, options.first_seed + options.seeds)
    folder = Path(options.output) if options.output else None
    if folder:
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "progress.jsonl").write_text("")
    todo = cases(known, seeds, kinds, only)
    found = spread(partial(outcome, log=folder), todo, options.workers, options.scheduler, "cases")
    print(scores.tables(found))
    if folder:
        (folder / "cases.json").write_text(json.dumps(found, indent=1))
        (folder / "confusion.csv").write_text(scores.confusion(found))


def main(arguments: list[str]) -> None:
    """`python -m tests.studies diagnosis`."""
    parser = argparse.ArgumentParser(prog="python -m tests.studies diagnosis", description=__doc__)
    configure(parser)
    run(parser.parse_args(arguments))


def outcome(case: Case, log: Path | None = None, library: Iterable[Effect] = LIBRARY) -> dict:
    """Build the case, diagnose it, compare with the truth: all that the tables need. `log`: folder of progress.jsonl."""
    measured, rig, sizes = case.build()
    whole = tuple(library)
    library = tuple(e for e in whole if e.name != case.deleted)
    began = time.perf_counter()
    found = diagnose(measured, library, workers=1, seed=0)
    seconds = time.perf_counter() - began
    entry = {"kind": case.kind, "hidden": list(case.hidden), "seed": case.seed, "deleted": case.deleted, "sizes": sizes}
    entry |= {"evidence": case.evidence(measured, rig), "equal": case.equals(measured, rig)}
    entry |= {"seconds": seconds, "verdict": found.verdict}
    entry |= {
        "own_name_gains": _own_name_gains(found, measured, whole) if case.deleted and found.verdict in scores.NAMED else None
    }
    entry |= {"effects": list(found.final.effects), "family": {n: list(o) for n, o in found.family.items()}}
    entry |= {"explained": found.explained and found.explained.share, "removed": removed(found, measured, rig)}
    entry |= {"left": [found.before_left.share, found.left.share, found.left.error]}
    entry |= {"parameters": _parameters(found, case.truth(sizes)), "values": _own(found)}
    entry |= {"refused": {n: list(j.refused) for n, j in found.selection.refused.items()}, "rounds": _rounds(found)}
    if log is not None:
        with (log / "progress.jsonl").open("a") as file:
            file.write(json.dumps(entry) + "\n")
    return entry


def _own_name_gains(found: Diagnosis, measured: Campaign, library: Iterable[Effect]) -> float:
    """Log-likelihood that the effects found with the whole library have over a diagnosis that lacked the one that is hidden."""
    return 0.5 * (found.final.deviance - diagnose(measured, library, workers=1, seed=0).final.deviance)


def removed(found: Diagnosis, measured: Campaign, rig: Rig) -> float | None:
    """Share of the validation record's true error power (no noise in it) that the augmented model removes."""
    record = measured.validation
    speed, pitch = record["omega_ref"], record["beta_ref"]
    true = rig.force(rig.run(speed, pitch), speed, pitch)
    before, after = (np.mean((found.prediction(f, record).thrust - true) ** 2) for f in (found.base, found.final))
    return float(1.0 - after / before)


def _parameters(found: Diagnosis, truth: dict[str, float]) -> dict:
    """Of each parameter with a true value that the diagnosis claims to know: [true, found, std, whether within 10 % or the 95 %
    interval]."""
    compared = {}
    for name, true in truth.items():
        if name not in found.final.free or (std := found.doubt.get(name)) is None:
            continue
        value = found.final.values[name]
        low, high = found.final.thresholds.get(name, (value - 1.96 * std, value + 1.96 * std))
        good = abs(value - true) <= 0.1 * abs(true) or low <= true <= high
        compared[name] = [true, value, std, bool(good)]
    return compared


def _own(found: Diagnosis) -> dict[str, float]:
    return {n: found.final.values[n] for n in (*found.final.free, *found.final.forms)}


def _rounds(found: Diagnosis) -> list[list]:
    """Of each round the candidates with the best look: [label, promised gain, fall of the BIC or None, bounds hit]."""
    rounds = []
    for tried in found.selection.rounds:
        best = sorted(tried, key=lambda t: -(t.delta_bic if t.fit is not None else -1e9))
        rounds.append([[t.candidate.label, t.fall, t.delta_bic, list(t.fit.at_bound) if t.fit else []] for t in best])
    return rounds
