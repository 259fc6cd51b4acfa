"""The paper's reductions, computed from the full model's parameters at an operating point (paper, section 2.2).

With inflow and currents settled, four states remain (eq. 12): speed, integral of its error, pitch, rate of pitch. Without the
zeros and the coupling K_beta, two lags a channel remain (eqs. 13 to 15). Differences of rig or algebra from the text:

- The text's PI sets a current, the rig's a throttle. The back-EMF then damps too: k_omega + C_Q^omega becomes
  k_omega + C_Q^omega + k_Q k_i / R, and k_P becomes V k_P / R.
- Signs. The text defines e = omega - omega_ref and adds k_P e to the current: with positive gains the printed matrix has the
  entries (K_P - 1) / tau and +K_I / tau, and is unstable for any K_I > 0 (here: a pole at +4 rad/s). The relations of the
  two-lag form hold for the opposite sign. `state_space` subtracts.
- Linearising -Q_a gives -C_Q^beta: K_beta is negative if more pitch needs more torque. The text has +C_Q^beta.
- The PI's zero at k_I / k_P = 20 rad/s, for any motor and load, is not far outside the loop's bandwidth: the poles lie at 5 to
  11 rad/s, as a complex pair at most points. Without the zero the step response is off by 0.13 to 0.15 of the step. `two_lags`
  is the text's relation. `two_lags_with_zero` keeps the response up to s^2, as a fit to steps does, and is off by 0.03 to 0.05:
  tau_1 + tau_2 = 1 / K_I, tau_1 tau_2 = (tau - K_P / K_I) / K_I.
- The LAC's PD acts on the measured rate alone: the column of d beta_ref/dt in B, and its zero, are the text's, not the rig's.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np

from hil.physics.propeller import DEG, RPM, drag_factor, force_factor, settled_inflow, thrust_coefficient
from hil.physics.rig_model import FULL_RIG
from hil.physics.rotor import motor_constant
from vpp_fmu.kernel.ops import NUMBERS
from vpp_fmu.kernel.types import Model, start, step

DIFFERENCE = 1e-4  # deg


@dataclass(frozen=True)
class Reduced:
    """The paper's symbols at an operating point, in SI units (rad, rad/s, s, A)."""

    tau_omega: float
    k_p: float  # K_P, 1
    k_i: float  # K_I, 1/s
    k_beta: float  # K_beta, 1/s, with the sign of -C_Q^beta
    a_beta: float  # 1/s
    b_beta: float  # rad/s^2 at full drive
    k_p_beta: float  # K_P,beta, 1/rad
    k_d_beta: float  # K_D,beta, s/rad


def reduced(omega: float, beta: float, parameters: Mapping[str, float] | None = None) -> Reduced:
    """The reduction of `FULL_RIG` around a speed [rpm] and a pitch [deg]; `parameters`: changes to the defaults."""
    p = SimpleNamespace(**FULL_RIG.values(parameters))
    speed, k = omega * RPM, motor_constant(p)
    resistance = p.resistance + p.lead_resistance
    by_omega = 2.0 * _drag(p, beta) * speed
    by_beta = (_drag(p, beta + DIFFERENCE) - _drag(p, beta - DIFFERENCE)) / (2.0 * DIFFERENCE * DEG) * speed**2
    damping = p.drag + by_omega + k * k / resistance
    gain = k * p.supply_voltage * p.full_duty / resistance * p.throttle_unit / RPM / damping
    travel = (p.beta_high - p.beta_low) * DEG
    return Reduced(
        tau_omega=p.inertia / damping,
        k_p=gain * p.kp_rpm,
        k_i=gain * p.ki_rpm,
        k_beta=-by_beta / damping,
        a_beta=(p.d_a + p.k_a * p.k_ia / p.r_a) / p.j_a,
        b_beta=p.k_a * p.v_a / (p.j_a * p.r_a),
        k_p_beta=p.kp_lac / travel,
        k_d_beta=p.kd_lac * p.lac_period / travel,
    )


def _drag(p, beta: float) -> float:
    """Aerodynamic torque over speed squared with the inflow settled."""
    return drag_factor(NUMBERS, p, beta, settled_inflow(NUMBERS, p, beta))


def state_space(r: Reduced) -> tuple[np.ndarray, np.ndarray]:
    """(A (4, 4), B (4, 3)) of eq. 12: states omega, integral of its error, beta, d beta/dt; inputs omega_ref, beta_ref,
    d beta_ref/dt."""
    tau, stiffness, damping = r.tau_omega, r.b_beta * r.k_p_beta, r.b_beta * r.k_d_beta
    a = [
        [-(r.k_p + 1.0) / tau, -r.k_i / tau, r.k_beta / tau, 0.0],
        [1.0, 0.0, 0.0, 0.0],
        [0.0, 0.0, 0.0, 1.0],
        [0.0, 0.0, -stiffness, -(r.a_beta + damping)],
    ]
    b = [[r.k_p / tau, 0.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, stiffness, damping]]
    return np.array(a), np.array(b)


def two_lags(r: Reduced) -> dict[str, tuple[complex, complex]]:
    """Time constants [s] of both channels by the text's relations, the slower first; complex where the poles are."""
    stiffness = r.b_beta * r.k_p_beta
    return {
        "omega": _lags((1.0 + r.k_p) / r.k_i, r.tau_omega / r.k_i),
        "beta": _lags((r.a_beta + r.b_beta * r.k_d_beta) / stiffness, 1.0 / stiffness),
    }


def two_lags_with_zero(r: Reduced) -> tuple[complex, complex]:
    """Time constants [s] of two lags that equal the speed loop, including its zero, up to s^2."""
    return _lags(1.0 / r.k_i, (r.tau_omega - r.k_p / r.k_i) / r.k_i)


def wiener(omega: float, beta: float, parameters: Mapping[str, float] | None = None) -> dict[str, float]:
    """The paper's Wiener model (eqs. 8 and 16) of the full model: parameters of `VppPlant` by name.

    Time constants at a speed [rpm] and a pitch [deg] (a pair that would be complex becomes a double one), the map by least
    squares over 2000 to 6000 rpm and -5 to 10 deg.
    """
    r = reduced(omega, beta, parameters)
    w, b = (grid.ravel() for grid in np.meshgrid(np.linspace(2000.0, 6000.0, 10), np.linspace(-5.0, 10.0, 10)))
    p = SimpleNamespace(**FULL_RIG.values(parameters))
    inflows = [settled_inflow(NUMBERS, p, x) for x in b]
    coefficients = np.array([thrust_coefficient(NUMBERS, p, x, y) for x, y in zip(b, inflows, strict=True)])
    thrust = force_factor(p) * (w * RPM) ** 2 * coefficients / 15.0
    w, b = w / 6000.0, (b + 5.0) / 15.0
    c = np.linalg.lstsq(np.column_stack([w**2, w * b, w**2 * b, w * b**2, w**3]), thrust)[0]
    constants = {"omega": two_lags_with_zero(r), "beta": two_lags(r)["beta"]}
    lags = {f"tau_{u}_{k + 1}": float(tau[k].real) for u, tau in constants.items() for k in (0, 1)}
    return lags | dict(zip(("c20", "c11", "c21", "c12", "c30"), c.tolist(), strict=True))


def _lags(total: float, product: float) -> tuple[complex, complex]:
    slow, fast = sorted(np.roots([1.0, -total, product]), key=lambda root: -root.real)
    return slow, fast


def poles(omega: float, beta: float, parameters: Mapping[str, float] | None = None, model: Model = FULL_RIG) -> np.ndarray:
    """Poles [1/s] of the full model around settled commands [rpm, deg], slowest first: differences of the kernel's own step.

    States that only pass a value to the next step, or count turns, are left out.
    """
    dt, values = 1e-4, model.values(parameters)
    inputs = model.measured_inputs | {"omega_ref": omega, "beta_ref": beta}
    _, rest = start(model, NUMBERS, inputs, values)
    names = [name for name in rest if name != "shaft_angle"]

    def ahead(name, move):
        moved = step(model, NUMBERS, inputs, {**rest, name: rest[name] + move}, values, dt)[1]
        return np.array([moved[n] for n in names])

    size = {name: 1e-5 * max(1.0, abs(rest[name])) if name != "throttle_integral" else 1e-6 for name in names}
    transition = np.column_stack([(ahead(n, size[n]) - ahead(n, -size[n])) / (2.0 * size[n]) for n in names])
    z = np.linalg.eigvals(transition)
    s = np.log(z[np.abs(z) > 1e-3].astype(complex)) / dt
    return s[np.argsort(-s.real)]
