"""Compare two records."""

from dataclasses import dataclass

import numpy as np

from vpp_fmu.errors import BadInput
from vpp_fmu.record import Record


@dataclass(frozen=True)
class Comparison:
    """Common part of two records: times (n,) s of the first that are within both, and the values of each by column."""

    time: np.ndarray
    first: dict[str, np.ndarray]
    second: dict[str, np.ndarray]

    def summary(self) -> dict:
        """For each shared column the root mean square, the mean and the largest difference (second less first)."""
        figures = {}
        for name, a in self.first.items():
            d = (self.second[name] - a)[np.isfinite(a) & np.isfinite(self.second[name])]
            if len(d):
                worst = int(np.argmax(np.abs(d)))
                figures[name] = {"rms": float(np.sqrt(np.mean(d**2))), "mean": float(d.mean()), "largest": float(d[worst])}
        seconds = float(self.time[-1] - self.time[0])
        return {"format": "vpp-comparison/1", "rows": len(self.time), "seconds": seconds, "columns": figures}


def compare(first: Record, second: Record) -> Comparison:
    """Resample `second` at the times of `first` within both.

    Commands are held between rows, measurements are interpolated linearly. BadInput: no time or column in common.
    """
    inside = (first.time >= second.time[0] - 1e-9) & (first.time <= second.time[-1] + 1e-9)
    numbers = {n for n in first.columns if n in second and first[n].dtype.kind == second[n].dtype.kind == "f"}
    names = [n for n in first.columns if n in numbers and n != "time"]
    if inside.sum() < 2 or not names:
        found = "no two times in common" if names else f"columns {', '.join(second.columns)}"
        raise BadInput(second.source, "records", found, f"times and columns that {first.source} has too")
    time = first.time[inside]
    held = np.clip(np.searchsorted(second.time, time + 1e-9, side="right") - 1, 0, None)
    brought = {}
    for name in names:
        is_command = name.endswith("_ref") or name.endswith("_set")
        brought[name] = second[name][held] if is_command else np.interp(time, second.time, second[name])
    return Comparison(time, {n: first[n][inside] for n in names}, brought)
