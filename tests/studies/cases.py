"""Cases of the blind study: which rig hides what. Drawn from the case's own name and seed, so each can be run again alone."""

import zlib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from tests.studies.detectable import evidence
from tests.studies.missing import HIDDEN, LISTED, OUTSIDE, PAIRS
from tests.studies.rig import Rig, campaign, random_base, random_vibration
from vpp_fmu.campaign import Campaign

KINDS = ("singles", "none", "deleted", "outside", "pairs")


@dataclass(frozen=True)
class Case:
    """One rig. `hidden`: names of what it hides; `deleted`: the name that the library given to the diagnosis lacks."""

    kind: str
    hidden: tuple[str, ...]
    seed: int
    deleted: str | None = None

    def build(self) -> tuple[Campaign, Rig, dict]:
        """(what was measured, the rig that it was measured on, the sizes of what it hides)."""
        # A deleted case hides the same on the same rig as the single case of its name.
        rng = np.random.default_rng([self.seed, zlib.crc32(" ".join(self.hidden).encode())])
        base, shaking, sizes, extra = random_base(rng), random_vibration(rng), {}, None
        for name in self.hidden:
            drawn = dict(HIDDEN[name].draw(rng))
            extra = drawn.pop("extra", extra)
            sizes |= drawn
        rig = Rig(base | sizes, extra, shaking)
        return campaign(rig, rng), rig, sizes

    def truth(self, sizes: dict) -> dict[str, float]:
        """True values of the project's parameters by full name, where one corresponds."""
        return {f"{name}.{p}": v for name in self.hidden for p, v in HIDDEN[name].kernel(sizes).items()}

    def evidence(self, measured: Campaign, rig: Rig) -> float:
        """Log-likelihood that the open-loop records hold in favour of what is hidden, over the best base model."""
        if not self.hidden:
            return 0.0
        base = {k: v for k, v in rig.settings.items() if k.startswith("tau") or (k[0] == "c" and k[1:].isdigit())}
        return evidence(rig, base, measured.open_loop["omega_ref"], measured.open_loop["beta_ref"])


def cases(known: Iterable[str], seeds: Sequence[int], kinds: Sequence[str] = KINDS, only: Sequence[str] = ()) -> list[Case]:
    """All cases of some kinds. `known`: effects that the project's library has; `only`: names to keep, () for all."""
    known, found = set(known), []
    single = [h.name for h in LISTED if h.name in known]
    for seed in seeds:
        found += [Case("singles", (n,), seed) for n in single]
        found += [Case("none", (), 1000 * seed + k) for k in range(4)]
        found += [Case("deleted", (n,), seed, n) for n in single]
        found += [Case("outside", (h.name,), seed) for h in OUTSIDE]
        found += [Case("pairs", pair, seed) for pair in PAIRS if set(pair) <= known]
    kept = [c for c in found if c.kind in kinds]
    return [c for c in kept if not only or set(c.hidden) & set(only)]
