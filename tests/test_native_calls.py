"""The C interface of the native FMU: instances, derivatives, threads, and random calls under the sanitizers."""

import threading
from pathlib import Path

import numpy as np
import pytest
from builders import ALL_ON, MODELS, PROBES, Slave, native, needs_compiler, random_steps, simulator
from fuzz import fuzz, fuzzer
from misuse import Host

from vpp_fmu.fmu import Fmu, FmuInstance

pytestmark = needs_compiler
OUTPUTS = ["thrust", "omega", "beta"]


@pytest.fixture(scope="module")
def fmus(tmp_path_factory):
    """Native FMUs by name, unpacked."""
    folder, unpacked = tmp_path_factory.mktemp("native"), {}
    for name in MODELS:
        (folder / f"{name}.fmu").write_bytes(native(name))
        unpacked[name] = Fmu(folder / f"{name}.fmu")
    yield unpacked
    for fmu in unpacked.values():
        fmu.close()


def test_no_instance_without_the_arguments_that_the_standard_requires(fmus):
    fmu = fmus["plain"]
    raw = Host(Path(fmu.folder), fmu.library, logging=0)
    for bad, word in (({"guid": b"{0}"}, "found {0}, expected {"), ({"kind": 0}, "co-simulation"), ({"name": b""}, "name")):
        assert not raw.instantiate(**bad)
        assert word in raw.said[-1][2]
    assert not raw.instantiate(guid=b"{0}", callbacks=False)


def derivative(slave, unknowns, knowns, moves):
    return slave.fmi.getDirectionalDerivative(
        [slave.references[n] for n in unknowns], [slave.references[n] for n in knowns], list(moves)
    )


@pytest.mark.parametrize("name", MODELS)
def test_derivatives_at_the_start_are_differences(fmus, name):
    """Of outputs and states with respect to inputs and parameters, one by one and along a mixed direction."""
    model = MODELS[name][0]
    # At no limit of the controller, and at no jump of a command that is executed in steps.
    inputs = {u.name: (0.424 - 0.05 * k) * u.nominal for k, u in enumerate(model.inputs)}
    values = model.values(MODELS[name][1]) | inputs
    unknowns = [*(s.name for s in model.outputs), *(f"state.{x.name}" for x in model.states)]
    sizes = {q.name: 1e-5 * max(abs(values[q.name]), 1e-3 * q.nominal) for q in (*model.inputs, *model.parameters)}

    def settled(**changes):
        slave = Slave(fmus[name], initialised=False).enter(**{**values, **changes})
        found = np.array(slave.get(*unknowns))
        slave.free()
        return found

    slave = Slave(fmus[name], initialised=False).enter(**values)
    total, size = 0.0, np.maximum(np.abs(settled()), 1.0)
    for known, h in sizes.items():
        found = np.array(derivative(slave, unknowns, [known], [1.0]))
        difference = (settled(**{known: values[known] + h}) - settled(**{known: values[known] - h})) / (2.0 * h)
        np.testing.assert_allclose(found, difference, rtol=1e-4, atol=1e-9 * size.max() / h, err_msg=known)
        total = total + found * h
    np.testing.assert_allclose(derivative(slave, unknowns, list(sizes), sizes.values()), total, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("name", ["plain", "all_on"])
def test_derivatives_at_communication_points_are_the_simulators(fmus, name):
    model, values = MODELS[name]
    wrt = tuple(p.name for p in model.parameters)[:: 1 if name == "plain" else 7]  # all take half a minute to compile
    inputs, steps = random_steps(400, 40, model=model), np.full(399, 0.0037)
    exact = simulator(model, wrt).sensitivities(values, inputs, steps)[1]
    slave = Slave(fmus[name], initialised=False).enter(**{n: float(column[0]) for n, column in inputs.items()})
    derivative(slave, OUTPUTS, wrt[:1], [1.0])
    slave.fmi.exitInitializationMode()
    size = np.abs(exact).max(axis=0) + 1e-12
    for row in range(400):
        found = np.array([derivative(slave, OUTPUTS, [p], [1.0]) for p in wrt]).T
        assert (np.abs(found - exact[row]) <= 1e-9 * size).all()
        if row % 50 == 20:  # sensitivities are part of the state
            slave.fmi.setFMUstate(slave.fmi.deSerializeFMUstate(slave.fmi.serializeFMUstate(slave.fmi.getFMUstate())))
        if row < 399:
            slave.step({n: float(column[row]) for n, column in inputs.items()}, 0.0037)


def test_threads_with_instances_of_their_own_do_not_mix(fmus):
    """8 threads step 8 instances each, all with other parameters; the foreign calls run at the same time."""
    fmu, steps = fmus["all_on"], 300
    taus = np.linspace(0.05, 0.6, 64)
    inputs = random_steps(steps + 1, 20, model=ALL_ON)
    rows = np.column_stack(list(inputs.values())).tolist()
    instances = [FmuInstance(fmu, list(inputs), OUTPUTS, {"tau_omega_1": float(tau)}) for tau in taus]
    shown: dict[int, list] = {}

    def work(thread):
        mine = range(8 * thread, 8 * thread + 8)
        for i in mine:
            instances[i].start(rows[0])
        steppers = [(i, instances[i].stepper(0.004)) for i in mine]
        for row in rows[:-1]:
            for i, step in steppers:
                shown[i] = step(row)

    threads = [threading.Thread(target=work, args=(k,)) for k in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    for i in range(0, 64, 9):
        exact = simulator(ALL_ON).simulate({**PROBES, "tau_omega_1": float(taus[i])}, inputs, np.full(steps, 0.004))
        assert shown[i] == exact[-1].tolist()


@pytest.mark.parametrize(
    ("name", "version", "calls"), [("plain", "2.0", 3000), ("controller", "2.0", 3000), ("controller", "3.0", 10_000)]
)
def test_no_sequence_of_calls_crashes_it(name, version, calls, tmp_path):
    program, _ = fuzzer(tmp_path, *MODELS[name], version)  # where there are no sanitizers, a crash still shows
    for seed in (1, 2, 3):
        done = fuzz(program, seed, calls)
        assert done.returncode == 0, done.stderr[-2000:]
