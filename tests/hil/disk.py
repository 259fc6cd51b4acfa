"""The commands in real time on a disk that is too small, or that fills before a run, in it, at its end, or in a campaign.

Where mounting is allowed, the disk is a separate tmpfs in a namespace, and the kernel refuses with ENOSPC. Elsewhere the files
of the processes are limited to ROOM bytes (RLIMIT_FSIZE, refused as EFBIG). Small files can still be written there, as the
emulated outputs must be, so a campaign is not tried.
"""

import contextlib
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from hil.loop.log import events_of, read_events
from hil.loop.session import found_log, read_log
from hil.results.campaign_folder import measured_so_far
from tests.hil.injection import fill

ROOT = Path(__file__).parents[2]
SIZE, ROOM = 16_000, 65536
TOO_SMALL = 500
"""kB: a disk for 14 s of log."""
LOST = "log: log lost: "
IDLE = b"1000000"
PATIENCE = 120.0
PROFILE = "time,thrust_set\n0,4\n1,8\n4,8\n"
SMALL = ["--points", "2", "--samples", "250", "--settle", "0.5", "--parts", "static"]


@dataclass
class Disk:
    """`folder`: the output folder given to a command; `seen`: its path from outside; `words`: the command's prefix."""

    folder: Path
    seen: Path
    words: list[str]
    mounted: bool

    def fill(self, process: subprocess.Popen | None) -> None:
        """Fill the disk for `process`, or for the next process if it is None."""
        if not self.mounted:
            if process:
                limit(process.pid)
            else:
                self.words = ["sh", "-c", 'ulimit -f 0; exec "$@"', "sh"]
            return
        fill(self.seen)

    def free(self) -> None:
        """Free the disk."""
        (self.seen / "filler").unlink(missing_ok=True)
        self.words = self.words if self.mounted else []


def limit(pid: int) -> None:
    """Limit the files of a process and its descendants to ROOM bytes."""
    for child in Path(f"/proc/{pid}/task/{pid}/children").read_text().split():
        limit(int(child))
    resource.prlimit(pid, resource.RLIMIT_FSIZE, (ROOM, ROOM))


@contextlib.contextmanager
def small_disk(size: int = SIZE) -> Iterator[Disk]:
    """A disk of `size` kB; without a mount, `fill` limits the files of the processes instead."""
    with tempfile.TemporaryDirectory() as name:
        mount = ["unshare", "-m", "sh", "-c", f'mount -t tmpfs -o size={size}k none "$0" && echo ready && exec cat', name]
        holder = subprocess.Popen(mount, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL)
        try:
            mounted = holder.stdout.readline() == b"ready\n"
            words = ["nsenter", f"--target={holder.pid}", "--mount"] if mounted else []
            yield Disk(Path(name), Path(f"/proc/{holder.pid}/root{name}") if mounted else Path(name), words, mounted)
        finally:
            holder.communicate()


def command(disk: Disk, *words: str) -> subprocess.Popen:
    """`vpp hil ...` on the disk."""
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    own = [*disk.words, sys.executable, "-m", "vpp_fmu", "hil", *words]
    return subprocess.Popen(own, env=environment, text=True, cwd=ROOT, start_new_session=True, **pipes)


@dataclass(frozen=True)
class Became:
    """Result: `code` and `said` (standard error) of the command; `pulse`: last output of the ESC, None if it was never opened;
    `kept`: description of the readable data; `wrong`: violated requirements."""

    code: int
    said: str
    pulse: bytes | None
    kept: str
    wrong: str


def full(phase: str) -> Became:
    """Fill the disk in a phase: "start", "run", "end" or "campaign"; or give too small a one: "small"."""
    with small_disk(TOO_SMALL if phase == "small" else SIZE) as disk:
        if phase in ("small", "campaign") and not disk.mounted:
            return Became(0, "not tried: no tmpfs can be mounted here", None, "", "")
        (disk.seen / "step.csv").write_text(PROFILE)
        words = ["campaign", *SMALL] if phase == "campaign" else ["run", "--profile", str(disk.folder / "step.csv")]
        if phase == "start":
            disk.fill(None)
        process = command(disk, *words, "-o", str(disk.folder / "out"))
        pulse = esc = None
        if phase not in ("start", "small"):
            reached = {
                "run": lambda event: event.get("state") == "run",
                "end": lambda event: event.get("why") == "end of the run",
                "campaign": lambda event: "point" in event,
            }[phase]
            esc = _until(process, disk.seen / "out", reached)
            disk.fill(process)
        _, said = process.communicate(timeout=PATIENCE)
        if esc is not None:
            pulse = os.pread(esc, 32, 0).split(b"\n")[0]
            os.close(esc)
        unsaid = _unsaid(disk, said) if phase == "run" else []
        disk.free()
        kept, wrong = _kept(disk, phase)
        lines = [line for line in said.splitlines() if line.startswith("vpp")]
        turns = phase not in ("start", "small")
        code = 0 if phase == "end" and disk.mounted else 2  # then the reserve holds the files after the run
        wrong = [
            *wrong,
            *unsaid,
            *["no line or more than one says so"] * (len(lines) != (code == 2) or "Traceback" in said),
            *["the ESC is not at idle"] * (pulse != (IDLE if turns else None)),
            *[f"exit code {process.returncode}, must be {code}"] * (process.returncode != code),
            *["does not say how much is free"] * (phase == "small" and "free space: found" not in said),
        ]
        return Became(process.returncode, lines[0] if lines else said.strip(), pulse, kept, "; ".join(wrong))


def _unsaid(disk: Disk, said: str) -> list[str]:
    """The places that do not give the reason of the end, while the disk is still full."""
    out = disk.seen / "out"
    texts = {name: (out / name).read_text() if (out / name).exists() else "" for name in ("hil.json", "report.html")}
    unsaid = [name for name, text in (texts | {"standard error": said}).items() if LOST not in text]
    return [f"{name} does not say why it ended" for name in unsaid if disk.mounted or name == "standard error"]


def _kept(disk: Disk, phase: str) -> tuple[str, list[str]]:
    """(description of the data that can be read once the disk is free, violated requirements)."""
    out = disk.seen / "out"
    if phase in ("start", "small"):
        turned = any("run" in path.read_text() for path in out.rglob("*.events.jsonl"))
        return "nothing was begun", ["it turned"] * turned
    if phase == "campaign":
        points = len(measured_so_far(out, "static"))
        again = command(disk, "campaign", *SMALL, "--resume", "-o", str(disk.folder / "out"))
        _, said = again.communicate(timeout=PATIENCE)
        rows = (out / "static.csv").read_text().count("\n") - 1 if (out / "static.csv").exists() else 0
        wrong = [f"resumed: {said.strip()}"] * (again.returncode != 0) + ["no point was kept"] * (points < 1)
        return f"{points} points; resumed: {rows}", wrong + ["not 4 points"] * (rows != 4)
    (folder,) = (out / "runs").iterdir()
    rows = len(read_log(found_log(folder)))
    again = command(disk, "report", str(disk.folder / "out" / "runs" / folder.name))
    _, said = again.communicate(timeout=PATIENCE)
    summary = json.loads((folder / "hil.json").read_text())
    wrong = [f"report: {said.strip()}"] * (again.returncode != 0) + ["no rows"] * (rows < 500)
    return f"{rows} rows in the log, of which a report was made", wrong + ["it still runs"] * (summary["status"] == "running")


def _until(process: subprocess.Popen, out: Path, reached: Callable[[dict], bool]) -> int | None:
    """Wait for an event beside a log; return the open file of the ESC's pulse."""
    end, esc = time.monotonic() + PATIENCE, None
    while time.monotonic() < end and process.poll() is None:
        if esc is None:
            esc = esc_of(process.pid)
        if any(reached(event) for log in out.rglob("*.events.jsonl") for event in read_events(events_of(log))):
            return esc
        time.sleep(0.02)
    return esc


def esc_of(pid: int) -> int | None:
    """The file of the ESC's pulse that a process has open, opened for reading."""
    with contextlib.suppress(OSError):
        for link in Path(f"/proc/{pid}/fd").iterdir():
            if os.readlink(link).endswith("pwm0/duty_cycle"):
                return os.open(link, os.O_RDONLY)
    return None
