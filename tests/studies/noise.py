"""Noise of a thrust reading, of several kinds, and its power by frequency."""

from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter

KINDS = ("white", "AR", "1/f + hum", "Student t", "spikes", "quantised")

SHARE = 0.0086
"""Standard deviation of a reading over the rig's thrust: 0.13 N of 15 N, as in the shared records."""

LSB = 2e-4
"""A count of the converter over the rig's thrust: half of 16 bits on a load cell for six times the thrust (0.003 N of 15 N)."""

SLOW, MEMORY = 0.37, 0.13
"""AR: standard deviation of the slow part over the whole's; its correlation time [s on the paper's rig], that of the air."""

CORNER = 2.0
"""1/f: corner frequency [Hz] of an amplifier, below which it exceeds white noise."""

HUM = {50.0: 0.5, 100.0: 0.15}
"""Mains hum: amplitude at each frequency [Hz] over the standard deviation of the other noise."""

FREEDOM = 3.0
"""Degrees of freedom of Student's t."""

SPIKES, SPIKE = 1e-3, (10.0, 50.0)
"""Share of the readings, and their size in standard deviations."""

COARSE, DITHER = 1.5, 0.5
"""Quantised: a count, and the white noise before it, in the other kinds' standard deviations."""


@dataclass(frozen=True)
class Noise:
    """Noise of one of KINDS, or "1/f" without hum. `std` N; readings `row` s apart; a rig `slow` times slower than the paper's;
    a converter's `count` N."""

    kind: str
    std: float
    row: float
    slow: float
    count: float

    @property
    def resolution(self) -> float:
        """Resolution of a reading [N]."""
        return COARSE * self.std if self.kind == "quantised" else self.count

    def reading(self, rng: np.random.Generator, force: np.ndarray) -> np.ndarray:
        """Reading (rows,) N of a force (rows,) N."""
        return self.resolution * np.round((force + self._draw(rng, len(force))) / self.resolution)

    def _draw(self, rng: np.random.Generator, rows: int) -> np.ndarray:
        white = self.std * rng.standard_normal(rows)
        if self.kind == "AR":
            drive = np.sqrt(1.0 - self._rho**2) * rng.standard_normal(rows + 500)
            return np.sqrt(1.0 - SLOW**2) * white + SLOW * self.std * lfilter([1.0], [1.0, -self._rho], drive)[500:]
        if self.kind == "1/f + hum":
            return white + self._flicker(rng, rows) + self._hum(rng, rows)
        if self.kind == "1/f":
            return white + self._flicker(rng, rows)
        if self.kind == "Student t":
            return self.std * rng.standard_t(FREEDOM, rows) / np.sqrt(FREEDOM / (FREEDOM - 2.0))
        if self.kind == "spikes":
            struck = rng.random(rows) < SPIKES
            return white + struck * rng.choice([-1.0, 1.0], rows) * rng.uniform(*SPIKE, rows) * self.std
        return DITHER * white if self.kind == "quantised" else white

    @property
    def _rho(self) -> float:
        return float(np.exp(-self.row / (MEMORY * self.slow)))

    def _flicker(self, rng: np.random.Generator, rows: int) -> np.ndarray:
        n = 2 * rows  # twice the length, so that the record's end is independent of its start
        frequency = np.fft.rfftfreq(n, self.row)
        frequency[0] = np.inf  # the tare removes a mean
        return np.fft.irfft(np.fft.rfft(self.std * rng.standard_normal(n)) * np.sqrt(CORNER / frequency), n)[:rows]

    def _hum(self, rng: np.random.Generator, rows: int) -> np.ndarray:
        net, time = 1.0 + rng.uniform(-1e-3, 1e-3), self.row * np.arange(rows)
        phases = rng.uniform(0.0, 2.0 * np.pi, len(HUM))
        waves = [a * np.sin(2.0 * np.pi * net * f * time + p) for (f, a), p in zip(HUM.items(), phases, strict=True)]
        return self.std * np.sum(waves, axis=0)

    def power(self, turns: np.ndarray) -> np.ndarray:
        """Power a row [N^2] at frequencies in cycles a row above 0; white noise of `std` has std^2 at each.

        Without lines and spikes, which can be removed from a record.
        """
        power = np.full(len(turns), self.std**2)
        if self.kind == "AR":
            slow = SLOW**2 * (1.0 - self._rho**2) / np.abs(1.0 - self._rho * np.exp(-2j * np.pi * turns)) ** 2
            power *= 1.0 - SLOW**2 + slow
        elif self.kind in ("1/f", "1/f + hum"):
            power *= 1.0 + CORNER * self.row / turns
        elif self.kind == "quantised":
            power *= DITHER**2
        return power + self.resolution**2 / 12.0
