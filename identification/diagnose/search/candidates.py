"""What might be missing: every effect of the library that the data could show, in each of its forms."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from itertools import product

import numpy as np

from vpp_fmu.kernel.types import Effect
from vpp_fmu.record import Record

SIZES = (0.25, 0.5, 1.0, 2.0, 4.0)
"""Multiples of an effect's plausible size that a search looks at first."""

SHAPES = (0.3, 1.0, 3.0)
"""Multiples of what is not a size: time constants, frequencies."""

TOPS = (0.85, 0.9, 0.95, 1.0, 1.05, 1.1)
"""Multiples of the highest speed commanded for what limits speed: above it, a limit that gives way binds in one corner only."""


DECADE, CYCLES = 12, 2.0
"""Frequencies a decade to look at, from that which a record has so many cycles of up to half its rows' rate."""


@dataclass(frozen=True, eq=False)
class Candidate:
    """An effect in one form. `form`: values of its `choices` parameters; `free`: names of the others. All full names.

    `levels`: of free parameters that go by what was commanded or measured (a top speed, a nominal voltage), values to try.
    """

    effect: Effect
    form: Mapping[str, float]
    free: tuple[str, ...]
    levels: Mapping[str, tuple[float, ...]] = field(default_factory=dict)

    @property
    def name(self) -> str:
        """The effect's name."""
        return self.effect.name

    @property
    def label(self) -> str:
        """Name, and the form's numbers where there is more than one."""
        return self.name + "".join(f" ({value:g})" for value in self.form.values())

    @property
    def sizes(self) -> tuple[str, ...]:
        """Free parameters that switch the effect off, full names."""
        own = {self.effect.full(n) for n in self.effect.off}
        return tuple(n for n in self.free if n in own)

    @property
    def off(self) -> dict[str, float]:
        """Sizes at which the effect is not there, by full name."""
        return {self.effect.full(n): v for n, v in self.effect.off.items()}

    @property
    def probe(self) -> dict[str, float]:
        """Plausible sizes, by full name."""
        plausible = {self.effect.full(n): v for n, v in self.effect.probe.items()}
        return {n: plausible.get(n, self.off[n]) for n in self.sizes}

    def within(self, values: Mapping[str, float]) -> dict[str, float]:
        """Values of free parameters, by full name, held within their bounds."""
        bounds = {self.effect.full(p.name): (p.minimum, p.maximum) for p in self.effect.parameters}
        return {n: min(max(v, bounds[n][0]), bounds[n][1]) for n, v in values.items()}

    def shapes(self) -> list[dict[str, float]]:
        """Points to look at first of what is no size: time constants, frequencies, all of them combined."""
        axes = [[(n, v) for v in self.axis(n)] for n in self.free if n not in self.sizes]
        return [dict(point) for point in product(*axes)]

    def axis(self, name: str) -> list[float]:
        """Values of a free parameter to look at first, around the probe; a size's of both signs where both are allowed.

        What is no size may also have no part in it, where that is a form of its own.
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
        """Values of a size all over its range, for a search that must meet the right one; levels that are as many are such."""
        if len(self.levels.get(name, ())) >= count:
            return list(self.levels[name])
        p = next(p for p in self.effect.parameters if self.effect.full(p.name) == name)
        highest = max(self.levels.get(name, (p.maximum,)))
        return np.geomspace(max(p.minimum, highest / 100.0), highest, count).tolist()


def candidates(library: Iterable[Effect], records: Iterable[Record]) -> list[Candidate]:
    """Candidates for records; left out are effects that need a measured input which a record lacks, and those that round a
    command which never changes."""
    records, found = tuple(records), []
    for effect in library:
        if effect.off is None or any(u.name not in r for u in effect.inputs if not u.clock for r in records):
            continue
        if any(all(np.ptp(r[command]) == 0.0 for r in records) for command in effect.rounds):
            continue
        choices = [(effect.full(p.name), p.choices) for p in effect.parameters if p.choices]
        free = tuple(effect.full(p.name) for p in effect.parameters if not p.choices)
        for values in product(*(options for _, options in choices)):
            form = dict(zip((name for name, _ in choices), values, strict=True))
            found.append(Candidate(effect, form, free, _levels(effect, records)))
    return found


def _levels(effect: Effect, records: tuple[Record, ...]) -> dict[str, tuple[float, ...]]:
    """Values to look at first of what goes by the records: about the top speed commanded for what limits speed; every frequency
    that they could show; for what stands for a level of a measured input the least, middle and greatest that it had."""
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
