"""Synthetic rigs with hidden effects of power, with their own equations, for the tests of the diagnosis of power.

Each rig has lags of speed and pitch, torque, a motor with a winding that heats, a servo and a supply. Its map and motor are
fitted from steady points; the lags that the diagnosis gets are wrong by up to 1 %. Noise is white, on half of
the rigs also slow.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from builders import paper_map
from scipy.linalg import expm
from scipy.signal import lfilter

from identification.power.diagnose import PowerDiagnosis, diagnose_power
from identification.power.fit import fit_power, steady_readings
from vpp_fmu.campaign import StaticMap
from vpp_fmu.kernel.plant import BASE
from vpp_fmu.kernel.power import RAD_PER_S
from vpp_fmu.parameters import ParameterSet
from vpp_fmu.record import Record

BLOCK = 0.5 / 30.0
LAGS = {"tau_omega_1": 0.12, "tau_omega_2": 0.05, "tau_beta_1": 0.1, "tau_beta_2": 0.06}


@dataclass(frozen=True)
class PowerRig:
    """The rig of one seed."""

    seed: int
    kind: str

    @cached_property
    def drawn(self) -> dict:
        rng = np.random.default_rng([self.seed, 77])
        return {
            "map": rng.uniform([0.05, 0.05, 0.1], [0.15, 0.15, 0.4]),  # N.m: w^2, w^2 b, w^2 b^2
            "constant": rng.uniform(0.012, 0.022),  # N.m/A
            "resistance": rng.uniform(0.03, 0.12),
            "friction": rng.uniform(0.005, 0.02),
            "idle": rng.uniform(1.0, 6.0),
            "inertia": rng.uniform(1e-5, 1.5e-4),
            "seconds": rng.uniform(60.0, 150.0),
            "rate": float(rng.choice([60, 125, 250])),
            "noise": float(np.exp(rng.uniform(np.log(0.003), np.log(0.03)))),
            "slow": bool(rng.random() < 0.5),
            "volts": rng.uniform(12.0, 50.0),
            "strength": float(np.exp(rng.uniform(np.log(0.1), 0.0))),
            "time_constant": float(np.exp(rng.uniform(np.log(5.0), np.log(60.0)))),
            "columns": "volts" if self.kind == "supply_sag" or rng.random() < 0.4 else "power",
            "torque": bool(rng.random() < 0.7),
            "scatter": rng.uniform(-0.01, 0.01, 4),
        }

    def commands(self, rng):
        """(time, speed [rpm], pitch [deg]): independent holds."""
        d = self.drawn
        time = np.round(np.arange(0.0, d["seconds"], 1.0 / d["rate"]), 9)
        found = []
        for low, high in ((2400.0, 6000.0), (-3.0, 9.0)):
            at = np.cumsum(rng.uniform(0.4, 2.5, 500))
            found.append(rng.uniform(low, high, 501)[np.searchsorted(at, time, side="right")])
        return time, *found

    def torque(self, w, b):
        """Aerodynamic torque [N.m] at normalised speed and pitch."""
        c = self.drawn["map"]
        return c[0] * w**2 + c[1] * w**2 * b + c[2] * w**2 * b**2

    def electrical(self, time, omega, beta, faster, rate, thrust, hidden):
        """Power [W] of motor, ESC and servo."""
        d, w, b = self.drawn, omega / 6000.0, (beta + 5.0) / 15.0
        driven = self.torque(w, b) + d["friction"] + d["inertia"] * faster * RAD_PER_S
        current = driven / d["constant"]
        winding = np.full(len(time), d["resistance"])
        if hidden == "resistance_heating" and len(time) > 1:
            rise, step, share = 0.0, time[1], self.rise
            for k, heat in enumerate(d["resistance"] * current**2):
                winding[k] = d["resistance"] * (1.0 + rise)
                rise += step / d["time_constant"] * (share * heat * (1.0 + rise) - rise)
        power = winding * current**2 + driven * omega * RAD_PER_S + d["idle"]
        if hidden == "servo_load rate":
            power = power + self.size * np.abs(rate)
        if hidden == "servo_load rate and thrust":
            power = power + self.size * np.abs(rate * thrust)
        return power * (1.0 + self.size * time) if hidden == "power_drift" else power

    @property
    def rise(self) -> float:
        """Share of the resistance per W of heat: 16 to 50 % at a usual load."""
        d, (w, b) = self.drawn, (0.8, 0.7)
        driven = w**2 * float(d["map"] @ [1.0, b, b**2]) + d["friction"]
        return 0.5 * np.sqrt(d["strength"]) / (d["resistance"] * (driven / d["constant"]) ** 2)

    @property
    def size(self) -> float:
        """Size of the hidden effect of servo, supply or drift."""
        d = self.drawn
        scales = {"servo_load rate": 0.3, "servo_load rate and thrust": 0.05, "supply_sag": 0.1, "power_drift": 5e-4}
        return scales.get(self.kind, 0.0) * d["strength"]

    def record(self, rng):
        """The record of the rig's logger."""
        d = self.drawn
        time, omega_ref, beta_ref = self.commands(rng)
        tau = list(LAGS.values())
        omega, faster = two_lags(omega_ref, *tau[:2], time[1])
        beta, rate = two_lags(beta_ref, *tau[2:], time[1])
        thrust = paper_map(omega, beta)
        power = self.electrical(time, omega, beta, faster, rate, thrust, self.kind)
        mean, n = float(power.mean()), len(time)
        noise = d["noise"] * mean * rng.standard_normal(n)
        if d["slow"]:
            kept = np.exp(-time[1] / 0.3)
            noise += lfilter([np.sqrt(1.0 - kept**2) * 0.5 * d["noise"] * mean], [1.0, -kept], rng.standard_normal(n))
        power = power + noise
        columns = {"time": time, "omega_ref": omega_ref, "beta_ref": beta_ref, "thrust": thrust + 0.1 * rng.standard_normal(n)}
        inner = self.size if self.kind == "supply_sag" else 0.0
        half = 0.5 * d["volts"]
        volts = half + np.sqrt(half**2 - inner * power)  # V = E - R I, P = V I
        read = rng.standard_normal((2, n)) * [[0.002 * d["volts"]], [0.01 * mean / d["volts"]]]
        supply = {"voltage": volts + read[0], "current": power / volts + read[1]}
        return Record(columns | (supply if d["columns"] == "volts" else {"power": power}), "synthetic")

    @cached_property
    def points(self) -> StaticMap:
        """Steady points of a cold rig."""
        d, rng = self.drawn, np.random.default_rng([self.seed, 78])
        w, b = (x.ravel() for x in np.meshgrid(np.linspace(0.35, 1.0, 10), np.linspace(0.0, 1.0, 10)))
        omega, none = 6000.0 * w, np.zeros(len(w))
        beta = 15.0 * b - 5.0
        power = self.electrical(none, omega, beta, none, none, none, "")
        further = {"power": power * (1.0 + 0.005 * rng.standard_normal(len(w)))}
        if d["torque"]:
            further["torque"] = self.torque(w, b) * (1.0 + 0.005 * rng.standard_normal(len(w)))
        return StaticMap(omega, beta, omega, paper_map(omega, beta), none + 0.1, none + 100.0, "static.csv", further)

    @cached_property
    def parameters(self) -> ParameterSet:
        """The identified plant: lags wrong by up to 1 %, torque and motor from the steady points."""
        values = {n: t * (1.0 + s) for (n, t), s in zip(LAGS.items(), self.drawn["scatter"], strict=True)}
        base = ParameterSet(BASE).replaced(values)
        return fit_power(steady_readings(self.points, base.values)).added_to(base)

    def diagnosed(self) -> PowerDiagnosis:
        """The diagnosis, with a validation record of its own commands."""
        fitted, unseen = (self.record(np.random.default_rng([self.seed, k])) for k in (79, 80))
        return diagnose_power({"open_loop": fitted}, unseen, self.parameters, BLOCK)


def two_lags(command, slow, fast, step):
    """(output, its rate per s) of two first-order lags, from rest on the first command; exact for held commands."""
    states, rate = np.full(len(command), command[0]), np.zeros(len(command))
    a = np.array([[-1.0 / slow, 0.0], [1.0 / fast, -1.0 / fast]])
    fine = expm(a * step)
    x = np.array([command[0], command[0]])
    for k in range(len(command)):
        states[k], rate[k] = x[1], (x[0] - x[1]) / fast
        x = command[k] + fine @ (x - command[k])
    return states, rate


def truth(rig: PowerRig, found: PowerDiagnosis) -> dict:
    """True sizes by (effect, parameter)."""
    if rig.kind == "supply_sag":
        return {("supply_sag", "resistance"): rig.size}
    if rig.kind == "power_drift":
        return {("power_drift", "rate"): rig.size}
    if rig.kind.startswith("servo_load"):
        return {("servo_load", "load"): rig.size}
    d = rig.drawn
    time, omega_ref, beta_ref = rig.commands(np.random.default_rng([rig.seed, 79]))
    omega, beta = (two_lags(c, *t, time[1])[0] for c, t in ((omega_ref, (0.12, 0.05)), (beta_ref, (0.1, 0.06))))
    w, b = omega / 6000.0, (beta + 5.0) / 15.0
    driven = rig.torque(w, b) + d["friction"]
    loss = d["resistance"] * float(np.max(driven) / d["constant"]) ** 2
    return {("resistance_heating", "gain"): rig.rise * loss**2, ("resistance_heating", "time_constant"): d["time_constant"]}
