"""Work in a process of its own, so that its memory is its own, and that it can be stopped or crash alone."""

import os
import pickle
import subprocess
import sys
import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path

ROOT = Path(__file__).parents[2]


class Failed(Exception):
    """The work did not come to its end: in one line, why."""


def apart(work: Callable, *arguments, limit: float | None = None, environment: Mapping[str, str] | None = None):
    """`work(*arguments)` of another process, within `limit` s. `work` is a function of a module of the studies; what goes in
    and out can be pickled. Failed where it ends otherwise."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "result")
        command = [sys.executable, "-m", "tests.studies.own_process", str(path)]
        settings = {**os.environ, **(environment or {})}
        try:
            ended = subprocess.run(
                command,
                check=False,
                input=pickle.dumps((work, arguments)),
                capture_output=True,
                timeout=limit,
                cwd=ROOT,
                env=settings,
            )
        except subprocess.TimeoutExpired as error:
            raise Failed(f"not done in {limit:g} s") from error
        if not path.exists():
            last = ended.stderr.decode(errors="replace").strip().splitlines()
            raise Failed(last[-1] if last else f"ended with {ended.returncode}")
        return pickle.loads(path.read_bytes())


def peak() -> float:
    """MB that this process has had at most.

    By its own account, since getrusage's starts with what the process had that this one was forked from.
    """
    told = dict(line.split(":", 1) for line in Path("/proc/self/status").read_text().splitlines())
    return int(told["VmHWM"].split()[0]) / 1024.0


def main() -> None:
    """The other process."""
    work, arguments = pickle.load(sys.stdin.buffer)
    result = work(*arguments)
    Path(sys.argv[1]).write_bytes(pickle.dumps(result))


if __name__ == "__main__":
    main()
