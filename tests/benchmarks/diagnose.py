"""python -m tests.benchmarks.diagnose [CAMPAIGN ...] [--against CHECKOUT] [--dask]: time and memory of a diagnosis.

`vpp diagnose` of each campaign (default: the example, and the rigs of ../shared/data), twice: with an empty cache of compiled
models (cold), and with that of the first run (warm). The table has seconds of the wall clock and of all processors, and the
peak memory of the largest process. `--against`: another checkout also runs each campaign warm, and the ratio is printed.
`--dask`: a fleet of copies of one campaign on Dask clusters of 1, 2 and 4 workers, and on 2 of which one is killed.
"""

import argparse
import json
import os
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from identification.demo import example_folder
from tests.studies.own_process import peak

HERE = Path(__file__).resolve().parents[2]
SHARED = HERE.parent / "shared" / "data"

FLEET = 8
"""Campaigns of the fleet on Dask."""


@dataclass(frozen=True)
class Cost:
    """Seconds on the wall clock, seconds of all processors, peak memory of the largest process [MB]."""

    wall: float
    cpu: float
    memory: float


def diagnosed(arguments: Sequence[str], cache: Path, checkout: Path = HERE) -> Cost:
    """Cost of `vpp diagnose` with the code of a checkout and a folder of compiled models. RuntimeError if it fails."""
    environment = {**os.environ, "XDG_CACHE_HOME": str(cache), "PYTHONPATH": str(checkout)}
    began = time.perf_counter()
    with tempfile.TemporaryFile() as said:
        command = [sys.executable, "-m", "vpp_fmu", "diagnose", *arguments]
        process = subprocess.Popen(command, env=environment, cwd=cache, stdout=subprocess.DEVNULL, stderr=said)
        _, status, used = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
        if process.returncode:
            said.seek(0)
            raise RuntimeError(said.read().decode().strip().splitlines()[-1])
    return Cost(time.perf_counter() - began, used.ru_utime + used.ru_stime, used.ru_maxrss / 1024.0)


def outcome(folder: Path) -> str:
    """Verdict and effects of a diagnosis."""
    content = json.loads((folder / "diagnosis.json").read_text())
    return " ".join([content["verdict"], *(effect["name"] for effect in content["effects"])])


def table(campaigns: Sequence[Path], against: Path | None) -> None:
    """A line per campaign, and the medians of each verdict by the number of effects."""
    print(f"{'campaign':10} {'cold s':>7} {'warm s':>7} {'CPU s':>7} {'MB':>5}{'  ratio' * bool(against)}  verdict")
    warm: dict[str, list[Cost]] = {}
    for campaign in campaigns:
        with tempfile.TemporaryDirectory() as folder:
            cache, old_cache, out, other = (Path(folder, name) for name in ("cache", "old_cache", "out", "other"))
            cache.mkdir()
            old_cache.mkdir()
            arguments = [str(campaign.resolve()), "-o", str(out)]
            cold, again = diagnosed(arguments, cache), diagnosed(arguments, cache)
            ratio = ""
            if against:
                before = [diagnosed([arguments[0], "-o", str(other)], old_cache, against.resolve()) for _ in range(2)][-1]
                ratio = f"{again.wall / before.wall:7.2f}"
            found = outcome(out)
            changed = f" (before: {outcome(other)})" if against and outcome(other) != found else ""
        verdict, *effects = found.split()
        warm.setdefault(" ".join([verdict, *([str(len(effects))] if effects else [])]), []).append(again)
        costs = f"{cold.wall:7.1f} {again.wall:7.1f} {again.cpu:7.1f} {again.memory:5.0f}"
        print(f"{campaign.name[:10]:10} {costs}{ratio}  {found}{changed}", flush=True)
    print("\nmedian, warm")
    for verdict, costs in sorted(warm.items()):
        wall, cpu, memory = (statistics.median(getattr(c, n) for c in costs) for n in ("wall", "cpu", "memory"))
        print(f"{verdict:12} of {len(costs)}: {wall:5.1f} s, {cpu:5.1f} CPU s, {memory:4.0f} MB")


@contextmanager
def cluster(workers: int, folder: Path) -> Iterator[tuple[str, subprocess.Popen, list[subprocess.Popen]]]:
    """(address, scheduler, its workers) of a Dask cluster of single processes."""
    address = folder / "scheduler.json"
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL, "cwd": folder}
    programs = [sys.executable, "-m", "distributed.cli.dask_scheduler", "--port", "0", "--no-dashboard"]
    scheduler = subprocess.Popen([*programs, "--scheduler-file", str(address)], **quiet)
    worker = [sys.executable, "-m", "distributed.cli.dask_worker", "--nthreads", "1", "--no-nanny", "--no-dashboard"]
    started: list[subprocess.Popen] = []
    try:
        while not address.exists() or not address.stat().st_size:
            time.sleep(0.1)
        started += [subprocess.Popen([*worker, "--scheduler-file", str(address)], **quiet) for _ in range(workers)]
        yield json.loads(address.read_text())["address"], scheduler, started
    finally:
        for process in (*started, scheduler):
            process.kill()
            process.wait()


def on_dask(campaign: Path) -> None:
    """A line per cluster: seconds, seconds per campaign, memory of the scheduler, and how many campaigns were done."""
    print(f"\n{FLEET} copies of {campaign.name} on Dask\n{'workers':18} {'s':>6} {'s each':>7} {'scheduler MB':>13}  done")
    for workers, killed in ((1, False), (2, False), (4, False), (2, True)):
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name)
            copies = [folder / f"rig_{k}" for k in range(FLEET)]
            for copy in copies:
                copy.symlink_to(campaign.resolve(), target_is_directory=True)
            with cluster(workers, folder) as (address, scheduler, processes):
                arguments = [*map(str, copies), "-o", str(folder / "out"), "--scheduler", address]
                began = time.perf_counter()
                command = [sys.executable, "-m", "vpp_fmu", "diagnose", *arguments]
                run = subprocess.Popen(command, cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
                if killed:
                    while run.poll() is None and not any(folder.glob("out/*/report.html")):  # then in its second campaign
                        time.sleep(0.1)
                    processes[0].send_signal(signal.SIGKILL)
                said, _ = run.communicate()
                seconds = time.perf_counter() - began
                memory = peak(scheduler.pid)
            done = len(list(folder.glob("out/*/diagnosis.json")))
        failed = "" if run.returncode == 0 else f", exit code {run.returncode}: {said.strip().splitlines()[-1]}"
        label = f"{workers}{', one killed' * killed}"
        print(f"{label:18} {seconds:6.1f} {seconds / FLEET:7.1f} {memory:13.0f}  {done} of {FLEET}{failed}", flush=True)


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("campaigns", nargs="*", type=Path, metavar="CAMPAIGN")
    parser.add_argument("--against", type=Path, metavar="CHECKOUT", help="another checkout to compare with")
    parser.add_argument("--dask", action="store_true", help="a fleet on Dask instead (extra dask)")
    options = parser.parse_args(arguments)
    campaigns = options.campaigns or [example_folder(), *sorted(SHARED.glob("rig_*"))]
    if options.dask:
        on_dask(campaigns[0])
    else:
        table(campaigns, options.against)


if __name__ == "__main__":
    main()
