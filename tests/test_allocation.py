"""Power over speed and pitch, and the pairs of least power: closed forms, C, refusals."""

import csv
import json
import shutil
import subprocess

import numpy as np
import pytest

from identification.power.allocation import allocate
from identification.power.power_map import power_map
from vpp_fmu.app.cli import main
from vpp_fmu.campaign import StaticMap, read_static, write_static
from vpp_fmu.errors import BadInput
from vpp_fmu.files import OutputFolder
from vpp_fmu.kernel.plant import BASE
from vpp_fmu.parameters import ParameterSet, to_json

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


def test_the_best_pitch_is_that_of_the_closed_form_within_the_limits_of_speed():
    found = allocate(pitch_only(), power_map(points(), SCALES), count=30)
    t = found.thrust / (15.0 * C21)
    w = np.clip(np.sqrt(t / BEST), 1.0 / 3.0, 1.0)  # the paper's rig: 2000 to 6000 rpm
    np.testing.assert_allclose(found.omega, 6000.0 * w, rtol=2e-3)
    np.testing.assert_allclose(found.beta, 15.0 * t / w**2 - 5.0, atol=0.05)
    np.testing.assert_allclose(found.power, P30 * w**3 + P32 * t**2 / w, rtol=1e-5)
    assert np.all(found.power <= np.where(np.isfinite(found.fixed), found.fixed, np.inf) * (1.0 + 1e-6))


def test_the_terms_are_found_and_their_errors_are_those_of_independent_maps():
    fits = [power_map(points(noise=3.0, seed=k), SCALES) for k in range(60)]
    own = [f for f in fits if f.terms == ((3, 0), (3, 2))]
    assert len(own) > 0.7 * len(fits)  # a spurious term passes the BIC with probability 0.04 each, by chance
    at = 5000.0, 3.0
    w, b = 5000.0 / 6000.0, 8.0 / 15.0
    errors = [(float(f.at(*at)) - P30 * w**3 - P32 * w**3 * b**2) / float(f.std(*at)) for f in own]
    assert np.std(errors) == pytest.approx(1.0, abs=3.0 / np.sqrt(2.0 * len(own)))


def test_the_band_of_the_least_power_is_that_of_repeated_measurements():
    """By the envelope theorem; here from maps of other noise, each with its own best pairs."""
    least = [allocate(pitch_only(), power_map(points(3.0, k), SCALES), count=5) for k in range(25)]
    spread = np.std([f.power for f in least], axis=0, ddof=1)
    told = np.mean([f.power_std for f in least], axis=0)
    assert np.all(np.abs(np.log(spread / told)) < np.log(2.0))  # 25 draws: 15 % of one standard error


def test_a_weight_buys_reserve_with_power():
    """Power that hardly grows with pitch asks for the greatest pitch, from which pitch adds no thrust."""
    power = power_map(points(power=lambda w, b: P30 * w**3 * (1.0 + b**2)), SCALES)
    frugal, agile = (allocate(pitch_only(), power, weight) for weight in (0.0, 0.7))
    assert np.all(agile.power >= frugal.power * (1.0 - 1e-9))
    assert np.all(agile.reserve >= frugal.reserve - 1e-9)
    assert np.max(agile.reserve - frugal.reserve) > 1.0


def test_torque_is_shaft_power_and_volts_times_amperes_are_electrical():
    def torque(w, b):
        return (P30 * w**2 + P32 * w**2 * b**2) / (6000.0 * 2.0 * np.pi / 60.0)

    shaft = power_map(points(torque=torque), SCALES)
    assert (shaft.kind, shaft.terms) == ("shaft", ((3, 0), (3, 2)))
    np.testing.assert_allclose(shaft.coefficients, (P30, P32), rtol=1e-9)
    electrical = power_map(points(voltage=lambda w, b: 600.0 + 0.0 * w, current=lambda w, b: w**3, torque=torque), SCALES)
    assert (electrical.kind, electrical.terms) == ("electrical", ((3, 0),))


@pytest.mark.parametrize(
    ("further", "said"),
    [
        ({"current": lambda w, b: w}, "power, or voltage and current, or torque"),
        ({"power": lambda w, b: -w}, "more than 0 W"),
        ({"power": lambda w, b: w**3, "torque": lambda w, b: 1000.0 * w**2}, "in N.m, W, V, A"),
    ],
)
def test_what_cannot_be_power_is_refused(further, said):
    with pytest.raises(BadInput, match=said):
        power_map(points(**further), SCALES)


def campaign(tmp_path, static):
    write_static(OutputFolder(tmp_path / "campaign"), static)
    (tmp_path / "parameters.json").write_text(to_json(pitch_only()))
    return ["allocate", str(tmp_path / "campaign"), "--parameters", str(tmp_path / "parameters.json"), "-o"]


def test_the_command_writes_table_header_and_report(tmp_path, capsys):
    assert main([*campaign(tmp_path, points()), str(tmp_path / "out")]) == 0
    assert "power saved" in capsys.readouterr().out
    with (tmp_path / "out" / "allocation.csv").open() as file:
        rows = [{k: float(v) for k, v in row.items()} for row in csv.DictReader(file)]
    assert rows[-1]["thrust"] == pytest.approx(15.0 * C21)  # at full speed and the greatest pitch
    assert all(row["power_low"] <= row["power"] <= row["power_high"] for row in rows)
    assert json.loads((tmp_path / "out" / "allocation.json").read_text())["power_map"]["kind"] == "electrical"
    assert "equal thrust" in (tmp_path / "out" / "report.html").read_text()
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


def test_optional_columns_of_the_static_map_are_kept(tmp_path):
    path = write_static(OutputFolder(tmp_path), points())
    np.testing.assert_allclose(read_static(path).further["power"], points().further["power"], rtol=1e-8)


def test_a_campaign_without_power_is_refused_and_nothing_is_written(tmp_path, capsys):
    assert main([*campaign(tmp_path, points(current=lambda w, b: w)), str(tmp_path / "out")]) == 2
    assert len(capsys.readouterr().err.splitlines()) == 1
    assert not (tmp_path / "out").exists()
