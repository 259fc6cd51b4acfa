"""Other ways to fit the same nine parameters to the same record: set up as an expert would, and out of the box.

Each takes the record's normalised commands `u` (rows, 2) and thrust `y` (rows,) on the paper's 250 Hz grid, builds and
compiles what it can, and returns a function from the start `p` (9,) to the fitted parameters (9,). The parameters are
tau_omega_1, tau_omega_2, tau_beta_1, tau_beta_2, c20, c11, c21, c12, c30. States: speed, its inner lag, pitch, its inner lag.
"""

import os
from collections.abc import Callable

import numpy as np
from scipy.optimize import least_squares
from scipy.signal import lfilter

STEP = 0.004
LOWER, UPPER = np.array([0.001] * 4 + [-10.0] * 5), np.array([3.0] * 4 + [10.0] * 5)

Fit = Callable[[np.ndarray], np.ndarray]


def thrust(x, c):
    """The map (paper, eq. 8) of states and coefficients, on any arithmetic."""
    w, b = x[0], x[2]
    return c[0] * w * w + c[1] * w * b + c[2] * w * w * b + c[3] * w * b * b + c[4] * w * w * w


def exact_step(x, u, p, exp):
    """States after one step under held commands (paper, eqs. 13 to 15), as a list; the two constants must differ."""
    ahead = []
    for k in (0, 1):
        tau_1, tau_2, outer, inner = p[2 * k], p[2 * k + 1], x[2 * k] - u[k], x[2 * k + 1] - u[k]
        e_1, e_2 = exp(-STEP / tau_1), exp(-STEP / tau_2)
        ahead += [u[k] + e_1 * outer + tau_2 / (tau_2 - tau_1) * (e_2 - e_1) * inner, u[k] + e_2 * inner]
    return ahead


def by_scipy(evaluate: Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]], method: str, **options) -> Fit:
    """scipy's `least_squares` on `evaluate(x) -> (residual, Jacobian)`, which is called once per point."""

    def fit(p: np.ndarray) -> np.ndarray:
        at, known = np.full(len(p), np.nan), (np.empty(0), np.empty(0))

        def both(x):
            nonlocal at, known
            if not np.array_equal(x, at):
                at, known = x.copy(), evaluate(x)
            return known

        return least_squares(lambda x: both(x)[0], p, lambda x: both(x)[1], method=method, **options).x

    return fit


def filters(u: np.ndarray, y: np.ndarray, method: str) -> Fit:
    """scipy's `lfilter` for each channel's transfer function and its derivatives in the time constants."""

    def channel(command, tau_1, tau_2):
        """(response (rows,), its derivatives in both constants)."""
        e_1, e_2, difference = np.exp(-STEP / tau_1), np.exp(-STEP / tau_2), tau_1 - tau_2
        d_1, d_2 = e_1 * STEP / tau_1**2, e_2 * STEP / tau_2**2
        # Numerator: the step response after one step; the rest gives a static gain of 1.
        part = (tau_1 * e_1 - tau_2 * e_2) / difference
        first, total = 1.0 - part, (1.0 - e_1) * (1.0 - e_2)
        first_1, total_1 = (part - e_1 - tau_1 * d_1) / difference, -d_1 * (1.0 - e_2)
        first_2, total_2 = (e_2 + tau_2 * d_2 - part) / difference, -d_2 * (1.0 - e_1)
        poles, moved = [1.0, -e_1 - e_2, e_1 * e_2], command - command[0]
        response = lfilter([0.0, first, total - first], poles, moved)
        by_1 = lfilter([0.0, first_1, total_1 - first_1], poles, moved) + lfilter([0.0, d_1, -d_1 * e_2], poles, response)
        by_2 = lfilter([0.0, first_2, total_2 - first_2], poles, moved) + lfilter([0.0, d_2, -d_2 * e_1], poles, response)
        return command[0] + response, by_1, by_2

    def evaluate(p):
        c, (w, w_1, w_2), (b, b_1, b_2) = p[4:], channel(u[:, 0], *p[:2]), channel(u[:, 1], *p[2:4])
        by_w = 2 * c[0] * w + c[1] * b + 2 * c[2] * w * b + c[3] * b * b + 3 * c[4] * w * w
        by_b = c[1] * w + c[2] * w * w + 2 * c[3] * w * b
        terms = w * w, w * b, w * w * b, w * b * b, w * w * w
        jacobian = np.stack([by_w * w_1, by_w * w_2, by_b * b_1, by_b * b_2, *terms], axis=1)
        return jacobian[:, 4:] @ c - y, jacobian

    return by_scipy(evaluate, method)


def jax_forward(u: np.ndarray, y: np.ndarray) -> Fit:
    """JAX: a scan over the steps and its forward derivatives, compiled as one function, and scipy's TRF."""
    os.environ.setdefault("XLA_FLAGS", "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1")
    import jax
    import jax.numpy as jnp

    jax.config.update("jax_enable_x64", True)

    def residual(p):
        def step(x, command):
            return jnp.array(exact_step(x, command, p, jnp.exp)), x

        _, x = jax.lax.scan(step, jnp.repeat(jnp.asarray(u[0]), 2), jnp.asarray(u))
        found = thrust(x.T, p[4:]) - y
        return found, found

    both = jax.jit(jax.jacfwd(residual, has_aux=True))
    both(LOWER + np.arange(9.0))[0].block_until_ready()

    def evaluate(p):
        jacobian, found = both(p)
        return np.asarray(found), np.asarray(jacobian)

    return by_scipy(evaluate, "trf")


def casadi_forward(u: np.ndarray, y: np.ndarray, is_compiled: bool) -> Fit:
    """CasADi: states and their sensitivities together through one mapaccum, compiled or interpreted, and MINPACK."""
    import casadi as ca

    x, s, held, p = ca.SX.sym("x", 4), ca.SX.sym("s", 4, 9), ca.SX.sym("u", 2), ca.SX.sym("p", 9)
    ahead = ca.vertcat(*exact_step(ca.vertsplit(x), ca.vertsplit(held), ca.vertsplit(p), ca.exp))
    response = thrust(ca.vertsplit(x), ca.vertsplit(p)[4:])
    moved, slopes = (ca.jacobian(f, x) @ s + ca.jacobian(f, p) for f in (ahead, response))
    state, next_state = ca.vertcat(x, ca.vec(s)), ca.vertcat(ahead, ca.vec(moved))
    run = ca.Function("step", [state, held, p], [next_state, ca.horzcat(response, slopes)]).mapaccum("run", len(y))
    if is_compiled:
        arguments = run.mx_in()
        options = {"jit": True, "compiler": "shell", "jit_options": {"flags": ["-O3"], "verbose": False}}
        run = ca.Function("compiled", arguments, run(*arguments), options)
    first = np.append(np.repeat(u[0], 2), np.zeros(36))

    def evaluate(p):
        rows = np.asarray(run(first, u.T, ca.repmat(p, 1, len(y)))[1]).reshape(10, -1, order="F")
        return rows[0] - y, rows[1:].T

    return by_scipy(evaluate, "lm")


def paper_descent(u: np.ndarray, y: np.ndarray, rate: float, iterations: int) -> Fit:
    """The paper's section 3.2: explicit Euler for states and sensitivities, step by step, and gradient descent."""

    def fit(p: np.ndarray) -> np.ndarray:
        for _ in range(iterations):
            p = np.maximum(p - rate * _paper_gradient(u, y, p), LOWER)
        return p

    return fit


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


def casadi_shooting(u: np.ndarray, y: np.ndarray, is_gauss_newton: bool) -> Fit:
    """Single shooting as in CasADi's example `sysid.py`: mapaccum, IPOPT, Gauss-Newton or exact Hessian."""
    import casadi as ca

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
    if is_gauss_newton:
        weight, slope = ca.MX.sym("weight"), ca.jacobian(error, v)
        hessian = weight * ca.triu(slope.T @ slope)
        names = ["x", "p", "lam_f", "lam_g"], ["triu_hess_gamma_x_x"]
        arguments = [v, ca.MX(0, 1), weight, ca.MX(0, 1)]
        options["hess_lag"] = ca.Function("hess_lag", arguments, [hessian], *names)
    solver = ca.nlpsol("fit", "ipopt", problem, options)
    return lambda p: np.array(solver(x0=p, lbx=LOWER, ubx=UPPER)["x"]).ravel()


def jax_sysid(u: np.ndarray, y: np.ndarray) -> Fit:
    """The package's own model class, L-BFGS-B alone, no regularisation; its compilation is part of its fit."""
    import jax.numpy as jnp
    from jax_sysid.models import Model

    def state_fcn(x, u, params):
        return jnp.array(exact_step(x, u, params[0], jnp.exp))

    def output_fcn(x, u, params):
        return jnp.array([thrust(x, params[1])])

    def fit(p: np.ndarray) -> np.ndarray:
        model = Model(4, 1, 2, state_fcn=state_fcn, output_fcn=output_fcn, Ts=STEP)
        model.loss(rho_x0=0.0, rho_th=0.0, train_x0=False)
        bounds = {"params_min": [LOWER[:4], LOWER[4:]], "params_max": [UPPER[:4], UPPER[4:]]}
        model.optimization(adam_epochs=0, lbfgs_epochs=1000, iprint=-1, **bounds)
        model.init(params=[p[:4], p[4:]], x0=np.repeat(u[0], 2))
        model.fit(y[:, None], u)
        return np.concatenate(model.params)

    return fit
