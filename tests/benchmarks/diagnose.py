"""python -m tests.benchmarks.diagnose [CAMPAIGN ...] [--against CHECKOUT]: time and memory of a diagnosis.

`vpp diagnose` of each campaign (default: the example, and the rigs of ../shared/data), twice: with an empty cache of compiled
models (cold), and with that of the first run (warm). The table has seconds of the wall clock and of all processors, and the
peak memory of the largest process. `--against`: another checkout also runs each campaign warm, and the ratio is printed.
"""

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from identification.demo import example_folder

HERE = Path(__file__).resolve().parents[2]
SHARED = HERE.parent / "shared" / "data"


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


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("campaigns", nargs="*", type=Path, metavar="CAMPAIGN")
    parser.add_argument("--against", type=Path, metavar="CHECKOUT", help="another checkout to compare with")
    options = parser.parse_args(arguments)
    campaigns = options.campaigns or [example_folder(), *sorted(SHARED.glob("rig_*"))]
    table(campaigns, options.against)


if __name__ == "__main__":
    main()
