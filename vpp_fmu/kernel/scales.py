"""The scales of a rig's quantities, which convert an effect's relative declarations to absolute values.

A threshold of a tenth of the pitch's span means the same for a micro rotor and for one of two metres. A parameter that scales
with the rig names its scale, a product of the words speed, pitch, thrust and time such as "speed.time/pitch"; its default,
bounds and nominal are shares of that. Two words are used alone: a "position" of pitch counts from the pitch whose normalised
value is 0; an "offset" is added to a pitch before it is normalised.
"""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace

WORDS = {"speed": "omega_scale", "pitch": "beta_scale", "thrust": "thrust_scale", "time": "time_scale"}
"""Scale of each word."""


@dataclass(frozen=True)
class Scales:
    """Sizes of a rig. The paper's are the defaults.

    `omega_scale` [rpm], `beta_scale` [deg], `beta_offset` [deg] and `thrust_scale` [N] normalise the thrust map and are
    parameters of plant and controller; `time_scale` [s], about the duration of a step, is used in bounds and searches only.
    """

    omega_scale: float = 6000.0
    beta_scale: float = 15.0
    beta_offset: float = 5.0
    thrust_scale: float = 15.0
    time_scale: float = 0.5

    def absolute(self, share: float, scale: str) -> float:
        """A share of a declared scale in the quantity's unit; unchanged for "". KeyError names an unknown word."""
        if scale == "":
            return share
        if scale == "position":
            return share * self.beta_scale - self.beta_offset
        if scale == "offset":
            return share * self.beta_scale + self.beta_offset
        return share * self._factor(scale)

    def _factor(self, scale: str) -> float:
        factor = 1.0
        above, *below = scale.split("/")
        for power, product in ((1, above), *((-1, words) for words in below)):
            for word in product.split("."):
                size = 1.0 if word == "1" else getattr(self, WORDS[word])
                factor = factor * size if power > 0 else factor / size
        return factor

    def with_values(self, values: Mapping[str, float]) -> "Scales":
        """These scales, replaced by those among parameter `values`."""
        own = asdict(self)
        return replace(self, **{name: float(values[name]) for name in own if name in values})


PAPER = Scales()
"""The paper's rig: 6000 rpm, -5 to 10 deg, 15 N; a step of its pitch takes half a second."""
