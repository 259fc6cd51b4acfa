"""What might be missing: every effect of the library that the data could show, in each of its forms."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from itertools import product

from vpp_fmu.kernel.types import Effect
from vpp_fmu.record import Record

SIZES = (0.25, 0.5, 1.0, 2.0, 4.0)
"""Multiples of an effect's plausible size that a search looks at first."""

SHAPES = (0.3, 1.0, 3.0)
"""Multiples of what is not a size: time constants, frequencies."""


@dataclass(frozen=True)
class Candidate:
    """An effect in one form. `form`: values of its `choices` parameters; `free`: names of the others. All full names."""

    effect: Effect
    form: Mapping[str, float]
    free: tuple[str, ...]

    @property
    def name(self) -> str:
        """The effect's name."""
        return self.effect.name

    @property
    def label(self) -> str:
        """Name, and the form's numbers where there is more than one."""
        return self.name + "".join(f" ({value:g})" for value in self.form.values())

    def grid(self) -> list[dict[str, float]]:
        """Values of the free parameters to look at first: sizes around the probe, of both signs where both are allowed."""
        axes = []
        for p in self.effect.parameters:
            if p.choices:
                continue
            probe = self.effect.probe.get(p.name)
            if probe is None:
                axes.append([p.default])
                continue
            signs = (1.0, -1.0) if p.minimum < 0.0 < p.maximum and p.name in self.effect.off else (1.0,)
            multiples = SIZES if p.name in self.effect.off else SHAPES
            values = [s * m * probe for s in signs for m in multiples]
            inside = [v for v in values if p.minimum < v < p.maximum]
            axes.append(inside or [probe])
        return [dict(zip(self.free, point, strict=True)) for point in product(*axes)]


def candidates(library: Iterable[Effect], records: Iterable[Record]) -> list[Candidate]:
    """Candidates for records; an effect that needs a measured input is left out where a record lacks it."""
    records, found = tuple(records), []
    for effect in library:
        if effect.off is None or any(u.name not in r for u in effect.inputs for r in records):
            continue
        choices = [(effect.full(p.name), p.choices) for p in effect.parameters if p.choices]
        free = tuple(effect.full(p.name) for p in effect.parameters if not p.choices)
        for values in product(*(options for _, options in choices)):
            form = dict(zip((name for name, _ in choices), values, strict=True))
            found.append(Candidate(effect, form, free))
    return found
