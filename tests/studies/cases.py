"""Cases of the blind study: which rig hides what. Drawn from the case's own name and seed, so each can be run again alone."""

import zlib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from vpp_fmu.campaign import Campaign

from . import orders
from .detectable import LIMIT, evidence
from .missing import HIDDEN, LISTED, OUTSIDE, PAIRS, SCALABLE, SIZES
from .rig import Rig, campaign, random_base, random_vibration

KINDS = ("singles", "none", "deleted", "outside", "pairs", "faint")

FAINT = 20.0, 200.0
"""Evidence that faint cases are scaled to, log-uniform: from the limit of what can be seen."""


@dataclass(frozen=True)
class Case:
    """One rig. `hidden`: names of what it hides; `deleted`: the name that the library given to the diagnosis lacks.

    Kind "faint": a single effect whose size is scaled down to little evidence.
    """

    kind: str
    hidden: tuple[str, ...]
    seed: int
    deleted: str | None = None

    def build(self) -> tuple[Campaign, Rig, dict]:
        """(what was measured, the rig that it was measured on, the sizes of what it hides)."""
        rng, base, shaking, drawn = self._draw()
        sizes = {k: v for own in drawn.values() for k, v in own.items()}
        extra = sizes.pop("extra", None)
        if self.kind == "faint":
            sizes = self._faint(rng, base, sizes)
        rig = Rig(base | sizes, extra, shaking)
        return campaign(rig, rng), rig, sizes

    def _draw(self) -> tuple[np.random.Generator, dict, float, dict[str, dict]]:
        # A deleted case hides the same on the same rig as the single case of its name.
        rng = np.random.default_rng([self.seed, zlib.crc32(" ".join(self.hidden).encode())])
        base, shaking = random_base(rng), random_vibration(rng)
        return rng, base, shaking, {name: dict(HIDDEN[name].draw(rng)) for name in self.hidden}

    def _faint(self, rng: np.random.Generator, base: dict, sizes: dict) -> dict:
        wanted, commands, scaled = np.exp(rng.uniform(*np.log(FAINT))), orders.open_loop(rng), dict(sizes)
        for _ in range(4):
            there = evidence(Rig(base | scaled), base, *commands)
            factor = np.sqrt(wanted / max(there, 1.0))
            scaled = {k: v * factor if k in SIZES else v for k, v in scaled.items()}
        return scaled

    def truth(self, sizes: dict) -> dict[str, float]:
        """True values of the project's parameters by full name, where one corresponds."""
        return {f"{name}.{p}": v for name in self.hidden for p, v in HIDDEN[name].kernel(sizes).items()}

    def evidence(self, measured: Campaign, rig: Rig) -> float:
        """Log-likelihood that the open-loop records hold in favour of what is hidden, over the best base model.

        Of a pair, of its fainter effect, with the other one known.
        """
        _, base, _, drawn = self._draw()
        speed, pitch = measured.open_loop["omega_ref"], measured.open_loop["beta_ref"]
        known = [{k: v for other in drawn if other != name for k, v in drawn[other].items()} for name in drawn]
        return min((evidence(rig, base, speed, pitch, others) for others in known), default=0.0)

    def equals(self, measured: Campaign, rig: Rig) -> list[str]:
        """Names of special cases that these records can't tell from the single effect that is hidden."""
        _, base, _, drawn = self._draw()
        speed, pitch = measured.open_loop["omega_ref"], measured.open_loop["beta_ref"]
        if self.kind != "singles":
            return []
        ((name, own),) = drawn.items()
        special = {other: settings(own) for other, settings in HIDDEN[name].special.items()}
        return [other for other, known in special.items() if evidence(rig, base, speed, pitch, known) < LIMIT]


def cases(known: Iterable[str], seeds: Sequence[int], kinds: Sequence[str] = KINDS, only: Sequence[str] = ()) -> list[Case]:
    """All cases of some kinds. `known`: effects that the project's library has; `only`: names to keep, () for all."""
    known, found = set(known), []
    single = [h.name for h in LISTED if h.name in known]
    for seed in seeds:
        found += [Case("singles", (n,), seed) for n in single]
        found += [Case("none", (), 1000 * seed + k) for k in range(4)]
        found += [Case("deleted", (n,), seed, n) for n in single]
        found += [Case("outside", (h.name,), seed) for h in OUTSIDE]
        found += [Case("faint", (n,), seed) for n in single if n in SCALABLE]
        found += [Case("pairs", pair, seed) for pair in PAIRS if set(pair) <= known]
    kept = [c for c in found if c.kind in kinds]
    return [c for c in kept if not only or set(c.hidden) & set(only)]
