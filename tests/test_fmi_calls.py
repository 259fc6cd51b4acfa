"""Calls as importers in C make them: out of order or with bad arguments, in a host without Python, of derivatives, in threads,
and at random under the sanitizers."""

import sys
import threading
from pathlib import Path

import misuse
import numpy as np
import pytest
from builders import ALL_ON, MODELS, PROBES, Slave, native, needs_compiler, random_steps, simulator
from fuzz import fuzz, fuzzer

from tests.interop import hosts
from vpp_fmu.app.cli import main
from vpp_fmu.export import python_fmu
from vpp_fmu.fmu import Fmu, FmuInstance

pytestmark = needs_compiler
OUTPUTS = ["thrust", "omega", "beta"]


@pytest.fixture(scope="module")
def paths(tmp_path_factory):
    """Paths of the FMUs, by flavour and name."""
    folder, found = tmp_path_factory.mktemp("calls"), {"native": {}, "python": {}}
    for name, (model, values) in MODELS.items():
        for flavour, content in (("native", native(name)), ("python", python_fmu(model, values))):
            found[flavour][name] = folder / f"{name}.{flavour}.fmu"
            found[flavour][name].write_bytes(content)
    return found


@pytest.fixture(scope="module")
def fmus(paths):
    """Native FMUs by name, unpacked."""
    unpacked = {name: Fmu(path) for name, path in paths["native"].items()}
    yield unpacked
    for fmu in unpacked.values():
        fmu.close()


@pytest.fixture(scope="module")
def outcomes(paths):
    """Outcomes of all cases of misuse, by flavour."""
    return {flavour: misuse.outcomes(files) for flavour, files in paths.items()}


def test_no_process_dies(outcomes):
    assert {flavour: len(cases) for flavour, cases in outcomes.items()} == dict.fromkeys(outcomes, len(misuse.CASES))


@pytest.mark.parametrize("number", range(len(misuse.CASES)), ids=[case.name for case in misuse.CASES])
def test_both_flavours_answer_misuse_alike(outcomes, number):
    assert not misuse.verdict(misuse.CASES[number], outcomes["native"][number], outcomes["python"][number])


@pytest.fixture(scope="module")
def host(tmp_path_factory):
    if sys.platform != "linux":
        pytest.skip("the host is Linux's")
    return hosts.built(tmp_path_factory.mktemp("host"))


@pytest.mark.parametrize("name", ["plain", "controller"])
def test_the_readmes_three_lines_bring_python_into_a_host_in_c(host, name, paths, fmus):
    """Without these lines the Python FMU can't be loaded; with them it gives the native FMU's numbers to the last bit."""
    python = Fmu(paths["python"][name])
    refused = hosts.in_c(host, python)
    assert refused.returncode == 2
    assert "undefined symbol: _Py_" in refused.stderr
    compiled = hosts.in_c(host, fmus[name])
    assert (compiled.returncode, compiled.stderr) == (0, "")
    assert any(float(x) for x in compiled.stdout.split())
    lines = hosts.three_lines()
    assert len(lines.splitlines()) == 3
    if lacks := hosts.no_libpython():
        pytest.skip(lacks)
    done = hosts.in_c(host, python, lines)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout == compiled.stdout


@pytest.mark.parametrize(("flavour", "points"), [("python", True), ("native", False), ("both", False)])
def test_the_export_points_hosts_without_python_to_the_native_flavour(flavour, points, tmp_path, capsys):
    assert main(["export", "--flavour", flavour, "-o", str(tmp_path)]) == 0
    assert ("--flavour native" in capsys.readouterr().out) == points


def test_no_instance_without_the_arguments_that_the_standard_requires(fmus):
    fmu = fmus["plain"]
    raw = misuse.Host(Path(fmu.folder), fmu.library, logging=0)
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
