"""The plant linearised at a working point, for python-control, scipy and MATLAB.

    tau_2 dx/dt = u_ref - x,   tau_1 du/dt = x - u     (each channel; paper, eqs. 13-15)
    thrust = dT/domega * omega + dT/dbeta * beta       (slopes of the map; paper, eqs. 7 and 8)

All quantities are deviations from the working point, in rpm, deg and N. Effects are not linearised (a dead band passes
no small change, a delay has no states). The model is linearised without them, and a warning names them.
"""

import io
import os
import warnings
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
from scipy.io import savemat
from scipy.signal import StateSpace

from vpp_fmu.errors import BadInput, ExtraMissing
from vpp_fmu.files import OutputFolder
from vpp_fmu.kernel.effects.thrust_map import THRUST_MAP, normalised_thrust
from vpp_fmu.kernel.plant import ADDS_POWER
from vpp_fmu.kernel.signals import BETA_REF, OMEGA_REF
from vpp_fmu.parameters import ParameterSet

INPUTS = ("omega_ref", "beta_ref")
STATES = ("omega_inner", "omega", "beta_inner", "beta")
OUTPUTS = ("thrust",)


@dataclass(frozen=True, eq=False)
class Linear:
    """`a` (4, 4), `b` (4, 2), `c` (1, 4), `d` (1, 2): from `INPUTS` [rpm, deg] through `STATES` [rpm, rpm, deg, deg] to thrust
    [N], all deviations from the working point, which has the `thrust` [N]."""

    a: np.ndarray
    b: np.ndarray
    c: np.ndarray
    d: np.ndarray
    thrust: float


def linearised(values: Mapping[str, float], omega: float, beta: float) -> Linear:
    """The base plant at the working point `omega` [rpm], `beta` [deg]; `values` of its parameters. BadInput."""
    for signal, found in ((OMEGA_REF, omega), (BETA_REF, beta)):
        if not signal.minimum <= found <= signal.maximum:
            allowed = f"{signal.minimum:g} to {signal.maximum:g} {signal.unit}"
            raise BadInput("working point", signal.name.removesuffix("_ref"), f"{found:g} {signal.unit}", allowed)
    a, b = np.zeros((4, 4)), np.zeros((4, 2))
    for k, u in enumerate(("omega", "beta")):
        slow, fast = 1.0 / values[f"tau_{u}_1"], 1.0 / values[f"tau_{u}_2"]
        inner, outer = 2 * k, 2 * k + 1
        a[inner, inner], b[inner, k] = -fast, fast
        a[outer, inner], a[outer, outer] = slow, -slow
    v = values
    w, p = omega / v["omega_scale"], (beta + v["beta_offset"]) / v["beta_scale"]
    of_w = 2.0 * w * (v["c20"] + v["c21"] * p) + p * (v["c11"] + v["c12"] * p) + 3.0 * v["c30"] * w**2
    of_p = w * (v["c11"] + v["c21"] * w + 2.0 * v["c12"] * p)
    scale = v["thrust_scale"]
    c = np.array([[0.0, scale / v["omega_scale"] * of_w, 0.0, scale / v["beta_scale"] * of_p]])
    thrust = scale * normalised_thrust(SimpleNamespace(**{name: v[name] for name in COEFFICIENTS}), w, p)
    return Linear(a, b, c, np.zeros((1, 2)), float(thrust))


COEFFICIENTS = tuple(p.name for p in THRUST_MAP.parameters)


class Linearisable(ABC):
    """A result with the parameters of a plant."""

    @property
    @abstractmethod
    def parameters(self) -> ParameterSet:
        """Values with their standard deviations."""

    def to_scipy(self, omega: float, beta: float) -> StateSpace:
        """The plant linearised at `omega` [rpm], `beta` [deg] as a scipy.signal.StateSpace: from speed and pitch command [rpm,
        deg] to thrust [N], deviations from the working point. A warning names effects that it leaves out. BadInput.

        >>> found = vpp.identify(vpp.example_campaign(), starts=1)
        >>> found.to_scipy(omega=4000, beta=2).C.shape
        (1, 4)
        """
        found = self._linear(omega, beta)
        return StateSpace(found.a, found.b, found.c, found.d)

    def to_control(self, omega: float, beta: float) -> Any:
        """The same as a control.StateSpace with named inputs, states and output. ExtraMissing without python-control."""
        try:
            import control  # noqa: PLC0415 - an extra, only needed here
        except ImportError as error:
            raise ExtraMissing("control: found no library, expected one. Try: pip install 'vpp-fmu[control]'") from error
        found = self._linear(omega, beta)
        names = {"inputs": list(INPUTS), "states": list(STATES), "outputs": list(OUTPUTS), "name": "VppPlant"}
        return control.ss(found.a, found.b, found.c, found.d, **names)

    def save_mat(self, path: str | os.PathLike[str], omega: float, beta: float) -> Path:
        """Write the linear plant at `omega` [rpm], `beta` [deg] to a MATLAB file: A, B, C, D, the working point, all parameters
        with their units. A script of the same name (.m) beside it builds the nonlinear blocks. Returns the path. BadInput."""
        target, found, held = Path(path).with_suffix(".mat"), self._linear(omega, beta), self.parameters
        if not target.stem.isidentifier():
            raise BadInput(path, "name", target.stem, "letters, digits and _, as MATLAB wants of a script's name")
        declared = {p.name: p for p in held.model.parameters}
        content = {
            **{name.upper(): getattr(found, name) for name in "abcd"},
            **{"inputs": list(INPUTS), "states": list(STATES), "outputs": list(OUTPUTS)},
            "point": {"omega": float(omega), "beta": float(beta), "thrust": found.thrust},
            "coefficients": {name: held.values[name] for name in COEFFICIENTS},
            "scales": {name: held.values[name] for name in declared if name.endswith(("_scale", "beta_offset"))},
            "parameters": {_field(name): held.values[name] for name in declared},
            "units": {_field(name): p.unit for name, p in declared.items()},
            "effects": list(held.model.optional),
        }
        packed = io.BytesIO()
        savemat(packed, content, long_field_names=True)
        folder = OutputFolder(target.parent)
        folder.write(f"{target.stem}.m", SCRIPT.replace("NAME", target.stem))
        return folder.write(target.name, packed.getvalue())

    def _linear(self, omega: float, beta: float) -> Linear:
        held = self.parameters
        if effects := [name for name in held.model.optional if name not in ADDS_POWER]:
            warnings.warn(f"not part of the linear model: {', '.join(effects)}", UserWarning, stacklevel=3)
        return linearised(held.values, omega, beta)


def _field(name: str) -> str:
    """A parameter's name as a field of a MATLAB structure."""
    return name.replace(".", "__")


SCRIPT = """\
% Not run by its authors, who have no MATLAB. Blocks of the plant in NAME.mat: two lags a channel, then the thrust map.
% Control System Toolbox. Signals in rpm, deg and N; the plant is linear between the commands and the map (Wiener model).
NAME = load('NAME.mat');
p = NAME.parameters; s = NAME.scales; c = NAME.coefficients;

% 1. Linear at the working point NAME.point, in deviations from it.
plant = ss(NAME.A, NAME.B, NAME.C, NAME.D, 'InputName', {'omega_ref', 'beta_ref'}, 'OutputName', {'thrust'});

% 2. Nonlinear: linear blocks of idnlhw's kind, then a static map of two inputs, which idnlhw itself does not have.
speed = tf(1, conv([p.tau_omega_1 1], [p.tau_omega_2 1]));
pitch = tf(1, conv([p.tau_beta_1 1], [p.tau_beta_2 1]));
w = @(omega) omega / s.omega_scale;
b = @(beta) (beta + s.beta_offset) / s.beta_scale;
map = @(w, b) c.c20*w.^2 + c.c11*w.*b + c.c21*w.^2.*b + c.c12*w.*b.^2 + c.c30*w.^3;
thrust = @(omega, beta) s.thrust_scale * map(w(omega), b(beta));

% 3. The response to commands omega_ref, beta_ref at times t, settled on the first row.
respond = @(block, t, u) u(1) + lsim(block, u - u(1), t);
simulate = @(t, omega_ref, beta_ref) thrust(respond(speed, t, omega_ref), respond(pitch, t, beta_ref));
"""
"""The .m file; NAME is replaced by its name."""
