"""python -m tests.benchmarks.gym: plant steps a second of the vectorised environment on one core, beside the FMU under fmpy,
and an equal environment in JAX (`vmap`, `jit`, double precision; one thread), where JAX is installed.

Machines differ and are noisy, so compare the ratios; every time is the best of several runs. The actions are drawn
beforehand. An environment step includes noisy readings, reward and limits; an action is held for `hold` plant steps.
"""

import os
import tempfile
import time
from pathlib import Path

import numpy as np
from scipy.signal import cont2discrete

from tests.benchmarks.native import STEP, started
from vpp_fmu.export import native_fmu, python_fmu
from vpp_fmu.gym import VppThrustVectorEnv
from vpp_fmu.kernel.plant import BASE

ENVIRONMENTS, SECONDS = 4096, 0.5


def rate(work, steps, repeats=5):
    """Plant steps a second of `work()`, which makes `steps` of them: the best of `repeats` runs of SECONDS each."""
    best = 0.0
    for _ in range(repeats):
        count, began = 0, time.perf_counter()
        while (passed := time.perf_counter() - began) < SECONDS:
            work()
            count += 1
        best = max(best, count * steps / passed)
    return best


def under_fmpy(fmu: bytes, folder: Path) -> float:
    """Plant steps a second of an FMU under fmpy: two inputs set, a step, three outputs read."""
    path = folder / "plant.fmu"
    path.write_bytes(fmu)
    slave, at = started(path)
    inputs, outputs = [at["omega_ref"], at["beta_ref"]], [at["thrust"], at["omega"], at["beta"]]
    steps = 0

    def step():
        nonlocal steps
        slave.setReal(inputs, (4000.0, 5.0))
        slave.doStep(steps * STEP, STEP)
        slave.getReal(outputs)
        steps += 1

    try:
        return rate(step, 1)
    finally:
        slave.terminate()
        slave.freeInstance()


def in_jax(hold: int) -> tuple[float, float]:
    """(plant steps a second, largest difference of thrust [N] from the environment after 50 actions without noise) in JAX. The
    plants are the same: exact lags for a held command, map, noise of two readings, reward. Raises ImportError."""
    os.environ["XLA_FLAGS"] = "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1"
    import jax
    import jax.numpy as jnp

    jax.config.update("jax_enable_x64", True)
    p = BASE.values()
    exact = {}
    for u in ("omega", "beta"):
        inner, outer = p[f"tau_{u}_2"], p[f"tau_{u}_1"]
        a, b = np.array([[-1.0 / inner, 0.0], [1.0 / outer, -1.0 / outer]]), np.array([[1.0 / inner], [0.0]])
        exact[u] = [jnp.array(m) for m in cont2discrete((a, b, np.eye(2), np.zeros((2, 1))), STEP)[:2]]
    low, high = jnp.array([2000.0, -5.0]), jnp.array([6000.0, 10.0])

    def thrust_of(speed, pitch):
        w, b = speed / p["omega_scale"], (pitch + p["beta_offset"]) / p["beta_scale"]
        return p["thrust_scale"] * w * (w * (p["c20"] + p["c21"] * b + p["c30"] * w) + b * (p["c11"] + p["c12"] * b))

    def act(state, action, wanted, key):
        """One environment: an action held for `hold` plant steps."""
        commands = low + (high - low) * (0.5 * (jnp.clip(action, -1.0, 1.0) + 1.0))

        def move(x, _):
            rows = [exact[u][0] @ x[k] + exact[u][1][:, 0] * commands[k] for k, u in enumerate(exact)]
            return jnp.stack(rows), None

        state, _ = jax.lax.scan(move, state, None, length=hold)
        thrust = thrust_of(state[0, 1], state[1, 1])
        read = jnp.array([thrust, state[0, 1]]) + jnp.array([0.13, 5.0]) * jax.random.normal(key, (2,))
        return state, jnp.append(read, wanted), -jnp.abs(wanted - thrust) / p["thrust_scale"], thrust

    many, rng = jax.jit(jax.vmap(act)), np.random.default_rng(0)
    start = np.repeat([[[2000.0, 2000.0], [-5.0, -5.0]]], ENVIRONMENTS, axis=0)
    wanted = jnp.full(ENVIRONMENTS, 5.0)
    env = VppThrustVectorEnv(ENVIRONMENTS, seconds=60.0, noise=(0.0, 0.0), hold=hold, dt=STEP)
    env.reset(seed=0)
    state, keys = jnp.array(start), jax.random.split(jax.random.key(0), ENVIRONMENTS)
    for _ in range(50):
        actions = rng.uniform(-1.0, 1.0, (ENVIRONMENTS, 2))
        state, _, _, thrust = many(state, jnp.array(actions), wanted, keys)
        *_, information = env.step(actions)
    off = float(np.abs(np.asarray(thrust) - information["thrust"]).max())
    held = [jnp.array(start), jax.random.key(1)]

    def step():
        held[1], own = jax.random.split(held[1])
        held[0], *readings = many(held[0], jnp.array(actions), wanted, jax.random.split(own, ENVIRONMENTS))
        jax.block_until_ready(readings)

    return rate(step, ENVIRONMENTS * hold), off


def main():
    found = {}
    for hold in (1, 5):
        env = VppThrustVectorEnv(ENVIRONMENTS, seconds=60.0, noise=(0.13, 5.0), hold=hold, dt=STEP)
        env.reset(seed=0)
        actions = np.random.default_rng(0).uniform(-1.0, 1.0, (ENVIRONMENTS, 2))
        found[f"{ENVIRONMENTS} environments, {hold} plant step{'s' * (hold > 1)} an action"] = rate(
            lambda env=env, actions=actions: env.step(actions), ENVIRONMENTS * hold
        )
    try:
        for hold in (1, 5):
            found[f"the same in JAX, {hold} plant step{'s' * (hold > 1)} an action"], off = in_jax(hold)
        print(f"thrust of both differs by {off:.1e} N at most after 50 actions\n")
    except ImportError as missing:
        print(f"no comparison with JAX: {missing}\n")
    with tempfile.TemporaryDirectory() as folder:
        for name, make in (("native", native_fmu), ("Python", python_fmu)):
            found[f"the {name} FMU under fmpy"] = under_fmpy(make(BASE), Path(folder))
    slowest = found["the native FMU under fmpy"]
    for name, steps in found.items():
        print(
            f"{name:44} {steps / 1e6:9.3f} million plant steps a second, {steps / slowest:7.3g} x the native FMU's under fmpy"
        )


if __name__ == "__main__":
    main()
