"""The load cell's zero, measured before every run, and refused if it is implausible."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from vpp_fmu.errors import VppError
from vpp_fmu.kernel.scales import PAPER
from vpp_fmu.rig import Rig

BLOCKS = 10
"""The standard error is taken from the means of this many blocks: an amplifier's noise is coloured."""

SURE = 4.0
"""Standard errors by which a drift must exceed its limit; with so few blocks three are not enough."""


class TareRefused(VppError):
    """The readings are not accepted as a zero: the message says why, with the numbers in N."""


@dataclass(frozen=True)
class TareGate:
    """Conditions under which readings are accepted as a zero.

    `noise_max` [N]: largest standard deviation; a turning rotor, a hand or wind exceed it. `drift_max` [N]: largest difference
    of the halves' means, beyond its own error; a slowing rotor or a warming cell exceeds it. `offset_max` [N]: largest
    distance from the calibration's zero; a load on the cell or a loose connection exceeds it. `samples_min`: fewest readings.
    """

    noise_max: float = 0.3
    drift_max: float = 0.05
    offset_max: float = 5.0
    samples_min: int = 200


def gate_of(rig: Rig) -> TareGate:
    """The gate of a rig: forces in proportion to its thrust, as a load cell's range, noise and drift are."""
    force, own = rig.scales.thrust_scale / PAPER.thrust_scale, TareGate()
    return replace(own, noise_max=force * own.noise_max, drift_max=force * own.drift_max, offset_max=force * own.offset_max)


@dataclass(frozen=True)
class Tare:
    """The zero: mean of `samples` readings, their standard deviation `noise` and the mean's standard error, all in counts."""

    zero: float
    noise: float
    error: float
    samples: int


def tare(counts: Sequence[float], newton_per_count: float, calibrated_zero: float, gate: TareGate | None = None) -> Tare:
    """The zero of `counts` (n,), readings of the unloaded cell with the rotor at rest.

    `newton_per_count` and `calibrated_zero` [counts] come from the calibration. TareRefused names the violated condition.
    """
    gate, counts = gate or TareGate(), np.asarray(counts, float)
    if len(counts) < gate.samples_min:
        raise TareRefused(f"tare: readings: found {len(counts)}, expected {gate.samples_min} or more")
    if not np.isfinite(counts).all():
        raise TareRefused("tare: readings: found one that is not finite, expected finite numbers")
    scale = abs(newton_per_count)
    noise, zero = float(counts.std(ddof=1)), float(counts.mean())
    if noise == 0.0:
        raise TareRefused(f"tare: readings: found {counts[0]:g} counts {len(counts)} times, expected noise: the ADC is frozen")
    if noise * scale > gate.noise_max:
        raise TareRefused(
            f"tare: scatter: found {noise * scale:.3g} N, expected at most {gate.noise_max:g} N. "
            "Try: let the rotor come to rest, keep wind and hands off the stand"
        )
    means = counts[: len(counts) // BLOCKS * BLOCKS].reshape(BLOCKS, -1).mean(axis=1)
    error = float(means.std(ddof=1)) / BLOCKS**0.5
    # Differences of neighbouring blocks give the noise of a block's mean even if the zero drifts.
    still = float(np.mean(np.diff(means) ** 2) / 2.0 * (4.0 / BLOCKS)) ** 0.5
    drift = abs(float(means[BLOCKS // 2 :].mean() - means[: BLOCKS // 2].mean()))
    if drift * scale > gate.drift_max + SURE * still * scale:
        raise TareRefused(
            f"tare: drift: found {drift * scale:.3g} N from first to second half, expected at most {gate.drift_max:g} N. "
            "Try: wait until the rotor is at rest and the amplifier is warm"
        )
    offset = abs(zero - calibrated_zero) * scale
    if offset > gate.offset_max:
        raise TareRefused(
            f"tare: zero: found {offset:.3g} N from the calibration's, expected at most {gate.offset_max:g} N. "
            "Try: take off what hangs on the load cell"
        )
    return Tare(zero, noise, error, len(counts))
