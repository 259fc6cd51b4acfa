"""Learned laws: the same bits in all flavours, the network against numpy, limits, the fallback, files, and the command."""

import json
import re
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from builders import Slave

from vpp_fmu.app.cli import main
from vpp_fmu.errors import BadInput
from vpp_fmu.export import native_fmu, python_fmu
from vpp_fmu.fmu import Fmu
from vpp_fmu.gym import VppThrustEnv
from vpp_fmu.kernel.controller import CONTROLLER
from vpp_fmu.kernel.effects.dual_pid import ALLOCATION
from vpp_fmu.kernel.plant import plant
from vpp_fmu.kernel.simulation import Simulation
from vpp_fmu.native.stepper import Stepper
from vpp_fmu.policy import policy_from_arrays, policy_model, read_policy

OBSERVED = ("thrust_set", "thrust", "integral", "omega_ref", "beta_ref")
WIDE = {"thrust_set": 1e3, "thrust": 1e3, "integral": 1e3, "omega_ref": 1e5, "beta_ref": 1e3, "omega": 1e5}
SIZE = {"thrust_set": 15.0, "thrust": 15.0, "integral": 5.0, "omega_ref": 6000.0, "beta_ref": 10.0, "omega": 6000.0}


def arrays(hidden, inputs, seed=0):
    rng, sizes = np.random.default_rng(seed), (inputs, *hidden, 2)
    weights = [rng.normal(size=(b, a)) / np.sqrt(a) for a, b in pairwise(sizes)]
    return weights, [0.3 * rng.normal(size=b) for b in sizes[1:]]


def scaling(observe=OBSERVED, history=0, **more):
    names = [*observe, *["thrust"] * history]
    bounds = {"low": [-WIDE[n] for n in names], "high": [WIDE[n] for n in names]}
    return {"observe": observe, "history": history, "mean": [0.1 * SIZE[n] for n in names]} | {
        "scale": [SIZE[n] for n in names],
        **bounds,
        **more,
    }


def law(hidden=(6, 5), observe=OBSERVED, history=0, seed=0, **more):
    return policy_from_arrays(*arrays(hidden, len(observe) + history, seed), **scaling(observe, history, **more))


def distance_of(count):
    """A distance and the inverse of a full covariance."""
    root = np.random.default_rng(9).normal(size=(count, count))
    return {"precision": np.linalg.inv(np.eye(count) + root @ root.T).tolist(), "distance": 0.9}


CASES = {
    "tanh": law(),
    "relu, history, rates, speed observed": law(
        (4,),
        ("thrust_set", "thrust", "omega"),
        history=2,
        activation="relu",
        action="rate",
        parameters={"omega_rate": 9e3, "beta_rate": 40.0},
    ),
    "linear, squashed, distance": law((), squash=True, **distance_of(5), parameters={"fallback_hold": 0.01}),
}


@pytest.mark.parametrize("name", CASES)
def test_all_flavours_are_the_functions_to_the_bit(name, tmp_path):
    found = CASES[name].parameters()
    (tmp_path / "python.fmu").write_bytes(python_fmu(found.model, found.values))
    (tmp_path / "native.fmu").write_bytes(native_fmu(found.model, found.values))
    slaves = [Slave(Fmu(tmp_path / f"{way}.fmu"), initialised=False) for way in ("python", "native")]
    start = {s.name: 1.0 for s in found.model.inputs}
    exact, compiled = Simulation(found.model, found.values), Stepper(found.model, found.values)
    exact.start(start)
    compiled.start(list(start.values()))
    for slave in slaves:
        slave.initialise(**start)
    rng, outputs, fallbacks = np.random.default_rng(1), [s.name for s in found.model.outputs], set()
    for dt in rng.choice([0.004, 0.006], 300).tolist():
        inputs = {u: float(rng.uniform(0.0, 1.2 * SIZE[u])) for u in start}
        wanted = list(exact.advance(inputs, dt).values())
        assert compiled.step(list(inputs.values()), dt) == wanted
        assert [slave.step(inputs, dt, *outputs) for slave in slaves] == [wanted, wanted]
        fallbacks.add(wanted[-1])
    assert fallbacks == ({0.0, 1.0} if "distance" in name else {0.0})


@pytest.mark.parametrize("action", ["absolute", "rate"])
def test_it_is_the_network_of_numpy_and_the_environments_commands(action):
    """The policy's model controls the environment: its commands equal those that the environment makes of numpy's actions."""
    observe, period = ("thrust_set", "thrust", "omega", "omega_ref", "beta_ref", "integral"), 0.02
    options = {"history": 2, "action": action}
    rates = {"omega_rate": 20000.0, "beta_rate": 75.0} if action == "rate" else {}
    found = law((7, 5), observe, **options, parameters={"sample_time": period, **rates})
    own, env = found.law, VppThrustEnv(observe=observe, seconds=6.0, dt=0.004, hold=5, noise=(0.1, 5.0), **options)
    model = Simulation(found.parameters().model, found.parameters().values)
    seen, _ = env.reset(seed=4)
    model.start(dict(zip(observe[:3], seen[:3], strict=True)))
    for _ in range(env.task.actions):
        z = (seen - own.mean) / own.scale
        for k, (weights, biases) in enumerate(own.layers):
            z = np.array(weights) @ z + biases
            z = np.tanh(z) if k < 2 else z
        commands = model.advance(dict(zip(observe[:3], seen[:3], strict=True)), period)
        seen, _, _, _, shown = env.step(z)
        for name in ("omega_ref", "beta_ref"):
            assert commands[name] == pytest.approx(shown[name], rel=1e-9, abs=1e-9)
    assert commands["fallback"] == 0.0


def test_the_fallback_is_the_dual_pid_and_the_takeover_has_no_bump():
    """The law holds the commands. When the reading leaves the box by a little, the PID continues from them."""
    still = policy_from_arrays(
        [np.zeros((2, 2))],
        [[0.2, -0.4]],  # 4400 rpm, -0.5 deg
        **scaling(("thrust_set", "thrust")) | {"low": [-1.0, -1.0], "high": [20.0, 5.0]},
    )
    model = Simulation(still.parameters().model, still.parameters().values)
    model.start({"thrust_set": 4.0, "thrust": 4.9})
    for _ in range(500):
        held = model.advance({"thrust_set": 4.0, "thrust": 4.9}, 0.004)
    assert held == {"omega_ref": pytest.approx(4400.0), "beta_ref": pytest.approx(-0.5), "fallback": 0.0}
    took_over = model.advance({"thrust_set": 4.0, "thrust": 5.0001}, 0.004)
    assert took_over["fallback"] == 1.0
    # The PID's own answer to 0.0001 N more error and one more sample of the old one: normalised, gains as published.
    e, de, dt = -1.0001 / 15.0, -0.1001 / 15.0, 0.004
    rate, area = 0.2 * de / dt, 0.5 * dt * (e - 0.9 / 15.0)
    assert took_over["omega_ref"] == pytest.approx(4400.0 + 6000.0 * (9.82 * de + 115.3 * area + 0.318 * rate), abs=1e-6)
    # From here it is a PID with the same integrals, for a second, and then the law again.
    pid = Simulation(CONTROLLER)
    pid.start({"thrust_set": 4.0, "thrust": 4.9})
    pid.states = {name: model.states[name] for name in pid.states}
    for _ in range(250):
        inputs = {"thrust_set": 4.0, "thrust": 4.5}
        found, alone = model.advance(inputs, 0.004), pid.advance(inputs, 0.004)
        assert found == alone | {"fallback": 1.0}
    for _ in range(2):
        found = model.advance({"thrust_set": 4.0, "thrust": 4.5}, 0.004)
    assert found == held


def test_the_allocated_law_is_no_fallback():
    law = policy_from_arrays([np.zeros((2, 2))], [[0.0, 0.0]], **scaling(("thrust_set", "thrust")))
    assert not {"mode", "k_mid", "pair_omega_0"} & {p.name for p in law.parameters().model.parameters}
    with pytest.raises(BadInput, match="0 or 1"):
        law.parameters(CONTROLLER.values({"mode": 2.0}))


def test_a_reading_of_nan_activates_the_fallback():
    model = Simulation(CASES["tanh"].parameters().model)
    model.start({"thrust_set": 1.0, "thrust": 1.0})
    assert model.advance({"thrust_set": 1.0, "thrust": float("nan")}, 0.004)["fallback"] == 1.0


def proportional(gain, **more):
    """A law near the plant's static inverse: both commands increase with the set-point, and a little with the error."""
    weights = [[[gain * 2.5, -gain], [gain * 2.5, -gain]]]
    return policy_from_arrays(
        weights, [[-0.7 * gain, -0.7 * gain]], **scaling(("thrust_set", "thrust")) | {"mean": [0.0, 0.0], **more}
    )


@pytest.mark.parametrize("factor", [1.0, 100.0])
def test_with_weights_of_a_hundred_times_the_rig_stays_within_its_limits(factor):
    """The law works as trained. With a hundred times its weights it reaches both limits and exceeds its distance, and the PID
    takes over."""
    covariance = np.array([[1.0, 0.98], [0.98, 1.0]]) * 0.3  # set-point and reading go together
    trained = {"precision": np.linalg.inv(covariance).tolist(), "distance": 2.0, "parameters": {"fallback_hold": 2.0}}
    found = proportional(factor, **trained).parameters()
    model, rig = Simulation(found.model, found.values), Simulation(plant())
    shown = rig.start({"omega_ref": 2000.0, "beta_ref": -5.0})
    model.start({"thrust_set": 1.0, "thrust": shown["thrust"]})
    fallbacks = []
    for k in range(2500):
        wanted = 1.0 + 8.0 * min(k / 1000.0, 1.0)
        commands = model.advance({"thrust_set": wanted, "thrust": shown["thrust"]}, 0.004)
        fallbacks.append(commands.pop("fallback"))
        assert 2000.0 <= commands["omega_ref"] <= 6000.0
        assert -5.0 <= commands["beta_ref"] <= 10.0
        shown = rig.advance(commands, 0.004)
        assert 2000.0 <= shown["omega"] <= 6000.0
        assert 0.0 <= shown["thrust"] <= 15.0
    if factor == 1.0:
        assert not any(fallbacks)
    else:
        assert fallbacks[-1] == 1.0
        assert shown["thrust"] == pytest.approx(9.0, abs=0.01)  # as the PID's integrals have it


def test_a_file_is_the_policy(tmp_path):
    for found in CASES.values():
        back = read_policy(found.save(tmp_path))
        assert (back.law, back.values) == (found.law, found.values)
        assert read_policy(tmp_path).law == found.law


BAD = {
    "format": "vpp-parameters/1",
    "observe": ["torque"],
    "weights": [[[1.0, 2.0]]],
    "biases": [[0.0]],
    "scale": [0.0] * 5,
    "low": [1e9] * 5,
    "mean": ["x"] * 5,
    "activation": "sine",
    "action": "torque",
    "history": -1,
    "precision": [[1.0]],
    "parameters": {"omega_max": 7000.0},
    "surplus": 1,
}


@pytest.mark.parametrize("field", BAD)
def test_a_bad_policy_file_is_refused_in_one_line(field, tmp_path, refused):
    (tmp_path / "policy.json").write_text(json.dumps(CASES["tanh"].to_dict() | {field: BAD[field]}))
    assert "policy.json" in refused("export", "--policy", tmp_path / "policy.json", "-o", tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_layers_that_do_not_fit_are_named():
    weights, biases = arrays((4,), 2)
    for wrong, words in (
        (([weights[0], weights[1][:, :3]], biases), "weights, layer 1: found 2 x 3"),
        (([[*weights[0].tolist()[:-1], [1.0]], weights[1]], biases), "weights, layer 0: found rows of different length"),
        ((weights, [biases[0], [np.nan, 0.0]]), "biases, layer 1: found 2, "),
        ((weights, biases[:1]), "biases: found 1, expected 2 layers"),
    ):
        with pytest.raises(BadInput, match=re.escape(words)):
            policy_from_arrays(*wrong, **scaling(("thrust_set", "thrust")))


def test_the_command_exports_it_and_the_loop_runs(tmp_path, capsys):
    proportional(1.0, parameters={"sample_time": 0.004}).save(tmp_path)
    out = tmp_path / "fmus"
    assert main(["export", "--policy", str(tmp_path), "--flavour", "both", "-o", str(out)]) == 0
    assert {"VppPolicy.fmu", "VppPolicy.native.fmu", "VppPolicy.ssv", "VppLoop.ssp"} <= {p.name for p in out.iterdir()}
    found, controller = Fmu(out / "VppPolicy.native.fmu"), {s.name for s in (*CONTROLLER.inputs, *CONTROLLER.outputs)}
    assert controller | {"fallback"} == {n for n, v in found.variables.items() if v.causality in ("input", "output")}
    assert found.variables["fallback"].type == "Boolean"
    assert {p.name for p in CONTROLLER.parameters} - set(ALLOCATION) <= set(found.variables)
    assert not set(ALLOCATION) & set(found.variables)  # a policy rests on no table of pairs
    (tmp_path / "step.csv").write_text("time,thrust_set\n0,3\n1,9\n3,9\n")
    runs = []
    for suffix in ("", ".native"):
        fmus = [str(out / f"{name}{suffix}.fmu") for name in ("VppPlant", "VppPolicy")]
        assert main(["cosim", *fmus, "--profile", str(tmp_path / "step.csv"), "-o", str(tmp_path / f"loop{suffix}")]) == 0
        runs.append((tmp_path / f"loop{suffix}" / "run.csv").read_text())
    assert runs[0] == runs[1]
    CASES["relu, history, rates, speed observed"].save(tmp_path)
    assert main(["export", "--policy", str(tmp_path), "-o", str(out)]) == 0
    capsys.readouterr()
    fmus = [str(out / "VppPlant.fmu"), str(out / "VppPolicy.fmu")]
    assert main(["cosim", *fmus, "--profile", str(tmp_path / "step.csv"), "-o", str(tmp_path / "loop")]) == 2
    assert "omega" in capsys.readouterr().err


def test_weights_as_parameters_are_the_weights(tmp_path):
    """The form of the search, with weights as parameters, equals the exported one."""
    found = CASES["tanh"]
    values, layers = {}, []
    for k, (weights, biases) in enumerate(found.law.layers):
        rows = [[f"w{k}_{i}_{j}" for j in range(len(row))] for i, row in enumerate(weights)]
        names = [f"b{k}_{i}" for i in range(len(biases))]
        values |= {n: w for own, row in zip(rows, weights, strict=True) for n, w in zip(own, row, strict=True)}
        values |= dict(zip(names, biases, strict=True))
        layers.append((tuple(map(tuple, rows)), tuple(names)))
    named = Simulation(policy_model(replace(found.law, layers=tuple(layers))), values)
    fixed = Simulation(found.parameters().model)
    for each in (named, fixed):
        each.start({"thrust_set": 1.0, "thrust": 1.0})
    for wanted in np.random.default_rng(0).uniform(0.0, 15.0, 50).tolist():
        inputs = {"thrust_set": wanted, "thrust": 4.0}
        assert named.advance(inputs, 0.004) == fixed.advance(inputs, 0.004)
