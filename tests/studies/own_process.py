"""Work in a separate process, so that its memory is separate, and that it can be stopped or crash alone."""

import os
import pickle
import subprocess
import sys
import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path

ROOT = Path(__file__).parents[2]


class Failed(Exception):
    """The work did not finish; the message gives the reason in one line."""


def apart(work: Callable, *arguments, limit: float | None = None, environment: Mapping[str, str] | None = None):
    """Result of `work(*arguments)` in another process, within `limit` s. `work` is a function of a module of the studies; its
    arguments and its result can be pickled. Raises Failed if it does not finish."""
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


def peak(pid: int | str = "self") -> float:
    """Peak memory of a process [MB].

    It is read from /proc, since getrusage's begins with the memory of the process from which it was forked.
    """
    status = dict(line.split(":", 1) for line in Path(f"/proc/{pid}/status").read_text().splitlines())
    return int(status["VmHWM"].split()[0]) / 1024.0


if __name__ == "__main__":
    work, arguments = pickle.load(sys.stdin.buffer)
    Path(sys.argv[1]).write_bytes(pickle.dumps(work(*arguments)))
