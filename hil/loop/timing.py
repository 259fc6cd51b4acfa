"""Timing of a loop: the histogram of lateness and its percentiles."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from vpp_fmu.record import Record

EDGES = (0.0, *(round(m * 10.0**e, 9) for e in range(-6, 0) for m in (1.0, 2.0, 5.0)), np.inf)
"""Edges of the bins [s]: 1, 2, 5 microseconds and so on."""

PERCENTILES = (50.0, 99.0, 99.9, 100.0)


@dataclass(frozen=True)
class Timing:
    """`ticks` in all, `missed` slots between them; lateness `late` and work `busy` at PERCENTILES [s]; `counts` of lateness
    in the bins of EDGES."""

    ticks: int
    missed: int
    late: tuple[float, ...]
    busy: tuple[float, ...]
    counts: tuple[int, ...]

    def summary(self) -> dict:
        """For `hil.json`, in microseconds."""
        names = [f"p{p:g}" if p < 100.0 else "max" for p in PERCENTILES]

        def summary(values: Sequence[float]) -> dict:
            return {name: round(1e6 * value, 1) for name, value in zip(names, values, strict=True)}

        bins = [
            {"from": round(1e6 * low, 3), "to": round(1e6 * high, 3) if np.isfinite(high) else None, "ticks": count}
            for low, high, count in zip(EDGES, EDGES[1:], self.counts, strict=False)
            if count
        ]
        return {
            "ticks": self.ticks,
            "missed": self.missed,
            "late_us": summary(self.late),
            "busy_us": summary(self.busy),
            "histogram_us": bins,
        }

    def text(self) -> str:
        """The histogram as lines of text, and the percentiles below it."""
        most, lines = max(self.counts, default=1), []
        for low, high, count in zip(EDGES, EDGES[1:], self.counts, strict=False):
            if count:
                bar = "#" * max(1, round(50 * count / most))
                lines.append(f"  {_span(low)} to {_span(high)} {count:8} {bar}")
        p50, p99, p999, worst = (1e6 * late for late in self.late)
        lines.append(f"  late: median {p50:.0f} us, p99 {p99:.0f} us, p99.9 {p999:.0f} us, at most {worst:.0f} us")
        lines.append(f"  work in a tick: median {1e6 * self.busy[0]:.0f} us, p99.9 {1e6 * self.busy[2]:.0f} us")
        lines.append(f"  ticks {self.ticks}, slots missed {self.missed}")
        return "\n".join(lines)


def timing(log: Record) -> Timing:
    """The timing from a log with the columns `late` and `busy` [s] and `missed` slots."""
    counts, _ = np.histogram(log["late"], EDGES)
    percentiles = [tuple(float(v) for v in np.percentile(log[name], PERCENTILES)) for name in ("late", "busy")]
    return Timing(len(log), int(log["missed"].sum()), *percentiles, tuple(int(n) for n in counts))


def _span(seconds: float) -> str:
    if not np.isfinite(seconds):
        return "   more"
    return f"{1e6 * seconds:4.0f} us" if seconds < 1e-3 else f"{1e3 * seconds:4.0f} ms"
