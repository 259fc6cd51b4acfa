"""python -m tests.studies power [--rigs 100]: torque and motor of synthetic rigs, fitted from steady points.

Each rig has a torque map of three terms, and a motor with friction, copper loss and an ESC's idle power. A grid of ten speeds
and ten pitches is measured with white noise, 1 % of the mean torque and of the mean power. A table gives for each parameter the
rms error over the Cramer-Rao bound of both readings, with its standard error, and the share of 95 % intervals with the truth.
The terms of the map are chosen by the fit: rigs on which it adds or drops one are counted, and have no line in the table.
"""

from dataclasses import dataclass

import numpy as np

from identification.power.fit import PowerFit, fit_power, steady_readings
from vpp_fmu.campaign import StaticMap
from vpp_fmu.kernel.plant import BASE
from vpp_fmu.kernel.power import RAD_PER_S
from vpp_fmu.parameters import ParameterSet

TERMS = ("q20", "q21", "q22")
NAMES = (*(f"torque_map.{name}" for name in TERMS), "motor.friction", "motor.loss", "motor.idle")
SHARE = 0.01
NORMAL_95 = 1.959964

W, B = (x.ravel() for x in np.meshgrid(np.linspace(1.0 / 3.0, 1.0, 10), np.linspace(-1.0 / 3.0, 1.0, 10)))
"""Normalised speeds and pitches of the points."""

OMEGA = 6000.0 * W
COLUMNS = np.column_stack([W**2, W**2 * B, W**2 * B**2])


@dataclass(frozen=True)
class Draw:
    """One rig: true values as NAMES, the noise of torque [N.m] and power [W], and the fit of its readings."""

    truth: np.ndarray
    noise: tuple[float, float]
    fit: PowerFit

    @property
    def chosen(self) -> bool:
        """Whether the fit has the terms of the truth."""
        return self.fit.names == NAMES

    @property
    def errors(self) -> np.ndarray:
        """(6,): errors of the values."""
        return self.fit.values - self.truth

    @property
    def bound(self) -> np.ndarray:
        """(6,): standard deviations by the Cramer-Rao bound."""
        (torque_noise, power_noise), (friction, loss) = self.noise, self.truth[3:5]
        speed, driven = OMEGA * RAD_PER_S, COLUMNS @ self.truth[:3] + friction
        slope = (speed + 2.0 * loss * driven)[:, None]
        torque = np.hstack([COLUMNS, np.zeros((len(W), 3))]) / torque_noise
        power = np.hstack([slope * COLUMNS, slope, driven[:, None] ** 2, np.ones((len(W), 1))]) / power_noise
        return np.sqrt(np.diag(np.linalg.inv(torque.T @ torque + power.T @ power)))

    @property
    def covered(self) -> np.ndarray:
        """(6,): whether the 95 % interval has the truth."""
        return np.abs(self.errors) <= NORMAL_95 * np.sqrt(np.diag(self.fit.covariance))


def draw(seed: int) -> Draw:
    """A rig of a seed, measured and fitted."""
    rng = np.random.default_rng([seed, 45])
    c = rng.uniform([0.05, 0.05, 0.1], [0.15, 0.15, 0.4])
    truth = np.array([*c, rng.uniform(0.005, 0.02), rng.uniform(60.0, 300.0), rng.uniform(1.0, 6.0)])
    torque = COLUMNS @ c
    driven = torque + truth[3]
    power = driven * OMEGA * RAD_PER_S + truth[4] * driven**2 + truth[5]
    noise = SHARE * float(torque.mean()), SHARE * float(power.mean())
    read = {n: x + s * rng.standard_normal(len(x)) for n, x, s in zip(("torque", "power"), (torque, power), noise, strict=True)}
    zeros = np.zeros(len(W))
    points = StaticMap(OMEGA, 15.0 * B - 5.0, OMEGA, zeros, 0.1 + zeros, 100.0 + zeros, "static.csv", read)
    return Draw(truth, noise, fit_power(steady_readings(points, ParameterSet(BASE).values)))


def main(parser, arguments):
    parser.add_argument("--rigs", type=int, default=100, metavar="N")
    parser.add_argument("--first-seed", type=int, default=0, metavar="N")
    parsed = parser.parse_args(arguments)
    drawn = [draw(seed) for seed in range(parsed.first_seed, parsed.first_seed + parsed.rigs)]
    own = [d for d in drawn if d.chosen]
    ratios, covered = np.array([d.errors / d.bound for d in own]), np.array([d.covered for d in own])
    print(f"{len(own)} of {len(drawn)} rigs have the terms of the truth\n")
    print(f"{'parameter':18s} {'rms error / Cramer-Rao bound':>30s} {'95 % intervals with the truth':>31s}")
    for k, name in enumerate(NAMES):
        rms, share = float(np.sqrt(np.mean(ratios[:, k] ** 2))), float(covered[:, k].mean())
        spread = 100.0 * float(np.sqrt(share * (1.0 - share) / len(own)))
        error = f"{rms:.2f} ± {rms / np.sqrt(2.0 * len(own)):.2f}"
        print(f"{name:18s} {error:>30s} {f'{100.0 * share:.0f} ± {spread:.0f} %':>31s}")
