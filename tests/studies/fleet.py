"""python -m tests.studies fleet: do two processes and a Dask cluster of two workers write the same files for many campaigns?

Short campaigns of the studies' emulator, which shares no code with the project's kernel: rigs of three sizes in turn, logged at
100 Hz, with no hidden effect, one, two, or one outside the list. `vpp diagnose` judges all of them twice, by `--workers` and by
`--scheduler`, each time into an empty folder and with an empty cache of compiled models. Aim: every file that both write is the
same byte for byte. No file is left out of the comparison. SOURCE_DATE_EPOCH gives the results of both the same date, and no
file has run times.
"""

import contextlib
import csv
import filecmp
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from datetime import date, timedelta
from pathlib import Path
from unittest.mock import patch

import numpy as np
from tqdm import tqdm

from vpp_fmu.date import EPOCH

from .cases import Case, draw
from .own_process import ROOT
from .rig import SIZES, save

KINDS = ("none", "single", "pair", "outside")

RATE = 100
"""Hz."""

SECONDS = (15.0, 20.0)
"""Range of the open-loop record's length."""

FIRST = date(2026, 1, 1)
"""First of the campaigns' days, one a campaign; the folder's name has the day, and the table reads it there."""


def main(parser, arguments):
    parser.add_argument("--campaigns", type=int, default=100, metavar="N", help="(default: %(default)s)")
    parser.add_argument("--first-seed", type=int, default=0, metavar="K", help="of these (default: %(default)s)")
    parser.add_argument("--workers", type=int, default=2, metavar="N", help="of each kind (default: %(default)s)")
    parser.add_argument("-o", "--output", metavar="DIR", help="keep campaigns and results there (default: nothing is kept)")
    options = parser.parse_args(arguments)
    from dask.distributed import LocalCluster

    with contextlib.ExitStack() as stack:
        folder = Path(options.output or stack.enter_context(tempfile.TemporaryDirectory())).resolve()
        seeds = range(options.first_seed, options.first_seed + options.campaigns)
        campaigns = measured([case(seed) for seed in seeds], folder / "campaigns")
        processes, cluster = folder / "processes", folder / "cluster"
        with environment(), timed(f"{options.workers} processes", len(campaigns)):
            diagnose(campaigns, ["--workers", str(options.workers)], processes)
        own = {"n_workers": options.workers, "threads_per_worker": 1, "dashboard_address": None}
        with environment(), timed(f"Dask, {options.workers} workers", len(campaigns)), LocalCluster(**own) as scheduler:
            diagnose(campaigns, ["--scheduler", scheduler.scheduler_address], cluster)
        show(processes, cluster)


def case(seed: int) -> Case:
    """A short campaign; its kind, its rig's size and its hidden effects depend on the seed, in turn."""
    kind, turn = KINDS[seed % len(KINDS)], seed // len(KINDS)
    size = list(SIZES)[turn % len(SIZES)]
    seconds = float(np.round(np.random.default_rng(seed).uniform(*SECONDS), 1))
    return draw(turn, kind, size=size, rate=RATE, seconds=seconds, steps=False)


def measured(cases: Sequence[Case], folder: Path) -> list[Path]:
    """Folders of the cases' campaigns, without their truth."""
    found = []
    for k, one in enumerate(tqdm(cases, desc="campaigns", disable=None, leave=False)):
        found.append(folder / f"{FIRST + timedelta(days=k)}_{one.factors.size}")
        save(one.measured(), one.rig.size, found[-1])
    return found


@contextlib.contextmanager
def environment() -> Iterator[None]:
    """Processes that are started within have an empty cache, and one date for all results."""
    with tempfile.TemporaryDirectory() as cache, patch.dict(os.environ, {"XDG_CACHE_HOME": cache, EPOCH: "0"}):
        yield


def diagnose(campaigns: Sequence[Path], words: Sequence[str], out: Path) -> None:
    """`vpp diagnose` of all campaigns, as a user runs it."""
    command = [sys.executable, "-m", "vpp_fmu", "diagnose", *map(str, campaigns), *words, "-o", str(out)]
    done = subprocess.run(command, cwd=ROOT, check=False, capture_output=True, text=True)
    if done.returncode not in (0, 2):  # 2: some were refused, and the table says which
        raise SystemExit(done.stderr)


@contextlib.contextmanager
def timed(name: str, campaigns: int) -> Iterator[None]:
    """Print the seconds and the CPU seconds (of child processes that have ended) of the block."""
    began, worked = time.perf_counter(), resource.getrusage(resource.RUSAGE_CHILDREN)
    yield
    seconds, now = time.perf_counter() - began, resource.getrusage(resource.RUSAGE_CHILDREN)
    work = now.ru_utime + now.ru_stime - worked.ru_utime - worked.ru_stime
    each = f"{seconds / campaigns:.1f} s and {work / campaigns:.1f} CPU s a campaign"
    print(f"{name}: {seconds:.0f} s, {work:.0f} CPU s; {each}", flush=True)


def compared(one: Path, other: Path) -> dict[str, tuple[int, int]]:
    """By name of a file: (number of such files in either folder, number of those that differ)."""
    files = {p.relative_to(root) for root in (one, other) for p in root.rglob("*") if p.is_file()}
    _, *unlike = filecmp.cmpfiles(one, other, sorted(map(str, files)), shallow=False)
    bad = {Path(name) for names in unlike for name in names}
    kinds, wrong = (Counter(str(f) if f.parent == Path() else f"*/{f.name}" for f in which) for which in (files, bad))
    return {kind: (count, wrong[kind]) for kind, count in sorted(kinds.items())}


def show(one: Path, other: Path) -> None:
    """Print the verdicts, and whether the files of both folders are the same."""
    rows = list(csv.DictReader((one / "fleet.csv").read_text().splitlines()))
    verdicts = Counter(row["verdict"] for row in rows)
    print(f"{len(rows)} campaigns: {', '.join(f'{word} {count}' for word, count in verdicts.most_common())}")
    for kind, (count, unlike) in compared(one, other).items():
        print(f"{kind:28} {'same' if not unlike else f'{unlike} NOT THE SAME'}, {count} {'file' if count == 1 else 'files'}")
