"""One process per rig: no device is opened and no output written before the process has the lock."""

import fcntl
import os
from pathlib import Path

from hil.safety.faults import DeviceFault, FaultKind


def locked(chip: Path) -> int:
    """An exclusive lock on the rig whose outputs are those of the PWM chip in the folder `chip`; the descriptor that holds it.

    It ends when the last process that has the descriptor ends or closes it, however that comes about: no file is left behind.
    DeviceFault NOT_READY names who has it.
    """
    descriptor = os.open(chip.resolve(), os.O_RDONLY | os.O_DIRECTORY)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError as error:
        holder = _holder(os.fstat(descriptor))
        os.close(descriptor)
        raise DeviceFault("rig", FaultKind.NOT_READY, f"in use by {holder}; nothing was written") from error
    return descriptor


def _holder(at: os.stat_result) -> str:
    """Holder of a lock on the file, in words, from the kernel's list."""
    wanted = f"{os.major(at.st_dev):02x}:{os.minor(at.st_dev):02x}:{at.st_ino}"
    try:
        for line in Path("/proc/locks").read_text().splitlines():
            cells = line.split()
            if wanted in cells and "FLOCK" in cells and cells[4].isdecimal() and int(cells[4]) > 0:
                words = Path(f"/proc/{cells[4]}/cmdline").read_bytes().replace(b"\0", b" ").decode(errors="replace")
                return f"process {cells[4]} ({words.strip()[:80]})"
    except OSError:
        pass
    return "another process"
