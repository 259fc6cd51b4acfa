"""The static power map: power over rotor speed and blade pitch, by least squares on the steady points of a campaign."""

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import combinations, product

import numpy as np

from vpp_fmu.campaign import StaticMap
from vpp_fmu.errors import BadInput

POWERS = tuple(product((1, 2, 3), (0, 1, 2)))
"""Powers (i, j) of the candidate terms w^i b^j. Those of a torque, w^2, w^2 b, w^2 b^2, w b, times the speed are among them. A
rotor at rest takes no power."""

RAD_PER_S = 2.0 * np.pi / 60.0
"""One rpm."""

ELECTRICAL, SHAFT = "electrical", "shaft"

TOLERANCE = 1.05
"""Maximum ratio of shaft to electrical power: both are measured to some per cent."""


@dataclass(frozen=True, eq=False)
class PowerMap:
    """Power [W] = power_scale sum of c_ij w^i b^j, with the normalisation `scales` of the thrust map.

    `kind`: ELECTRICAL or SHAFT power. `terms`: powers (i, j); `coefficients` (k,) and `covariance` (k, k) in W, of the selected
    terms: the selection itself is not part of the covariance. `rmse` [W]: of the points; `r2_adjusted`; `points`: their number.
    """

    kind: str
    terms: tuple[tuple[int, int], ...]
    coefficients: np.ndarray
    covariance: np.ndarray
    scales: Mapping[str, float]
    rmse: float
    r2_adjusted: float
    points: int

    def columns(self, omega: np.ndarray, beta: np.ndarray) -> np.ndarray:
        """(n, k) terms at speed [rpm] and pitch [deg], each (n,)."""
        w = np.asarray(omega) / self.scales["omega_scale"]
        b = (np.asarray(beta) + self.scales["beta_offset"]) / self.scales["beta_scale"]
        return np.stack([w**i * b**j for i, j in self.terms], axis=-1)

    def at(self, omega: np.ndarray, beta: np.ndarray) -> np.ndarray:
        """Power [W] at speed [rpm] and pitch [deg], which have the same shape."""
        return self.columns(omega, beta) @ self.coefficients

    def std(self, omega: np.ndarray, beta: np.ndarray) -> np.ndarray:
        """Standard error [W] of the map at these points, sqrt(a.T C a) with a the terms."""
        a = self.columns(omega, beta)
        return np.sqrt(np.einsum("...i,ij,...j->...", a, self.covariance, a))

    def summary(self) -> dict:
        """For allocation.json."""
        names = [f"w^{i} b^{j}" for i, j in self.terms]
        std = np.sqrt(np.diag(self.covariance))
        own = {n: {"value": c, "std": s, "unit": "W"} for n, c, s in zip(names, self.coefficients, std, strict=True)}
        return {
            "kind": self.kind,
            "coefficients": own,
            "covariance": self.covariance.tolist(),
            "rmse": {"value": self.rmse, "unit": "W"},
            "r2_adjusted": self.r2_adjusted,
            "points": self.points,
        }


def measured_power(static: StaticMap) -> tuple[str, np.ndarray]:
    """(kind, power (n,) [W]) of the steady points: electrical from `power`, else `voltage` times `current`; else that of the
    shaft, `torque` times speed. BadInput without any, for a negative power, and where the shaft gives more than it gets."""
    of = static.further
    shaft = of["torque"] * static.omega * RAD_PER_S if "torque" in of else None
    power = of["power"] if "power" in of else of["voltage"] * of["current"] if {"voltage", "current"} <= set(of) else None
    if shaft is None and power is None:
        raise BadInput(static.source, "columns", ", ".join(of) or "no power", "power, or voltage and current, or torque")
    if shaft is not None and power is not None:
        gets, gives = float(np.sum(power)), float(np.sum(shaft))
        if gives > TOLERANCE * gets:
            found = f"{gives / len(shaft):.4g} W of torque and speed in the mean, {gets / len(shaft):.4g} W electrical"
            raise BadInput(static.source, "torque, power", found, "less power at the shaft: in N.m, W, V, A")
    kind, values = (ELECTRICAL, power) if power is not None else (SHAFT, shaft)
    if float(np.mean(values)) <= 0.0:
        raise BadInput(static.source, f"{kind} power", f"{float(np.mean(values)):.4g} W in the mean", "more than 0 W")
    return kind, values


def power_map(static: StaticMap, scales: Mapping[str, float]) -> PowerMap:
    """Fit the power of steady points. The terms are the subset of POWERS with the least BIC. BadInput if there are not more
    points than candidate terms, or if speed or pitch does not change."""
    kind, power = measured_power(static)
    w = static.omega / scales["omega_scale"]
    b = (static.beta_ref + scales["beta_offset"]) / scales["beta_scale"]
    every = np.column_stack([w**i * b**j for i, j in POWERS])
    n = len(power)
    if n <= len(POWERS) or np.linalg.matrix_rank(every) < len(POWERS):
        allowed = f"more than {len(POWERS)} points, at three speeds and three pitches or more"
        raise BadInput(static.source, "steady points", f"{n} of rank {np.linalg.matrix_rank(every)}", allowed)
    gram, moment, total = every.T @ every, every.T @ power, float(power @ power)

    def bic(chosen: tuple[int, ...]) -> float:
        at = list(chosen)
        left = total - moment[at] @ np.linalg.solve(gram[np.ix_(at, at)], moment[at])
        return n * float(np.log(max(left, 1e-15 * total))) + len(at) * float(np.log(n))

    subsets = (c for k in range(1, len(POWERS) + 1) for c in combinations(range(len(POWERS)), k))
    best = list(min(subsets, key=bic))
    a = every[:, best]
    c, *_ = np.linalg.lstsq(a, power, rcond=None)
    residual = power - a @ c
    variance = float(residual @ residual) / (n - len(best))
    spread = float(np.var(power, ddof=1))
    return PowerMap(
        kind,
        tuple(POWERS[k] for k in best),
        c,
        np.linalg.inv(a.T @ a) * variance,
        dict(scales),
        float(np.sqrt(np.mean(residual**2))),
        1.0 - variance / spread if spread > 0.0 else 1.0,
        n,
    )
