"""How much of an error could be explained at all, and how much of that is.

What two records of the same commands share beyond the model is the model's error, whatever the noise is: the mean product
of their residuals needs no noise level. It is taken from means over BAND seconds: above that band the rotor's own
vibration repeats too. On a record without a repeat the noise's power is taken off instead.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from identification.diagnose.evidence.noise import BAND, Blocks, Noise, blocks
from identification.diagnose.evidence.whitened import Experiment
from identification.diagnose.search.fits import Fit
from identification.fit.tachometer import Tachometer
from vpp_fmu.campaign import Campaign
from vpp_fmu.native import Simulator
from vpp_fmu.record import Record

NOTHING = 0.02
"""Share of the noise's power below which repeatable error is not worth a name."""

NOTHING_IN_SPEED = 0.1
"""The same for speed: how a tachometer holds and rounds repeats, and no model of it is exact."""

ATTRIBUTED = 0.9
"""Share of the explainable error that a named set must remove on unseen data; a surrogate removes a fifth to a half."""

DRIFT = 0.1
"""Share by which the noise may differ from rest to motion, where no repeat tells."""


@dataclass(frozen=True)
class Left:
    """Repeatable error of a fit below 10 Hz, as a share of the noise's power; of thrust, and of speed.

    `error`: standard error of the thrust's where nothing is left: neighbouring means share noise, three tell as much as one.
    """

    share: float
    error: float
    speed: float = 0.0

    @property
    def anything(self) -> bool:
        """Whether there is something to explain."""
        return self.share > max(NOTHING, 2.0 * self.error) or self.speed > NOTHING_IN_SPEED

    def gone(self, before: "Left") -> float:
        """Share of what was left before that is gone now, of thrust or of speed, whichever is more."""
        parts = [(self.share, before.share, NOTHING), (self.speed, before.speed, NOTHING_IN_SPEED)]
        return max((1.0 - now / then for now, then, least in parts if then > least), default=1.0)


@dataclass(frozen=True)
class Explained:
    """Share of the explainable thrust error on unseen data that a set removes, with the standard error that noise gives it."""

    share: float
    error: float


class Remainder:
    """What a fit leaves unexplained, on the fitted records and on unseen ones."""

    def __init__(self, campaign: Campaign, held: list[Experiment], noise: Noise):
        self._record, self._repeat, self._held, self._noise = campaign.open_loop, campaign.repeat, held, noise

    def left(self, fit: Fit) -> Left:
        """Of the fitted records. Without a repeat, what exceeds the noise estimate."""
        thrust, speed = _predicted(fit, self._record)
        scale, error = self._noise.floor**2, self._noise.slow * np.sqrt(3.0 * BAND / self._record.time[-1])
        if self._repeat is None:
            power = float(np.mean(slow_residual(self._record, thrust) ** 2)) - self._noise.slow
            return Left(power / scale, max(error, DRIFT * self._noise.slow) / scale)
        power = shared_power(self._record, self._repeat, thrust)
        turning = "omega" in self._record and "omega" in self._repeat
        return Left(power / scale, error / scale, shared_speed(self._record, self._repeat, speed) if turning else 0.0)

    def explained(self, base: Fit, final: Fit) -> Explained | None:
        """What `final` removes of the error of `base`; None where there is none to speak of.

        What the fitted records leave open counts where it does best of `Fit.places`.
        """
        slow, before = self._noise.slow, self._unseen(base)
        after = min((self._unseen(final, place) for place in final.places), key=lambda residual: np.mean(residual**2))
        explainable = float(np.mean(before**2)) - slow
        if explainable < 2 * NOTHING * self._noise.floor**2:
            return None
        removed = float(np.mean(before**2) - np.mean(after**2))
        # Mean squares of noise scatter, and products of noise with the model's error. Three means tell as much as one.
        one, level = 3.0 / len(before), 3.0 * BAND / self._record.time[-1]
        of_removed = 4.0 * np.mean((before - after) ** 2) * slow * one
        of_explainable = 2.0 * slow**2 * (one + level) + 4.0 * explainable * slow * one
        return Explained(removed / explainable, float(np.sqrt(of_removed + ATTRIBUTED**2 * of_explainable)) / explainable)

    def _unseen(self, fit: Fit, changes: Mapping[str, float] | None = None) -> np.ndarray:
        """Residual [N] on unseen records below 10 Hz, of a fit with `changes` to its values."""
        return np.concatenate([slow_residual(e.record, _predicted(fit, e.record, changes)[0]) for e in self._held])


def _predicted(fit: Fit, record, changes: Mapping[str, float] | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Thrust [N] and speed [rpm], each (rows,), of a fit with `changes` to its values."""
    values = {**fit.values, **(changes or {})}
    return tuple(Simulator(fit.evidence.model).simulate(values, record.columns, record.steps).T[:2])


def shared_power(first: Record, second: Record, predicted: np.ndarray) -> float:
    """Mean product [N^2] of two records' residuals below 10 Hz, `predicted` thrust (rows,) N."""
    at = blocks(first, BAND)
    return float(np.nanmean(predicted_less(at, predicted, first) * predicted_less(at, predicted, second)))


def shared_speed(first: Record, second: Record, predicted: np.ndarray) -> float:
    """Mean product of two records' speed residuals below 10 Hz, over the power of their noise.

    `predicted` speed (rows,) rpm. Residuals are in units of what the tachometer can tell; where both records show the same
    to the last digit, that is all the noise there is. 0 where they never show it at the same time.
    """
    edges = np.arange(0.0, first.time[-1] + BAND, BAND)
    means = []
    for record in (first, second):
        seen = Tachometer(record)
        residual = (seen.shows(predicted) - seen.measured) / seen.std
        block = np.digitize(record.time[seen.rows], edges) - 1
        count = np.bincount(block, minlength=len(edges))
        with np.errstate(invalid="ignore"):
            means.append(np.bincount(block, residual, len(edges)) / count)
    one, other = means
    if not np.isfinite(one * other).any():
        return 0.0  # nowhere did both show the speed
    noise = 0.5 * float(np.nanmean((one - other) ** 2)) * float(count[count > 0].mean())
    return float(np.nanmean(one * other)) / (noise or 1.0)


def predicted_less(at: Blocks, predicted: np.ndarray, record: Record) -> np.ndarray:
    """Block means (blocks,) N of predicted less measured thrust."""
    return at.mean(predicted - record["thrust"])


def slow_residual(record: Record, predicted: np.ndarray) -> np.ndarray:
    """Predicted less measured thrust [N] below 10 Hz, (blocks,); blocks without a reading left out."""
    residual = predicted_less(blocks(record, BAND), predicted, record)
    return residual[np.isfinite(residual)]
