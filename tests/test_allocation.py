"""Power over speed and pitch, and the pairs of least power: closed forms, C, refusals."""

import csv
import json
import shutil
import subprocess

import fmpy
import numpy as np
import pytest

from identification.assessment.prediction import predict
from identification.power.allocation import allocate
from identification.power.fit import fit_power, steady_readings
from identification.power.model import PowerModel
from vpp_fmu.app.cli import main
from vpp_fmu.campaign import StaticMap, write_static
from vpp_fmu.errors import BadInput
from vpp_fmu.files import OutputFolder
from vpp_fmu.kernel.plant import BASE, plant
from vpp_fmu.native import Simulator
from vpp_fmu.native.closed_loop import ClosedLoop
from vpp_fmu.parameters import ParameterSet, read_parameters, to_json
from vpp_fmu.record import Record, write_record

SCALES = {"omega_scale": 6000.0, "beta_offset": 5.0, "beta_scale": 15.0, "thrust_scale": 15.0}
C21, P30, P32 = 0.8, 40.0, 480.0
BEST = np.sqrt(3.0 * P30 / P32)
"""Thrust 15 c21 w^2 b N takes P30 w^3 + P32 w^3 b^2 W. At a given w^2 b that is least at b^2 = 3 P30 / P32."""


def points(noise=0.0, seed=0, **further):
    """Steady points on a grid; `further` functions of w and b."""
    w, b = (x.ravel() for x in np.meshgrid(np.linspace(0.34, 1.0, 9), np.linspace(-0.3, 1.0, 9)))
    watts = P30 * w**3 + P32 * w**3 * b**2 + noise * np.random.default_rng(seed).standard_normal(len(w))
    columns = {name: function(w, b) for name, function in further.items()} or {"power": watts}
    omega, few = 6000.0 * w, np.full(len(w), 100.0)
    thrust = 15.0 * C21 * w**2 * b
    return StaticMap(omega, 15.0 * b - 5.0, omega, thrust, 0.1 + 0.0 * w, few, "static.csv", columns)


def pitch_only():
    """The plant whose thrust is 15 c21 w^2 b N."""
    return ParameterSet(BASE).replaced({"c20": 0.0, "c11": 0.0, "c21": C21, "c12": 0.0, "c30": 0.0})


def fitted(static):
    """Torque and power of steady points."""
    return fit_power(steady_readings(static, SCALES))


def model(static):
    """Power of that plant by steady points, with its whole covariance."""
    found = fitted(static)
    return PowerModel(found.added_to(pitch_only()), found.names, found.covariance)


def test_the_best_pitch_is_that_of_the_closed_form_within_the_limits_of_speed():
    found = allocate(pitch_only(), model(points()), count=30)
    t = found.thrust / (15.0 * C21)
    w = np.clip(np.sqrt(t / BEST), 1.0 / 3.0, 1.0)  # the paper's rig: 2000 to 6000 rpm
    np.testing.assert_allclose(found.omega, 6000.0 * w, rtol=2e-3)
    np.testing.assert_allclose(found.beta, 15.0 * t / w**2 - 5.0, atol=0.05)
    np.testing.assert_allclose(found.power, P30 * w**3 + P32 * t**2 / w, rtol=1e-5)
    assert np.all(found.power <= np.where(np.isfinite(found.fixed), found.fixed, np.inf) * (1.0 + 1e-6))


FULL = 6000.0 * 2.0 * np.pi / 60.0
"""rad/s at w = 1."""


def torque(w, b):
    return (P30 * w**2 + P32 * w**2 * b**2) / FULL


def test_torque_alone_is_power_of_the_shaft():
    found = fitted(points(torque=torque))
    assert (found.effects, found.names) == (("torque_map",), ("torque_map.q20", "torque_map.q22"))
    np.testing.assert_allclose(found.values, np.array([P30, P32]) / FULL, rtol=1e-9)
    shaft = model(points(torque=torque))
    assert shaft.kind == "shaft"
    assert float(shaft.at(3000.0, 2.5)) == pytest.approx(P30 / 8.0 + P32 / 8.0 * 0.25)


FRICTION, LOSS, IDLE = 0.004, 90.0, 3.0
"""The paper's eqs. 3 and 4 at rest: Q_m omega + R i^2 with k i = Q_m, and the ESC."""


def electrical(w, b):
    driven = torque(w, b) + FRICTION
    return driven * FULL * w + LOSS * driven**2 + IDLE


def test_the_motor_is_found_with_the_error_of_the_cramer_rao_bound():
    """From torque and power together; its 95 % intervals cover the truth."""
    exact = fitted(points(torque=torque, power=electrical))
    assert exact.effects == ("torque_map", "motor")
    assert exact.values[-3:] == pytest.approx([FRICTION, LOSS, IDLE], rel=1e-5)
    grid = points()
    w, b = grid.omega / 6000.0, (grid.beta_ref + 5.0) / 15.0
    truth = np.array([P30 / FULL, P32 / FULL, FRICTION, LOSS, IDLE])
    noise = [0.01 * float(of(w, b).mean()) for of in (torque, electrical)]
    terms, driven = np.column_stack([w**2, w**2 * b**2]), (torque(w, b) + FRICTION)[:, None]
    slope = FULL * w[:, None] + 2.0 * LOSS * driven
    rows = np.hstack([terms, np.zeros((len(w), 3))]), np.hstack([slope * terms, slope, driven**2, np.ones((len(w), 1))])
    information = sum(r.T @ r / s**2 for r, s in zip(rows, noise, strict=True))
    bound, ratios, covered = np.sqrt(np.diag(np.linalg.inv(information))), [], []
    for seed in range(100):
        rng = np.random.default_rng(seed)
        read = [
            lambda w, b, of=of, s=s, rng=rng: of(w, b) + s * rng.standard_normal(len(w))
            for of, s in zip((torque, electrical), noise, strict=True)
        ]
        found = fitted(points(torque=read[0], power=read[1]))
        if found.names == exact.names:
            ratios.append((found.values - truth) / bound)
            covered.append(np.abs(found.values - truth) < 1.96 * np.sqrt(np.diag(found.covariance)))
    assert len(ratios) > 70  # a spurious term passes the BIC by chance
    assert np.sqrt(np.mean(np.square(ratios), axis=0)) == pytest.approx(1.0, abs=4.0 / np.sqrt(2.0 * len(ratios)))
    assert np.mean(covered) == pytest.approx(0.95, abs=4.0 * np.sqrt(0.95 * 0.05 / (5 * len(covered))))


def test_the_plant_with_torque_and_power_has_the_thrust_of_the_plant_without_to_the_bit():
    full = fitted(points(torque=torque, power=electrical)).added_to(pitch_only())
    assert [y.name for y in full.model.outputs[3:]] == ["torque", "power", "efficiency"]
    assert full.without_power.model.outputs == BASE.outputs
    assert full.without_power.with_power_of(full).values == full.values
    assert full.without_power.with_power_of(full).model.outputs == full.model.outputs
    with pytest.raises(ValueError, match="the loop has room for"):
        ClosedLoop(full.model)
    steps = np.full(400, 0.01)
    columns = {"omega_ref": np.repeat([3000.0, 5500.0], 201)[:401], "beta_ref": np.repeat([8.0, 1.0, 4.0], 134)[:401]}
    with_power, without = (Simulator(p.model).simulate(p.values, columns, steps) for p in (full, full.without_power))
    np.testing.assert_array_equal(with_power[:, :3], without)
    w, b = with_power[:, 1] / 6000.0, (with_power[:, 2] + 5.0) / 15.0
    np.testing.assert_allclose(with_power[:, 3:5], np.column_stack([torque(w, b), electrical(w, b)]), rtol=1e-4)


def test_the_power_map_is_identified_from_a_record_alone(tmp_path, printed):
    """In motion the acceleration of the rotor takes power, which the map excludes. Torque beside it identifies no motor."""
    rng, time = np.random.default_rng(0), np.arange(0.0, 60.0, 0.02)
    moves = {"omega_ref": rng.uniform(2500.0, 5800.0, 60), "beta_ref": rng.uniform(-2.0, 10.0, 60)}
    columns = {"time": time} | {name: np.repeat(levels, 50) for name, levels in moves.items()}
    truth = fitted(points(power=lambda w, b: P30 * w**3 + P32 * w**3 * b**2)).added_to(ParameterSet(BASE))
    shown = predict(truth.model, truth.values, Record(columns, "commands"))
    inertia = 2e-4 * np.gradient(shown.omega, time) * shown.omega * (2.0 * np.pi / 60.0) ** 2
    measured = {"thrust": shown.thrust, "omega": shown.omega, "power": shown.further["power"] + inertia}
    noisy = {
        name: values + scale * rng.standard_normal(len(time))
        for (name, values), scale in zip(measured.items(), (0.05, 1.0, 1.0), strict=True)
    }
    noisy["torque"] = 0.8 * noisy["power"] / (shown.omega * 2.0 * np.pi / 60.0)
    write_record(OutputFolder(tmp_path / "campaign"), "open_loop.csv", Record(columns | noisy, "made"))
    assert "no_motor" in printed("identify", tmp_path / "campaign", "--starts", "1", "-o", tmp_path / "out")
    found = read_parameters(tmp_path / "out" / "parameters.json", plant)
    at = np.array([3000.0, 4500.0, 5500.0]), np.array([0.0, 5.0, 9.0])
    told, wanted = PowerModel.of(found), PowerModel.of(truth)
    assert np.all(np.abs(told.at(*at) - wanted.at(*at)) < 0.02 * wanted.at(*at))


@pytest.mark.parametrize(
    ("further", "said"),
    [
        ({"power": lambda w, b: -w}, "more than 0 W"),
        ({"torque": lambda w, b: -w}, "more than 0 N.m"),
        ({"power": lambda w, b: w**3, "torque": lambda w, b: 1000.0 * w**2}, "torque in N.m, power in W"),
    ],
)
def test_impossible_power_or_torque_is_refused(further, said):
    with pytest.raises(BadInput, match=said):
        fitted(points(**further))


def parameters(tmp_path, static):
    """A parameter file with power by steady points."""
    (tmp_path / "parameters.json").write_text(to_json(fitted(static).added_to(pitch_only())))
    return ["allocate", "--parameters", str(tmp_path / "parameters.json"), "-o"]


def test_the_command_writes_table_header_and_report(tmp_path, capsys):
    assert main([*parameters(tmp_path, points()), str(tmp_path / "out")]) == 0
    assert "power saved" in capsys.readouterr().out
    with (tmp_path / "out" / "allocation.csv").open() as file:
        rows = [{k: float(v) for k, v in row.items()} for row in csv.DictReader(file)]
    assert rows[-1]["thrust"] == pytest.approx(15.0 * C21)  # at full speed and the greatest pitch
    assert all(row["power_low"] <= row["power"] <= row["power_high"] for row in rows)
    assert json.loads((tmp_path / "out" / "allocation.json").read_text())["kind"] == "electrical"
    assert "against the best fixed pitch" in (tmp_path / "out" / "report.html").read_text()
    if not (compiler := shutil.which("cc")):
        pytest.skip("no C compiler")
    between = 0.5 * (rows[20]["thrust"] + rows[21]["thrust"])
    body = f'float w, b; vpp_pair({between}f, &w, &b); printf("%g %g", w, b); return 0;'
    source = f'#include <stdio.h>\n#include "allocation.h"\nint main(void) {{ {body} }}\n'
    (tmp_path / "out" / "main.c").write_text(source)
    strict = ["-std=c99", "-Wall", "-Werror"]
    subprocess.run([compiler, *strict, "-o", tmp_path / "pair", tmp_path / "out" / "main.c"], check=True)
    told = subprocess.run([tmp_path / "pair"], check=True, capture_output=True, text=True).stdout.split()
    mean = [0.5 * (rows[20][n] + rows[21][n]) for n in ("omega", "beta")]
    np.testing.assert_allclose([float(x) for x in told], mean, rtol=1e-4)


def test_a_plant_without_power_is_refused_and_nothing_is_written(tmp_path, refused):
    (tmp_path / "parameters.json").write_text(to_json(pitch_only()))
    said = refused("allocate", "--parameters", tmp_path / "parameters.json", "-o", tmp_path / "out")
    assert "torque_map or power_map" in said
    assert "Try: vpp hil campaign --power" in said
    assert not (tmp_path / "out").exists()


def test_a_campaign_with_contradictory_power_is_identified_without_power(tmp_path, printed):
    further = {"power": lambda w, b: w**3, "torque": lambda w, b: 1000.0 * w**2}
    write_static(OutputFolder(tmp_path / "campaign"), points(**further))
    assert "warning power: static.csv, torque, power" in printed("identify", tmp_path / "campaign", "-o", tmp_path / "out")
    assert json.loads((tmp_path / "out" / "parameters.json").read_text())["effects"] == []


def test_the_exported_loop_settles_on_the_pair_of_least_power(tmp_path):
    """In both flavours. The speeds in the controller's table are wrong by 5 %; the pitch is still the best one."""
    words = parameters(tmp_path, points(torque=torque, power=electrical))
    assert main([*words, str(tmp_path / "pairs")]) == 0
    gains = json.loads((tmp_path / "pairs" / "gains.json").read_text())
    for k in range(9):
        gains["parameters"][f"pair_omega_{k}"]["value"] = min(6000.0, 1.05 * gains["parameters"][f"pair_omega_{k}"]["value"])
    (tmp_path / "gains.json").write_text(json.dumps(gains))
    told = ["--parameters", str(tmp_path / "parameters.json"), "--gains", str(tmp_path / "gains.json"), "--flavour", "both"]
    assert main(["export", *told, "-o", str(tmp_path / "fmus")]) == 0
    (tmp_path / "profile.csv").write_text("time,thrust_set\n0,3\n4,6\n24,6\n")
    runs = []
    for kind in ("", ".native"):
        fmus = [str(tmp_path / "fmus" / f"{name}{kind}.fmu") for name in ("VppPlant", "VppController")]
        assert main(["cosim", *fmus, "--profile", str(tmp_path / "profile.csv"), "-o", str(tmp_path / f"run{kind}")]) == 0
        runs.append((tmp_path / f"run{kind}" / "run.csv").read_text())
        names = {v.name for v in fmpy.read_model_description(fmus[0]).modelVariables if v.causality == "output"}
        assert names == {"thrust", "omega", "beta", "torque", "power", "efficiency"}
    assert runs[0] == runs[1]
    last = list(csv.DictReader(runs[0].splitlines()))[-1]
    best = allocate(pitch_only(), model(points(torque=torque, power=electrical)), count=41)
    assert float(last["thrust"]) == pytest.approx(6.0, abs=0.02)
    assert float(last["beta"]) == pytest.approx(np.interp(6.0, best.thrust, best.beta), abs=0.2)
    assert float(last["omega"]) == pytest.approx(np.interp(6.0, best.thrust, best.omega), rel=0.02)


def test_the_allocated_law_is_tuned_for_an_objective(tmp_path, capsys, refused, short_search):
    words = parameters(tmp_path, points())
    (tmp_path / "profile.csv").write_text("time,thrust_set\n0,3\n1,6\n4,6\n")
    common = [*words[1:3], "--profile", str(tmp_path / "profile.csv"), "-o", str(tmp_path / "tuned")]
    assert main(["tune", *common, "--objective", "power"]) == 0
    told = json.loads((tmp_path / "tuned" / "tuning.json").read_text())["controllers"]["allocated"]
    gains = json.loads((tmp_path / "tuned" / "gains.json").read_text())["parameters"]
    best = allocate(pitch_only(), model(points()))
    assert gains["mode"]["value"] == 2
    assert gains["pair_beta_8"]["value"] == pytest.approx(best.beta[-1], abs=0.01)
    assert told["fmu_difference_thrust"] == 0.0
    assert "both actuators on the best pairs" in capsys.readouterr().out
    assert "power or agility" in refused("tune", *common, "--objective", "fast")
    (tmp_path / "parameters.json").write_text(to_json(pitch_only()))
    assert "torque_map or power_map" in refused("tune", *common, "--objective", "power")


def hovering(merit, diameter=0.28, density=1.2):
    """Torque over w and b of the plant of `pitch_only`, for a rotor with this figure of merit."""

    def torque_of(w, b):
        lift = np.maximum(15.0 * C21 * w**2 * b, 0.05)
        return lift**1.5 / np.sqrt(2.0 * density * np.pi * diameter**2 / 4.0) / merit / (FULL * w)

    return torque_of


@pytest.mark.parametrize("declared", [{"diameter": 0.28}, {"diameter": 0.3, "air_density": 1.0}, {}])
def test_the_figure_of_merit_is_ideal_over_real_power_of_a_declared_rotor(tmp_path, declared):
    """Momentum theory: T sqrt(T / (2 rho A)) over torque times speed."""
    density = declared.get("air_density", 1.2)
    folder = OutputFolder(tmp_path / "campaign")
    write_static(folder, points(torque=hovering(0.6, declared.get("diameter", 0.28), density)))
    folder.write("rig.json", json.dumps({"format": "vpp-rig/1", **({"rotor": declared} if declared else {})}))
    assert main(["identify", str(tmp_path / "campaign"), "-o", str(tmp_path / "out")]) == 0
    found = read_parameters(tmp_path / "out" / "parameters.json", plant)
    names = [y.name for y in found.model.outputs]
    assert ("figure_of_merit" in names) == bool(declared)
    if declared:
        commands = {"omega_ref": np.full(2, 4500.0), "beta_ref": np.full(2, 7.0)}
        shown = Simulator(found.model).simulate(found.values, commands, np.array([0.01]))[0]
        assert shown[names.index("figure_of_merit")] == pytest.approx(0.6, rel=0.03)  # the map of torque is a polynomial
        assert main(["allocate", "--parameters", str(tmp_path / "out"), "--points", "5", "-o", str(tmp_path / "pairs")]) == 0
