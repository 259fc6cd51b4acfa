"""The models of docs/tutorial/models, with their inputs here and their outputs by formulas, expm or solve_ivp.

None of these solutions uses the kernel.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.integrate import solve_ivp
from scipy.interpolate import PchipInterpolator
from scipy.linalg import expm

from vpp_fmu.export.own_model import find_model
from vpp_fmu.kernel.types import Model

FOLDER = Path(__file__).parents[1] / "docs" / "tutorial" / "models"


@dataclass(frozen=True)
class Case:
    """A model file: inputs at the time t [s] by name, which change at whole seconds; outputs at the times (n,), by name.

    `bound`: allowed error, as a share of an output's largest value; 1e-10 for exact methods.
    """

    file: str
    inputs: Callable[[float], Mapping[str, float]]
    solution: Callable[[np.ndarray], Mapping[str, np.ndarray]]
    bound: float = 1e-10

    def model(self) -> Model:
        """Read from its file."""
        return find_model(f"{self.source}:MODEL")

    @property
    def source(self) -> Path:
        return FOLDER / f"{self.file}.py"

    @property
    def twin(self) -> Path:
        """The same model for pythonfmu."""
        return FOLDER / f"{self.file}_pythonfmu.py"


def integrated(f, start, times) -> np.ndarray:
    """States (n, states) of dx/dt = f(x) at the times."""
    found = solve_ivp(lambda t, x: f(x), (0.0, times[-1]), start, "DOP853", times, rtol=1e-12, atol=1e-13)
    return found.y.T


def linear(A, b, start, times) -> np.ndarray:
    """States (n, states) of dx/dt = A x + b at the times."""
    n = len(start)
    whole = np.zeros((n + 1, n + 1))
    whole[:n, :n], whole[:n, n] = A, b
    return np.array([(expm(whole * t) @ np.r_[start, 1.0])[:n] for t in times])


def van_der_pol(times):
    """solve_ivp, rtol 1e-12"""
    x, v = integrated(lambda y: (y[1], (1.0 - y[0] ** 2) * y[1] - y[0] + 0.5), (2.0, 0.0), times).T
    return {"x": x, "v": v}


def motor_pi(times):
    """matrix exponential"""
    R, L, K, J, b, kp, ki, wanted, load = 1.0, 0.01, 0.1, 0.001, 0.001, 0.5, 5.0, 50.0, 0.02
    A = [[-R / L, -(K + kp) / L, ki / L], [K / J, -b / J, 0.0], [0.0, -1.0, 0.0]]
    return {"w": linear(A, [kp * wanted / L, -load / J, wanted], (0.0, 0.0, 0.0), times)[:, 1]}


def network(times, n=10):
    """matrix exponential"""
    A = 0.2 * (np.eye(n, k=1) + np.eye(n, k=-1) - 2.0 * np.eye(n))
    T = linear(A, 0.2 * np.r_[90.0, np.zeros(n - 2), 10.0], np.full(n, 20.0), times)
    return {f"T[{k + 1}]": T[:, k] for k in range(n)}


def battery(times, i=5.0):
    """closed form, with scipy's PchipInterpolator"""
    charge = 0.9 - i * times / (3600.0 * 2.5)
    ocv = PchipInterpolator((0.0, 0.05, 0.1, 0.3, 0.6, 0.9, 1.0), (3.0, 3.35, 3.5, 3.65, 3.8, 4.05, 4.2))
    return {"charge": charge, "voltage": ocv(charge) - 0.02 * i - 0.02 * i * (1.0 - np.exp(-times / 20.0))}


def ball(times, g=9.81, e=0.8, h=1.0):
    """closed form

    Impact n at sqrt(2 h / g) (1 + 2 e + 2 e^2 + ... 2 e^n); then it rises at e^(n + 1) sqrt(2 g h).
    """
    first, speed = np.sqrt(2.0 * h / g), np.sqrt(2.0 * g * h)
    impacts = first * (1.0 + 2.0 * np.r_[0.0, np.cumsum(e ** np.arange(1.0, 40.0))])
    n = np.searchsorted(impacts, times, side="right")
    since = times - np.r_[0.0, impacts][n]
    up = np.where(n > 0, e**n * speed, 0.0)
    return {"h": np.where(n > 0, 0.0, h) + up * since - 0.5 * g * since**2, "v": up - g * since, "bounces": n.astype(float)}


def delayed(times):
    """sample by sample

    The reading steps to 10 K at 1 s and is seen 0.12 s later.
    """
    total, u, T, at, shown = 0.0, 0.0, 0.0, 0.0, []
    events = sorted({round(t, 9) for t in (*times, *np.arange(0.0, times[-1] + 0.05, 0.05))})
    asked = {round(t, 9) for t in times}
    for t in events:
        T = 80.0 * u + (T - 80.0 * u) * np.exp(-(t - at) / 2.0)
        at = t
        if t in asked:
            shown.append((u, T))
        if abs(t / 0.05 - round(t / 0.05)) < 1e-6:
            e = 30.0 - (10.0 if t >= 1.12 - 1e-9 else 0.0)
            total += 0.1 * 0.05 * e
            u = min(max(0.05 * e + total, 0.0), 1.0)
    u, T = np.array(shown).T
    return {"u": u, "T": T}


def vehicle(times, tau=0.1, m=4.0, drag=0.8):
    """closed form

    Each force is F (1 - exp(-t / tau)); the sum of them moves the body.
    """
    F = 3.0 + 4.0 + 5.0 + 6.0
    rate = drag / m
    lag = (np.exp(-times / tau) - np.exp(-rate * times)) / (rate - 1.0 / tau)
    v = F / m * ((1.0 - np.exp(-rate * times)) / rate - lag)
    return {"v": v, "front_left.force": 3.0 * (1.0 - np.exp(-times / tau))}


COMMANDS = {f"{place}_command": 3.0 + k for k, place in enumerate(("front_left", "front_right", "rear_left", "rear_right"))}
CASES = {
    "ODE": Case("van_der_pol", lambda t: {"force": 0.5}, van_der_pol, 1e-6),
    "PI": Case("motor_pi", lambda t: {"wanted": 50.0, "load": 0.02}, motor_pi),
    "network": Case("network", lambda t: {"hot": 90.0, "cold": 10.0}, network, 1e-5),
    "table": Case("battery", lambda t: {"i": 5.0}, battery),
    "event": Case("ball", lambda t: {}, ball, 1e-9),
    "delay": Case("delayed", lambda t: {"wanted": 30.0, "reading": 10.0 if t >= 1.0 - 1e-9 else 0.0}, delayed, 1e-9),
    "instances": Case("vehicle", lambda t: COMMANDS, vehicle, 1e-6),
}
"""The six models, and a vehicle of four instances."""
