"""Temporary folders: removed with their owner, with the process, or by the next process.

A crash or SIGKILL removes nothing. So an owner holds a lock on its folder, and whoever makes a new folder first removes those
beside it that are no longer locked.
"""

import contextlib
import os
import shutil
import tempfile
import weakref
from pathlib import Path

try:
    import fcntl
except ImportError:  # Windows: locks of other owners cannot be tested, so no other folder is removed
    fcntl = None

_OURS = "vpp-scratch-"
_open: set[Path] = set()


class Scratch:
    """A new folder at `path`, in the system's for temporary files or in `where`, there under a hidden name.

    `close` removes it, and so do the object's end and the interpreter's.
    """

    def __init__(self, where: Path | None = None):
        place, hidden = Path(where or tempfile.gettempdir()), "." if where else ""
        _sweep(place, f"{hidden}{_OURS}")
        fresh = Path(tempfile.mkdtemp(prefix=f"{hidden}vpp-new-", dir=place))
        lock = None
        with contextlib.suppress(OSError):  # on a file system without locks, a sweep fails too
            lock = _locked(fresh)
        self.path = fresh.with_name(fresh.name.replace("vpp-new-", _OURS))
        os.rename(fresh, self.path)  # only once it is locked, or a sweep would remove it
        _open.add(self.path)
        self.close = weakref.finalize(self, _remove, self.path, lock)
        """Remove the folder."""


def remove_scratch() -> None:
    """Remove all of this process's folders, even those in use: for an exit that runs no other code."""
    for path in tuple(_open):
        shutil.rmtree(path, ignore_errors=True)


def _remove(path: Path, lock: int | None) -> None:
    shutil.rmtree(path, ignore_errors=True)
    _open.discard(path)
    if lock is not None:
        os.close(lock)


def _locked(folder: Path) -> int | None:
    """A descriptor that locks the folder until it is closed. OSError if another process holds it, or it is no folder."""
    if fcntl is None:
        return None
    lock = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        os.close(lock)
        raise
    return lock


def _sweep(place: Path, prefix: str) -> None:
    """Remove folders of dead processes in `place`."""
    if fcntl is None:
        return
    for path in place.glob(f"{prefix}*"):
        with contextlib.suppress(OSError):  # it is in use, or someone else's, or just being removed
            lock = _locked(path)
            try:
                shutil.rmtree(path, ignore_errors=True)
            finally:
                os.close(lock)
