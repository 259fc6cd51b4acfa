"""Cases of a study in separate processes, and their rows in a file, so that an interrupted study continues where it stopped."""

import argparse
import json
import pickle
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from pathlib import Path

from tqdm import tqdm

from .rig import save

ROOT = Path(__file__).parents[2]


class Failed(Exception):
    """The work did not finish; the message gives the reason in one line."""


def apart(work: Callable, *arguments, limit: float | None = None):
    """Result of `work(*arguments)` in another process, within `limit` s. `work` is a function of a module of the studies; its
    arguments and its result can be pickled. Raises Failed if it does not finish."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "result")
        command, sent = [sys.executable, "-m", "tests.studies.rows", str(path)], pickle.dumps((work, arguments))
        try:
            ended = subprocess.run(command, check=False, input=sent, capture_output=True, timeout=limit, cwd=ROOT)
        except subprocess.TimeoutExpired as error:
            raise Failed(f"not done in {limit:g} s") from error
        if not path.exists():
            last = ended.stderr.decode(errors="replace").strip().splitlines()
            raise Failed(last[-1] if last else f"ended with {ended.returncode}")
        return pickle.loads(path.read_bytes())


def peak() -> float:
    """Peak memory of this process [MB].

    It is read from /proc, since getrusage's begins with the memory of the process from which it was forked.
    """
    status = dict(line.split(":", 1) for line in Path("/proc/self/status").read_text().splitlines())
    return int(status["VmHWM"].split()[0]) / 1024.0


def add_options(parser: argparse.ArgumentParser, output: str, saves: bool = True) -> None:
    """Options of all studies whose cases are rows of a file."""
    parser.add_argument("--first-seed", type=int, default=0, metavar="K", help="first of the seeds (default: %(default)s)")
    parser.add_argument("--workers", type=int, default=2, metavar="N", help="cases side by side (default: %(default)s)")
    parser.add_argument("--limit", type=float, default=900.0, metavar="S", help="seconds for a case (default: %(default)g)")
    parser.add_argument("-o", "--output", default=output, metavar="F", help="the file of rows (default: %(default)s)")
    parser.add_argument("--only-table", action="store_true", help="no new cases: the tables of the file's rows, all of them")
    parser.set_defaults(save=None)
    if saves:
        parser.add_argument("--save", metavar="DIR", help="no diagnosis: write the campaigns there, for `vpp diagnose`")


def completed(options: argparse.Namespace, cases: Sequence, work: Callable) -> list[dict]:
    """Rows of the cases: those that the file has, by name, and `work(case)` of the others. With --only-table, all of the file.
    With --save, it ends the program instead."""
    if options.save:
        for case in cases:
            save(case.measured(), case.rig.size, Path(options.save, case.name.replace(" ", "_")))
        sys.exit()
    path = Path(options.output)
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("a+") as file:
        file.seek(0)
        done = {row["name"]: row for row in map(json.loads, file)}
        if options.only_table:
            return list(done.values())
        for row in _worked([case for case in cases if case.name not in done], options, work):
            file.write(json.dumps(row) + "\n")
            file.flush()
            done[row["name"]] = row
    return [done[case.name] for case in cases]


def _worked(cases: Sequence, options: argparse.Namespace, work: Callable) -> Iterator[dict]:
    """Rows in the order in which they end; of a case that fails, its summary with the reason."""

    def one(case) -> dict:
        began = time.perf_counter()
        try:
            return apart(work, case, limit=options.limit)
        except Failed as failed:
            return case.summary() | {"failed": str(failed), "seconds": time.perf_counter() - began}

    pool = ThreadPoolExecutor(options.workers)
    try:
        futures = [pool.submit(one, case) for case in cases]
        for future in tqdm(as_completed(futures), total=len(cases), desc="cases", disable=None, leave=False):
            yield future.result()
    finally:
        pool.shutdown(cancel_futures=True)  # if interrupted, running cases end and no other begins


if __name__ == "__main__":
    work, arguments = pickle.load(sys.stdin.buffer)
    Path(sys.argv[1]).write_bytes(pickle.dumps(work(*arguments)))
