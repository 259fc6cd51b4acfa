"""What the emulated buses share: named numbers in a small file that several processes map, and the kernel's refusals."""

import mmap
import os
from collections.abc import Iterable
from pathlib import Path


class SharedNumbers:
    """One float64 per name: what one process sets, the others see at once. `create` makes the file, all zero; else it must
    exist, made with the same names.

    Each number is written and read whole (eight aligned bytes); several together are not.
    """

    def __init__(self, path: str | os.PathLike, names: Iterable[str], create: bool = False):
        self.path, self._index = Path(path), {name: i for i, name in enumerate(names)}
        size = 8 * len(self._index)
        if create:
            self.path.write_bytes(bytes(size))
        with open(self.path, "r+b") as file:
            self._memory = mmap.mmap(file.fileno(), size)
        self._numbers = memoryview(self._memory).cast("d")

    def __getitem__(self, name: str) -> float:
        return self._numbers[self._index[name]]

    def __setitem__(self, name: str, value: float) -> None:
        self._numbers[self._index[name]] = value

    def take(self, name: str) -> bool:
        """Take one from a count of events to come (math.inf: without end); False if there is none."""
        left = self[name]
        if left < 1.0:
            return False
        self[name] = left - 1.0
        return True

    def close(self) -> None:
        """Close the file, which is kept."""
        self._numbers.release()
        self._memory.close()


def refusal(code: int) -> OSError:
    """What the kernel raises, by its number."""
    return OSError(code, os.strerror(code))
