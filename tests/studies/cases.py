"""Cases of the blind studies: a rig, its hidden effects, and the records measured on it.

Each is drawn from its own name and seed, so it can be run again alone.
"""

import zlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cached_property

import numpy as np

from vpp_fmu.campaign import Campaign
from vpp_fmu.kernel.plant import LIBRARY
from vpp_fmu.record import Record

from . import command_sequences
from .detectable import LIMIT, behind, evidence
from .hidden_effects import HIDDEN, LISTED, OUTSIDE, PAIRS, Draw
from .noise import KINDS as NOISES
from .physics import BASE, in_time
from .rig import SIZES, Files, Rig, campaign, random_base, random_vibration

KINDS = ("none", "single", "pair", "outside", "deleted")

RATES = (100, 250, 500, 1000)
"""Hz."""

SECONDS = (15.0, 120.0)
"""Range of the open-loop record's length, log-uniform."""

LEVELS = (0.5, 2.0)
"""Range of the noise level, log-uniform."""

REFERENCE = 3.0 / 4.0
"""Share of the campaigns that have a static map, and of those that have steps."""

WEAKEST = {"single": 0.0}
"""Lowest strength that is drawn for this kind of case; HALF for others."""

HALF = 0.5

UNSEEN = 45.0
"""s of the hold-out record, on the paper's rig."""

WHOLE = {"repeat": True, "validation": True, "static": True, "steps": True}
"""Factors of a campaign that has every file."""


@dataclass(frozen=True)
class Factors:
    """Factors of a campaign. `strength` of the hidden effects, from 0 (the smallest size) to 1; `level`: noise over that of the
    shared records; `locked`: whether records start on the rotor's mark; `seconds` and files as in `rig.Files`."""

    size: str
    rate: int
    noise: str
    level: float
    seconds: float
    repeat: bool
    validation: bool
    static: bool
    steps: bool
    locked: bool
    strength: float

    @property
    def files(self) -> Files:
        """Files of the campaign."""
        return Files(self.seconds, self.repeat, self.validation, self.static, self.steps)


@dataclass(frozen=True)
class Case:
    """One rig. `hidden`: names of its hidden effects; `deleted`: the effect that the diagnosis' library does not have; `given`:
    factors that are not drawn."""

    kind: str
    hidden: tuple[str, ...]
    seed: int
    deleted: str | None = None
    given: tuple[tuple[str, object], ...] = ()

    @property
    def name(self) -> str:
        """Name in files and tables; unique among the cases with the same `given` factors."""
        return f"{self.kind} {'+'.join(self.hidden) or '-'} #{self.seed}"

    def random(self, stream: int) -> np.random.Generator:
        """One of the case's random generators. A deleted case has the same rig as the single case of its effect and seed."""
        return np.random.default_rng([self.seed, zlib.crc32(" ".join(self.hidden).encode()), stream])

    @cached_property
    def factors(self) -> Factors:
        """All factors are drawn before the given ones replace theirs, so a given factor does not change the others."""
        rng = self.random(0)
        drawn = Factors(
            size=str(rng.choice(list(SIZES))),
            rate=int(rng.choice(RATES)),
            noise=str(rng.choice(NOISES)),
            level=float(np.exp(rng.uniform(*np.log(LEVELS)))),
            seconds=float(np.round(np.exp(rng.uniform(*np.log(SECONDS))))),
            repeat=bool(rng.random() < 0.5),
            validation=bool(rng.random() < 0.5),
            static=bool(rng.random() < REFERENCE),
            steps=bool(rng.random() < REFERENCE),
            locked=bool(rng.random() < 0.5),
            strength=float(rng.uniform(WEAKEST.get(self.kind, HALF), 1.0)),
        )
        return replace(drawn, **dict(self.given))

    @cached_property
    def rig(self) -> Rig:
        """The rig with its hidden effects."""
        f, rng = self.factors, self.random(1)
        size = SIZES[f.size].drawn(rng)
        base, shaking = random_base(rng, size.slow), random_vibration(rng)
        sizes = dict(self.sizes)
        extra = sizes.pop("extra", None)
        return Rig(base | sizes, size, float(f.rate), f.noise, f.level, extra, shaking, f.locked)

    @cached_property
    def each(self) -> dict[str, dict]:
        """Settings of each hidden effect, by its name. A second effect has its own strength."""
        rng, slow = self.random(2), SIZES[self.factors.size].drawn(self.random(1)).slow
        strengths = [self.factors.strength, *rng.uniform(WEAKEST.get(self.kind, HALF), 1.0, len(self.hidden))]
        if "strength" in dict(self.given):
            strengths = [self.factors.strength] * len(self.hidden)
        drawn = {n: dict(HIDDEN[n].draw(Draw(rng, s))) for n, s in zip(self.hidden, strengths, strict=False)}
        return {n: in_time(own, slow) for n, own in drawn.items()}

    @property
    def sizes(self) -> dict:
        """Settings of all hidden effects."""
        return {k: v for own in self.each.values() for k, v in own.items()}

    @property
    def base(self) -> dict[str, float]:
        """Settings of the rig without its hidden effects."""
        return {n: self.rig.settings[n] for n in BASE}

    def measured(self) -> Campaign:
        """The campaign that the diagnosis gets."""
        return campaign(self.rig, self.random(3), self.factors.files)

    def unseen(self) -> tuple[Record, np.ndarray]:
        """(hold-out record of other commands on this rig, its true thrust (rows,) N)."""
        rng = self.random(4)
        return self.rig.observed(rng, command_sequences.both(rng, self.rig.clock, UNSEEN * self.rig.size.slow), "unseen")

    def truth(self) -> dict[str, float]:
        """True values of the project's parameters by full name, where one corresponds."""
        return {f"{n}.{p}": v for n in self.hidden for p, v in HIDDEN[n].kernel(self.sizes, self.rig.size).items()}

    def evidence(self, record: Record) -> float:
        """Log-likelihood ratio of the hidden effects over the best base model, for records of these commands.

        For a pair, that of its weaker effect, with the other one known.
        """
        return min((self._over(record, known=self._others(name)) for name in self.each), default=0.0)

    def equals(self, record: Record) -> dict[str, list[str]]:
        """By hidden effect, the special cases that these records cannot distinguish from it; the other effects are known."""
        if self.kind not in ("single", "pair"):
            return {}
        found = {}
        for name, own in self.each.items():
            special = {other: settings(own) for other, settings in HIDDEN[name].special.items()}
            known = self._others(name)
            found[name] = [other for other, sizes in special.items() if self._over(record, known, sizes) < LIMIT]
        return found

    def behind(self, record: Record, thrust: np.ndarray, omega: np.ndarray) -> float:
        """Log-likelihood of the truth less that of a model that predicts this of the record and its repeat."""
        return behind(self.rig, record, thrust, omega, 1 + self.factors.repeat)

    def _others(self, name: str) -> dict:
        """Settings of all hidden effects but one."""
        return {k: v for other, own in self.each.items() if other != name for k, v in own.items()}

    def _over(self, record: Record, known: Mapping[str, float] | None = None, free: Mapping[str, float] | None = None) -> float:
        records = 1 + self.factors.repeat
        return evidence(self.rig, self.base, record["omega_ref"], record["beta_ref"], known, records, free)

    def summary(self) -> dict:
        """Entries of a table row."""
        sizes = {k: v for k, v in self.sizes.items() if k != "extra"}
        head = {"name": self.name, "kind": self.kind, "hidden": list(self.hidden), "seed": self.seed, "deleted": self.deleted}
        return head | {"given": dict(self.given), "factors": asdict(self.factors), "sizes": sizes}


def draw(seed: int, kind: str, known: Iterable[str] = (), hidden: Sequence[str] | None = None, **given) -> Case:
    """A case of one of KINDS; all that is not `given` is drawn from its seed.

    `hidden`: names; None: those of the kind in turn, so that consecutive seeds go through all of them. `known`: effects of the
    project's library; () for all of it. `given`: fields of `Factors`.
    """
    known = set(known) or {e.name for e in LIBRARY if e.off is not None}
    listed = [(h.name,) for h in LISTED if h.name in known]
    of = {
        "none": [()],
        "single": listed,
        "pair": [pair for pair in PAIRS if set(pair) <= known],
        "outside": [(h.name,) for h in OUTSIDE],
        "deleted": listed,
    }[kind]
    chosen = tuple(hidden) if hidden is not None else of[seed % len(of)]
    return Case(kind, chosen, seed, chosen[0] if kind == "deleted" else None, tuple(given.items()))
