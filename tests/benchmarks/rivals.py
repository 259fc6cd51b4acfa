"""Other ways to fit the same nine parameters to the same record, each written as its own documentation would have it.

Each takes the record's normalised commands `u` (rows, 2), normalised thrust `y` (rows,) and the start `p` (9,), all on the
paper's 250 Hz grid, and returns the fitted parameters (9,) and the seconds of building and of solving. The parameters are
tau_omega_1, tau_omega_2, tau_beta_1, tau_beta_2, c20, c11, c21, c12, c30. States: speed, its inner lag, pitch, its inner lag.
"""

import time
from dataclasses import dataclass

import numpy as np

STEP = 0.004
LOWER, UPPER = np.array([0.001] * 4 + [-10.0] * 5), np.array([3.0] * 4 + [10.0] * 5)


@dataclass(frozen=True)
class Outcome:
    """Parameters (9,), and seconds."""

    parameters: np.ndarray
    build: float
    solve: float


def thrust(x, c):
    """The map (paper, eq. 8) of states and coefficients, on any arithmetic."""
    w, b = x[0], x[2]
    return c[0] * w * w + c[1] * w * b + c[2] * w * w * b + c[3] * w * b * b + c[4] * w * w * w


def paper_descent(u: np.ndarray, y: np.ndarray, p: np.ndarray, rate: float, iterations: int) -> Outcome:
    """The paper's section 3.2: explicit Euler for states and sensitivities, step by step, and gradient descent."""
    began, p = time.perf_counter(), p.copy()
    for _ in range(iterations):
        p = np.maximum(p - rate * _paper_gradient(u, y, p), LOWER)
    return Outcome(p, 0.0, time.perf_counter() - began)


def _paper_gradient(u, y, p):
    tau, c = p[:4], p[4:]
    slow, fast = np.array([0, 2]), np.array([1, 3])  # of states and time constants alike
    a = np.zeros((4, 4))
    a[slow, slow], a[slow, fast], a[fast, fast] = -1.0 / tau[slow], 1.0 / tau[slow], -1.0 / tau[fast]
    x, s, gradient = np.repeat(u[0], 2), np.zeros((4, 9)), np.zeros(9)
    each, source = np.arange(4), np.zeros((4, 9))
    for command, measured in zip(u, y, strict=True):
        w, b = x[0], x[2]
        dw = 2 * c[0] * w + c[1] * b + 2 * c[2] * w * b + c[3] * b * b + 3 * c[4] * w * w
        db = c[1] * w + c[2] * w * w + 2 * c[3] * w * b
        z = dw * s[0] + db * s[2]
        z[4:] += (w * w, w * b, w * w * b, w * b * b, w * w * w)
        gradient += (thrust(x, c) - measured) * z
        rate = a @ x
        rate[fast] += command / tau[fast]
        source[each, each] = -rate / tau
        x, s = x + STEP * rate, s + STEP * (a @ s + source)
    return gradient / len(y)


def exact_step(x, u, p, exp):
    """States after one step under held commands (paper, eqs. 13 to 15), as a list; the two constants must differ."""
    ahead = []
    for k in (0, 1):
        tau_1, tau_2, outer, inner = p[2 * k], p[2 * k + 1], x[2 * k] - u[k], x[2 * k + 1] - u[k]
        e_1, e_2 = exp(-STEP / tau_1), exp(-STEP / tau_2)
        ahead += [u[k] + e_1 * outer + tau_2 / (tau_2 - tau_1) * (e_2 - e_1) * inner, u[k] + e_2 * inner]
    return ahead


def casadi_shooting(u: np.ndarray, y: np.ndarray, p: np.ndarray, gauss_newton: bool) -> Outcome:
    """Single shooting as in CasADi's example `sysid.py`: mapaccum, IPOPT, Gauss-Newton or exact Hessian."""
    import casadi as ca

    began = time.perf_counter()
    x, held, free = ca.SX.sym("x", 4), ca.SX.sym("u", 2), ca.SX.sym("p", 9)
    ahead = ca.vertcat(*exact_step(ca.vertsplit(x), ca.vertsplit(held), ca.vertsplit(free), ca.exp))
    step = ca.Function("step", [x, held, free], [ahead, thrust(ca.vertsplit(x), ca.vertsplit(free)[4:])])
    # mapaccum hands on one state; the output of a row is that of the state before its command acts.
    run = step.mapaccum("run", len(y))
    v = ca.MX.sym("v", 9)
    _, predicted = run(np.repeat(u[0], 2), u.T, ca.repmat(v, 1, len(y)))
    error = predicted.T - y
    problem = {"x": v, "f": 0.5 * ca.dot(error, error)}
    options = {"ipopt.print_level": 0, "ipopt.sb": "yes", "print_time": False}
    if gauss_newton:
        weight, slope = ca.MX.sym("weight"), ca.jacobian(error, v)
        hessian = weight * ca.triu(slope.T @ slope)
        names = ["x", "p", "lam_f", "lam_g"], ["triu_hess_gamma_x_x"]
        arguments = [v, ca.MX(0, 1), weight, ca.MX(0, 1)]
        options["hess_lag"] = ca.Function("hess_lag", arguments, [hessian], *names)
    solver = ca.nlpsol("fit", "ipopt", problem, options)
    built = time.perf_counter()
    found = solver(x0=p, lbx=LOWER, ubx=UPPER)
    return Outcome(np.array(found["x"]).ravel(), built - began, time.perf_counter() - built)


def jax_sysid(u: np.ndarray, y: np.ndarray, p: np.ndarray) -> Outcome:
    """The package's own model class, L-BFGS-B alone, no regularisation; its compilation is part of its fit."""
    import jax.numpy as jnp
    from jax_sysid.models import Model

    began = time.perf_counter()

    def state_fcn(x, u, params):
        return jnp.array(exact_step(x, u, params[0], jnp.exp))

    def output_fcn(x, u, params):
        return jnp.array([thrust(x, params[1])])

    model = Model(4, 1, 2, state_fcn=state_fcn, output_fcn=output_fcn, Ts=STEP)
    model.loss(rho_x0=0.0, rho_th=0.0, train_x0=False)
    bounds = {"params_min": [LOWER[:4], LOWER[4:]], "params_max": [UPPER[:4], UPPER[4:]]}
    model.optimization(adam_epochs=0, lbfgs_epochs=1000, iprint=-1, **bounds)
    model.init(params=[p[:4], p[4:]], x0=np.repeat(u[0], 2))
    built = time.perf_counter()
    model.fit(y[:, None], u)
    return Outcome(np.concatenate(model.params), built - began, time.perf_counter() - built)
