"""Room on the disk for a run: checked before anything is armed, and reserved for the files that are written after the run."""

import os
import tempfile
from collections.abc import Sequence
from pathlib import Path

from hil.loop.columns import RUN
from hil.loop.cycle import PERIOD
from hil.loop.log import Column, free_bytes, largest
from vpp_fmu.errors import BadInput

AROUND = 60.0
"""Time, s, of the ticks around a run at most: rest, three tares, the ESC's start, spin-up, check of signs, ramp-down."""

REST = 2**20
"""Room, bytes, for events, hil.json, report, and the log's rows of a ramp-down: 0.4 MB as a rule."""


def check_room(log: Path, columns: Sequence[Column], seconds: float) -> None:
    """BadInput if the disk has no room for a log of a run of so many seconds, and for the other files of the run."""
    need, free = largest(log, columns, rows_of(seconds)) + _after(seconds), free_bytes(log.parent)
    if free < need:
        allowed = f"{need / 1e6:.1f} MB, which {seconds:.0f} s of log and the files after it may take"
        raise BadInput(log.parent, "free space", f"{free / 1e6:.1f} MB", allowed, "free some, or -o on another disk")


def rows_of(seconds: float) -> int:
    """Ticks of a run over so many seconds, with those before and after it."""
    return round((seconds + AROUND) / PERIOD)


def _after(seconds: float) -> int:
    run = [Column("time"), *(Column(name, exact=True) for name in RUN)]
    return largest(Path("run.csv"), run, round(seconds / PERIOD)) + REST


class Reserve:
    """Space in a folder for the files after a run of so many seconds. It has no name, so the system frees it when the process
    ends, however it does. BadInput if the disk refuses it."""

    def __init__(self, folder: Path, seconds: float):
        size = _after(seconds)
        try:
            self._file = tempfile.TemporaryFile(dir=folder)  # noqa: SIM115 - `free` closes it
            os.posix_fallocate(self._file.fileno(), 0, size)
        except OSError as error:
            found = (error.strerror or str(error)).lower()
            raise BadInput(folder, "free space", found, f"{size / 1e6:.1f} MB for the files after a run") from error

    def free(self) -> None:
        """Give the bytes back."""
        self._file.close()
