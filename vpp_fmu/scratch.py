"""Folders for what a process needs for a while: they go with their owner, with the process, or with the next one.

A crash or SIGKILL leaves nobody to remove anything. So an owner holds a lock on its folder while it lives, and whoever makes
a new one first removes those beside it that nobody holds any more.
"""

import contextlib
import os
import shutil
import tempfile
import weakref
from pathlib import Path

try:
    import fcntl
except ImportError:  # Windows: nobody can tell there whether an owner lives, so nothing of others is removed
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
        with contextlib.suppress(OSError):  # where a file system knows no locks, a sweep gets none either
            lock = _locked(fresh)
        self.path = fresh.with_name(fresh.name.replace("vpp-new-", _OURS))
        os.rename(fresh, self.path)  # not before it is locked: a sweep would take it for left behind
        _open.add(self.path)
        self.close = weakref.finalize(self, _remove, self.path, lock)
        """Remove the folder."""


def remove_scratch() -> None:
    """Remove all of this process's folders, whoever still uses them: for an end that runs no other code."""
    for path in tuple(_open):
        shutil.rmtree(path, ignore_errors=True)


def _remove(path: Path, lock: int | None) -> None:
    shutil.rmtree(path, ignore_errors=True)
    _open.discard(path)
    if lock is not None:
        os.close(lock)


def _locked(folder: Path) -> int | None:
    """A descriptor that holds the folder until it is closed. OSError where someone else does, or where it isn't a folder."""
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
    """Remove what processes that have died left in `place`."""
    if fcntl is None:
        return
    for path in place.glob(f"{prefix}*"):
        with contextlib.suppress(OSError):  # it is in use, or someone else's, or just being removed
            lock = _locked(path)
            try:
                shutil.rmtree(path, ignore_errors=True)
            finally:
                os.close(lock)
