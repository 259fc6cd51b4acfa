"""Candidates: every effect of the library that the records could identify, in each of its forms."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from itertools import product

import numpy as np

from vpp_fmu.kernel.types import Effect
from vpp_fmu.record import Record

SIZES = (0.25, 0.5, 1.0, 2.0, 4.0)
"""Multiples of an effect's plausible size in the first grid of a search."""

SHAPES = (0.3, 1.0, 3.0)
"""Multiples of shape parameters, such as time constants and frequencies."""

TOPS = (0.85, 0.9, 0.95, 1.0, 1.05, 1.1)
"""Multiples of the highest commanded speed, for speed limits. A soft limit above it acts in one corner only."""

INSIDE = 0.1
"""Share of the commanded range of pitch by which a limit starts inside its end. A fit moves it inwards from there; from a
tighter limit, the lags and the map of the biased base lead it astray."""

DECADE, CYCLES = 12, 2.0
"""Grid frequencies per decade, and the cycles per record at the lowest. The highest is half the sampling rate."""


@dataclass(frozen=True, eq=False)
class Candidate:
    """An effect in one form. `form`: its `choices` parameters and those held at a limit; `free`: the others. All full names.

    `levels`: grid values of free parameters that depend on the records (a top speed, a nominal voltage). `plausible`: sizes
    that do (limits of the pitch).
    """

    effect: Effect
    form: Mapping[str, float]
    free: tuple[str, ...]
    levels: Mapping[str, tuple[float, ...]] = field(default_factory=dict)
    plausible: Mapping[str, float] = field(default_factory=dict)

    @property
    def name(self) -> str:
        """The effect's name."""
        return self.effect.name

    @property
    def label(self) -> str:
        """Name, and the form's numbers if there are several forms."""
        return self.name + "".join(f" ({value:g})" for value in self.form.values())

    @property
    def sizes(self) -> tuple[str, ...]:
        """Free parameters that switch the effect off, full names."""
        own = {self.effect.full(n) for n in self.effect.off}
        return tuple(n for n in self.free if n in own)

    @property
    def off(self) -> dict[str, float]:
        """Sizes that switch the effect off, by full name."""
        return {self.effect.full(n): v for n, v in self.effect.off.items()}

    @property
    def probe(self) -> dict[str, float]:
        """Plausible sizes, by full name."""
        plausible = {self.effect.full(n): v for n, v in self.effect.probe.items()} | self.plausible
        return {n: plausible.get(n, self.off[n]) for n in self.sizes}

    def within(self, values: Mapping[str, float]) -> dict[str, float]:
        """Values of free parameters, by full name, clipped to their bounds."""
        bounds = {self.effect.full(p.name): (p.minimum, p.maximum) for p in self.effect.parameters}
        return {n: min(max(v, bounds[n][0]), bounds[n][1]) for n, v in values.items()}

    def shapes(self) -> list[dict[str, float]]:
        """First grid of the shape parameters (time constants, frequencies), in all combinations."""
        axes = [[(n, v) for v in self.axis(n)] for n in self.free if n not in self.sizes]
        return [dict(point) for point in product(*axes)]

    def starts(self) -> list[dict[str, float]]:
        """Values that fits start from: the grid of shapes at the plausible sizes. A limit starts at each size of its grid:
        above the moves of the records it has no influence, and no slope leads to it."""
        limits = {self.effect.full(p.name) for p in self.effect.parameters if p.unlimited is not None and p.scale != "position"}
        axes = [[(n, v) for v in self.axis(n)] for n in self.sizes if n in limits]
        return [self.within({**self.probe, **dict(sizes)}) | shape for shape in self.shapes() for sizes in product(*axes)]

    def axis(self, name: str) -> list[float]:
        """First grid of a free parameter, around the probe. Sizes take both signs if both are allowed.

        A shape parameter may also take its limit, if the limit is a form by design.
        """
        p = next(p for p in self.effect.parameters if self.effect.full(p.name) == name)
        size = p.name in self.effect.off
        if name in self.levels:
            return list(self.levels[name])
        probe = self.effect.probe.get(p.name)
        if probe is None:
            return [p.default]
        signs = (1.0, -1.0) if p.minimum < 0.0 < p.maximum and size else (1.0,)
        inside = [v for s in signs for m in (SIZES if size else SHAPES) if p.minimum < (v := s * m * probe) < p.maximum]
        inside += [p.default] if p.limit_form and not size else []
        return inside or [probe]

    def fine_axis(self, name: str, count: int = 24) -> list[float]:
        """Grid over the whole range of a size, for a sharp optimum. The levels are returned if they are at least `count`."""
        if len(self.levels.get(name, ())) >= count:
            return list(self.levels[name])
        p = next(p for p in self.effect.parameters if self.effect.full(p.name) == name)
        highest = max(self.levels.get(name, (p.maximum,)))
        return np.geomspace(max(p.minimum, highest / 100.0), highest, count).tolist()


def candidates(library: Iterable[Effect], records: Iterable[Record]) -> list[Candidate]:
    """Candidates for records. Excluded are effects that need a measured input absent from a record, that round a constant
    command, and those of the pitch where it never moves.

    A shape parameter whose default is a limit form, such as a lag of 0 s, is free in one candidate and held there in another.
    """
    records, found = tuple(records), []

    def is_constant(command: str) -> bool:
        return all(np.ptp(r[command]) == 0.0 for r in records)

    for effect in library:
        if effect.off is None or any(u.name not in r for u in effect.inputs if not u.clock for r in records):
            continue
        if any(map(is_constant, effect.rounds)) or (effect.channels == ("beta",) and is_constant("beta_ref")):
            continue
        choices = [(effect.full(p.name), p.choices) for p in effect.parameters if p.choices]
        free = tuple(effect.full(p.name) for p in effect.parameters if not p.choices)
        shapes = [p for p in effect.parameters if p.limit_form and p.name not in effect.off]
        limits = {effect.full(p.name): p.default for p in shapes if p.default in (p.minimum, p.maximum)}
        levels, plausible, ways = _levels(effect, records), _plausible(effect, records), [{}, limits] if limits else [{}]
        for *values, held in product(*(options for _, options in choices), ways):
            form = dict(zip((name for name, _ in choices), values, strict=True)) | held
            found.append(Candidate(effect, form, tuple(n for n in free if n not in held), levels, plausible))
    return found


def _plausible(effect: Effect, records: tuple[Record, ...]) -> dict[str, float]:
    """Limits of the pitch by full name, INSIDE the range of its commands."""
    low, high = min(float(r["beta_ref"].min()) for r in records), max(float(r["beta_ref"].max()) for r in records)
    found = {}
    for p in (p for p in effect.parameters if p.scale == "position" and p.unlimited is not None):
        inside = low + (INSIDE if p.unlimited == p.minimum else 1.0 - INSIDE) * (high - low)
        found[effect.full(p.name)] = min(max(inside, p.minimum), p.maximum)
    return found


def _levels(effect: Effect, records: tuple[Record, ...]) -> dict[str, tuple[float, ...]]:
    """First grid of parameters that depend on the records, by full name.

    Speed limits: about the highest commanded speed. Frequencies: all that the records resolve. Levels of a measured input: its
    minimum, median and maximum."""
    top = max(float(np.nanmax(r["omega_ref"])) for r in records)
    limits = [p for p in effect.parameters if p.unit == "rpm" and effect.off.get(p.name) == p.maximum]
    found = {effect.full(p.name): tuple(v for k in TOPS if (v := k * top) > p.minimum) or (p.minimum,) for p in limits}
    lowest = min(CYCLES / float(r.time[-1] - r.time[0]) for r in records)
    fastest = max(0.5 / r.period for r in records)
    for p in (p for p in effect.parameters if p.unit == "Hz" and p.name in effect.off):
        ends = max(lowest, p.minimum), min(fastest, p.maximum)
        found[effect.full(p.name)] = tuple(np.geomspace(*ends, max(2, round(DECADE * np.log10(ends[1] / ends[0])))).tolist())
    for u in (u for u in effect.inputs if not u.clock):
        seen = np.concatenate([r[u.name] for r in records])
        levels = tuple(dict.fromkeys(np.nanquantile(seen, [0.0, 0.5, 1.0]).tolist()))
        found |= {effect.full(p.name): levels for p in effect.parameters if p.unit == u.unit and p.name not in effect.off}
    return found
