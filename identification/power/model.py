"""Power over speed and pitch of an identified plant, with its standard deviation."""

import os
from collections.abc import Mapping
from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np

from vpp_fmu.errors import BadInput
from vpp_fmu.kernel.power import EFFECTS, FIGURE, RAD_PER_S
from vpp_fmu.parameters import ParameterSet
from vpp_fmu.structured import read_object

STEP = 1e-6
"""Step of a derivative as a share of a parameter: exact to rounding for maps, which are linear in their parameters."""


def _covariance(path: str | os.PathLike, names: tuple[str, ...]) -> np.ndarray | None:
    """Covariance (k, k) of the parameters from an identification.json; None if it has none of them. BadInput."""
    found = read_object(path, allowed="an identification.json").get("power")
    if found is None:
        return None
    try:
        order = list(found["parameters"])
        if not set(names) <= set(order):
            return None
        at = [order.index(name) for name in names]
        own = np.array(found["covariance"], float)[np.ix_(at, at)]
    except (TypeError, KeyError, ValueError, IndexError) as error:
        raise BadInput(
            path, "power", "no covariance of its parameters", "a matrix of numbers, as `vpp identify` writes it"
        ) from error
    return own


@dataclass(frozen=True, eq=False)
class PowerModel:
    """Power [W] of a plant with effects of `vpp_fmu.kernel.power`: electrical, or of the shaft if only torque is known.

    `names` (k,), `covariance` (k, k): of the uncertain parameters; the others have no uncertainty.
    """

    parameters: ParameterSet
    names: tuple[str, ...]
    covariance: np.ndarray

    @classmethod
    def of(cls, parameters: ParameterSet, knowledge: str | os.PathLike | None = None) -> "PowerModel":
        """`knowledge`: the identification.json beside the parameters; None: standard deviations alone, as if independent.
        BadInput for a plant without torque and power."""
        outputs = {y.name for y in parameters.model.outputs}
        if not outputs & {"torque", "power"}:
            allowed = "torque_map or power_map, identified from a campaign with torque, power, or voltage and current"
            hint = "vpp hil campaign --power, which measures it; then vpp identify"
            raise BadInput("parameters", "effects", ", ".join(parameters.model.optional) or "none", allowed, hint)
        own = {e.full(p.name) for e in EFFECTS if e.name in parameters.model.optional for p in e.parameters}
        std = {n: e.std for n, e in parameters.estimates.items() if n in own and e.std}
        names, covariance = tuple(std), np.diag(np.square(list(std.values())))
        known = _covariance(knowledge, names) if knowledge is not None and os.path.exists(knowledge) else None
        return cls(parameters, names, covariance if known is None else known)

    @property
    def kind(self) -> str:
        """ "electrical" or "shaft"."""
        return "electrical" if any(y.name == "power" for y in self.parameters.model.outputs) else "shaft"

    def at(self, omega: np.ndarray, beta: np.ndarray, changed: Mapping[str, float] | None = None) -> np.ndarray:
        """Power [W] at speed [rpm] and pitch [deg], which have the same shape; `changed`: parameters of other values."""
        values = {**self.parameters.values, **(changed or {})}
        w = np.asarray(omega) / values["omega_scale"]
        b = (np.asarray(beta) + values["beta_offset"]) / values["beta_scale"]
        s = SimpleNamespace(w=w, b=b, omega_scale=values["omega_scale"])
        for effect in self.parameters.model.effects:
            if effect.outputs and effect.name != FIGURE.name:
                p = SimpleNamespace(**{q.name: values[effect.full(q.name)] for q in effect.parameters})
                s.__dict__.update(effect.step(np, s, None, p, 0.0)[0])  # of the operations it needs `where`
        return s.power if self.kind == "electrical" else s.torque * np.asarray(omega) * RAD_PER_S

    def gradient(self, omega: np.ndarray, beta: np.ndarray) -> np.ndarray:
        """(..., k) derivatives of the power [W] with respect to the named parameters."""
        values, found = self.parameters.values, np.empty((*np.shape(omega), len(self.names)))
        for k, name in enumerate(self.names):
            step = STEP * max(abs(values[name]), 1e-9)
            high, low = (self.at(omega, beta, {name: values[name] + way * step}) for way in (1.0, -1.0))
            found[..., k] = (high - low) / (2.0 * step)
        return found

    def std(self, omega: np.ndarray, beta: np.ndarray) -> np.ndarray:
        """Standard error [W] at these points, sqrt(g.T C g) with g the gradient."""
        g = self.gradient(omega, beta)
        return np.sqrt(np.einsum("...i,ij,...j->...", g, self.covariance, g))
