"""The quality gate: planted faults are found, good data pass, bad rows are left out, unusable data are refused."""

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from builders import refusal
from import_zoo import lagged
from planted_faults import FAULTS, good, planted, said, written

from identification.gate.files import (
    FORCES,
    SPEEDS,
    _pitches,
    as_unit,
    files_of,
    least_diameter,
    pole_pairs,
    said_of_size,
    speed_ratio,
)
from identification.gate.finding import ERROR, KINDS, acceptable
from identification.gate.gate import look, passed
from identification.gate.response import FOLLOWS, Look, Response, Span
from identification.gate.sensors import screen
from identification.gate.synthetic import write_campaign
from identification.gate.template import COLUMNS, FILES
from identification.identify import identify
from identification.static.static_map import TERMS
from vpp_fmu.app.cli import main
from vpp_fmu.campaign import GRID, POWER, Campaign, StaticMap, read_campaign
from vpp_fmu.errors import BadInput
from vpp_fmu.files import OutputFolder
from vpp_fmu.kernel.plant import BASE, FINE_TUNED
from vpp_fmu.native import Simulator
from vpp_fmu.record import QUANTITIES, Record
from vpp_fmu.rig import infer_rig

SHORT = {"1.2 N": 3.0, "15 N": 6.0, "180 N": 16.0}
"""s of a section: enough moves to show a fault, few enough rows to write and read a dozen times."""


@pytest.fixture(scope="module")
def short():
    """A good campaign of each size."""
    return {size: good(size, 0, section) for size, section in SHORT.items()}


@pytest.fixture
def record():
    """20 s of the paper's model with 0.1 N of noise, both commands moving."""
    rng = np.random.default_rng(3)
    time = np.arange(5000) * 0.004
    commands = {"omega_ref": np.repeat(rng.uniform(2500, 5500, 20), 250), "beta_ref": np.repeat(rng.uniform(-4, 9, 20), 250)}
    outputs = Simulator(BASE).simulate({}, commands, np.full(4999, 0.004))
    noisy = outputs[:, 0] + rng.normal(0, 0.1, 5000)
    return Record({"time": time, **commands, "omega": np.round(outputs[:, 1]), "thrust": noisy}, "open_loop.csv")


def campaign_of(record: Record) -> Campaign:
    return Campaign(Path("nowhere"), None, (), record, None, None)


@pytest.mark.sampled("fault")
@pytest.mark.parametrize("fault", FAULTS)
def test_every_planted_fault_is_found(fault, short):
    """Each fault in one size of rig, the sizes in turn."""
    size = list(SHORT)[list(FAULTS).index(fault) % len(SHORT)]
    findings = planted(fault, short[size])
    finding = next((f for f in findings if f.code == FAULTS[fault].code), None)
    assert finding, [f.text for f in findings]
    assert np.isfinite(finding.value)
    assert all((finding.told, finding.cause, finding.advice))
    assert "\n" not in finding.text


@pytest.mark.parametrize("size", SHORT)
def test_good_data_have_no_findings(size, tmp_path):
    assert said(written(good(size, 5), tmp_path), True) == ()


def test_unusable_data_are_refused_in_one_line(record):
    still = record.with_columns(omega_ref=np.full(len(record), 4000.0), beta_ref=np.zeros(len(record)))
    for spoiled, field in ((record.part(slice(0, 2)), "rows"), (still, "omega_ref")):
        told = refusal(identify, campaign_of(spoiled))
        assert [word for word in ("open_loop.csv", field, "found", "expected") if word not in told] == []


def test_clipped_rows_are_left_out_unless_accepted(record):
    """Readings clipped at 8 N would bias the map."""
    clipped = record.with_columns(thrust=np.minimum(record["thrust"], 8.0))
    kept, findings = screen(clipped)
    assert [f.code for f in findings] == ["clipped"]
    left_out = np.isnan(kept["thrust"])
    assert (clipped["thrust"][left_out] == 8.0).all()
    assert left_out.sum() > 0.8 * (clipped["thrust"] == 8.0).sum()
    assert findings[0].value == left_out.sum()
    accepted, again = screen(clipped, frozenset({"clipped"}))
    np.testing.assert_array_equal(accepted["thrust"], clipped["thrust"])
    assert again == findings


@pytest.mark.parametrize("factor", [2.0, 1.0 / 3.0])
@pytest.mark.parametrize("place", [(0, 300), (3100, 3112), (4300, 5000)])
def test_a_speed_that_is_a_multiple_for_a_while_is_left_out(record, factor, place):
    """At the record's start, middle and end; across moves of both commands."""
    stretch = (np.arange(len(record)) >= place[0]) & (np.arange(len(record)) < place[1])
    spoiled = record.with_columns(omega=np.where(stretch, factor, 1.0) * record["omega"])
    kept, findings = screen(spoiled)
    assert [f.code for f in findings] == ["speed_multiple"]
    np.testing.assert_array_equal(np.isnan(kept["omega"]), stretch)
    assert f"{stretch.sum()} readings are {factor:.3g} times" in findings[0].text
    np.testing.assert_array_equal(screen(spoiled, frozenset({"speed_multiple"}))[0]["omega"], spoiled["omega"])


@pytest.mark.parametrize("later", [0, 40])
def test_a_hold_out_record_with_commands_of_a_fitted_one_is_no_unseen_data(short, later):
    """Measured anew, from another moment on; other commands, and those of a repeat, have no such finding."""
    own = short["15 N"]

    def found(campaign):
        return [f for f in look(campaign).findings if f.code == "seen_commands"]

    assert found(own) == []
    noise = np.random.default_rng(5).normal(0.0, 0.1, len(own.open_loop))
    again = own.open_loop.with_columns(thrust=own.open_loop["thrust"] + noise)
    rows = np.maximum(np.arange(len(again)) - later, 0)  # its first commands are held longer
    again = again.with_columns(**{name: again[name][rows] for name in ("omega_ref", "beta_ref", "omega", "thrust")})
    (finding,) = found(replace(own, validation=again, repeat=None))
    assert finding.value > 0.9
    assert "open_loop.csv" in finding.text
    assert "repeat.csv" in finding.text


def test_thrust_in_grams_is_compared_with_the_declared_rotor(record):
    """By T = CT rho n^2 D^4, thrust in gf in place of N needs a rotor of 102^(1/4) = 3.2 times the size."""

    def codes(thrust, rotor):
        rig = replace(infer_rig([record], None, {}), rotor=rotor)
        found = look(replace(campaign_of(record.with_columns(thrust=thrust)), rig=rig)).findings
        return [f.text for f in found if f.code == "thrust_unit"]

    grams = 1000.0 / 9.80665 * record["thrust"]
    assert codes(record["thrust"], {"diameter": 0.28}) == []
    assert codes(grams, {}) == []  # a rotor of 0.9 m would be possible
    (told,) = codes(grams, {"diameter": 0.28})
    assert "rig.json declares 0.28 m" in told
    assert "thrust in gf" in told
    (line,) = said_of_size(files_of(campaign_of(record), {}))
    assert "need a rotor of" in line
    assert 'rig.json, "rotor": {"diameter": D}' in line
    assert "rig.json declares 0.28 m" in said_of_size(files_of(campaign_of(record), {}), 0.28)[0]


def test_a_sensor_with_less_noise_than_its_resolution_is_not_clipped(record):
    """Settled, its readings are constant for a second each time, at the highest level too."""
    quiet = Simulator(BASE).simulate({}, *record.run)[:, 0]
    assert screen(record.with_columns(thrust=np.round(quiet, 1)))[1] == ()


@pytest.mark.parametrize(("noise", "stuck"), [(1.0, True), (0.0, False)])
def test_a_speed_without_its_usual_noise_is_frozen(noise, stuck):
    """Steps of a thirtieth of the range, 35 ms a turn. A sensor without noise shows equal values whenever it is settled."""
    rows, turn = 40_000, 35
    command = 1700.0 + 33.0 * (np.arange(rows) // 2000 % 2) + 1000.0 * (np.arange(rows) > 30_000)
    shown = np.repeat(command[::turn] + noise * np.random.default_rng(0).standard_normal(-(-rows // turn)), turn)[:rows]
    shown[9_000:11_900] = shown[9_000]
    shown[10_000:11_900] += 0.0 if noise else 33.0  # without noise it follows the command once
    columns = {"time": 1e-3 * np.arange(rows), "omega_ref": command, "beta_ref": np.zeros(rows), "omega": shown}
    columns["thrust"] = np.random.default_rng(1).standard_normal(rows)
    findings = screen(Record(columns, "open_loop.csv"))[1]
    assert [(f.code, f.field) for f in findings] == [("frozen", "omega")] * stuck


def test_single_spikes_are_left_out_and_steps_are_not(record):
    thrust = record["thrust"].copy()
    thrust[[700, 2300, 2301]] += 5.0, -4.0, -4.0
    kept, findings = screen(record.with_columns(thrust=thrust))
    assert [(f.code, f.value) for f in findings] == [("spikes", 3)]
    np.testing.assert_array_equal(np.flatnonzero(np.isnan(kept["thrust"])), [700, 2300, 2301])
    steps = np.repeat([1.0, 9.0, 3.0, 8.0, 2.0], 1000) + 0.1 * np.random.default_rng(0).standard_normal(5000)
    assert screen(record.with_columns(thrust=steps))[1] == ()


@pytest.mark.parametrize("every", [200, 30])
def test_lost_pulses_are_left_out_however_many(every):
    """One reading in 30 puts two of 30 differences of neighbours beyond any quantile of the moves."""
    rows = np.arange(6000)
    command = 2000.0 + 3000.0 * (rows // 500 % 2)
    speed = command + 5.0 * np.random.default_rng(0).standard_normal(6000)
    lost = rows[every // 2 :: every]
    speed[lost] = 0.0
    columns = {"time": 0.01 * rows, "omega_ref": command, "beta_ref": np.zeros(6000), "omega": speed}
    record = Record(columns | {"thrust": np.random.default_rng(1).standard_normal(6000)}, "open_loop.csv")
    kept, findings = screen(record)
    assert [(f.code, f.field, f.value) for f in findings] == [("spikes", "omega", len(lost))]
    np.testing.assert_array_equal(np.flatnonzero(np.isnan(kept["omega"])), lost)


def test_rows_after_a_gap_are_left_out(record):
    kept, findings = screen(record.part(np.r_[0:2000, 2250:5000]))
    assert [f.code for f in dict.fromkeys(findings)] == ["gap"]
    assert findings[0].value == pytest.approx(1.004)
    assert np.isnan(kept["thrust"]).sum() == pytest.approx(500, abs=2)


def test_a_record_with_holes_still_gives_its_parameters(record):
    """With a tenth of the cells empty and a gap, all are within 5 standard deviations of the truth."""
    thrust = record["thrust"].copy()
    thrust[::10] = np.nan
    found = identify(campaign_of(record.with_columns(thrust=thrust).part(np.r_[0:2000, 2250:5000])), starts=1)
    assert "gap" in [f.code for f in found.quality]
    for name, std in found.refinement.std.items():
        truth = FINE_TUNED[name] if "beta" not in name else {"tau_beta_1": 0.374, "tau_beta_2": 0.207}[name]
        assert abs(found.refinement.values[name] - truth) < 5 * std + 1e-3, name


def test_a_ratio_is_recognised_as_a_wrong_unit_or_as_pole_pairs():
    assert as_unit(2.0 * np.pi / 60.0, SPEEDS) == ("rad/s", True)
    assert as_unit(60.0 / (2.0 * np.pi), SPEEDS) == ("rad/s", False)
    assert as_unit(1.1 / 9.80665 * 1e3, FORCES) == ("gf", True)
    assert as_unit(0.45359237 * 9.80665, FORCES) == ("lbf", False)
    assert as_unit(1.0, SPEEDS) is None
    assert [pole_pairs(r) for r in (7.001, 6.8, 6.0, 14.2, 2.0, 30.0)] == [7, 7, 6, 14, 2, 30]
    assert [pole_pairs(r) for r in (1.0, 1.02, 2.5, 30.0 / np.pi, 60.0, 1.0 / 7.0, 31.0)] == [None] * 7
    assert as_unit(0.8, FORCES) is None


def test_the_least_diameter_is_that_of_the_largest_thrust_coefficient():
    """T = C_T rho n^2 D^4 with C_T = 0.4, rho = 1.225 kg/m^3: 49 N at 6000 rpm, n = 100 / s, are D = 0.3162 m."""
    grid = np.repeat([3000.0, 6000.0], 10), np.tile(np.linspace(0.0, 9.0, 10), 2)
    thrust = 4.9 * (grid[0] / 6000.0) ** 2 * (1.0 + grid[1])
    static = StaticMap(*grid, grid[0], thrust, 0.1 + 0.0 * thrust, 100.0 + 0.0 * thrust, "static.csv")
    (file,) = files_of(Campaign(Path("nowhere"), static, (), None, None, None), {})
    force, rpm, diameter = least_diameter(file)
    assert (force, rpm) == (pytest.approx(49.0), 6000.0)
    assert diameter == pytest.approx(0.1**0.5)


def test_the_first_look_finds_lag_and_slopes_whatever_the_units(record):
    """One lag of 40 rows on speed and of 100 on pitch, thrust = w^2 (1 + b) in any unit."""
    speed, pitch = lagged(record["omega_ref"], 1.0, 40.0), lagged(record["beta_ref"], 1.0, 100.0)
    thrust = (speed / 6000.0) ** 2 * (1.0 + (pitch + 5.0) / 15.0)
    for factor, time in ((1.0, 1.0), (102.0, 1e3), (-0.2, 1e6)):
        made = record.with_columns(thrust=factor * thrust, time=time * record.time)
        r = Look([made]).response()
        assert r.explained > 0.99
        assert r.lags["omega"] == pytest.approx(40.0, rel=0.3)
        assert r.lags["beta"] == pytest.approx(100.0, rel=0.3)
        assert r.row == pytest.approx(0.004 * time)
        assert np.sign([r.rise("omega"), r.rise("beta")]).tolist() == [np.sign(factor)] * 2
    still = Look([record.with_columns(beta_ref=np.zeros(len(record)), thrust=speed)]).response()
    assert still.rise("beta") is None


def test_accepting_one_error_does_not_accept_another(short):
    spoilt = FAULTS["thrust with its sign flipped"].change(short["15 N"], None)
    with pytest.raises(BadInput, match="--accept thrust_sign"):
        passed(spoilt)
    through = passed(spoilt, accept=["thrust_sign"])
    assert {f.code for f in through.findings} == {"thrust_sign"}
    assert all(f.level != ERROR and f.accepted for f in through.findings)
    with pytest.raises(BadInput, match="thrust_sign"):
        passed(spoilt, accept=["time_unit"])


def test_findings_that_cannot_be_accepted_are_refused(short):
    for code in ("thrust_dead", "thin", "no_such_code"):
        with pytest.raises(BadInput, match=f"--accept: found {code}"):
            look(short["15 N"], accept=[code])
    assert set(acceptable()) < set(KINDS)


def test_identify_and_diagnose_refuse_in_the_same_line(short, tmp_path, capsys):
    write_campaign(OutputFolder(tmp_path / "bad"), FAULTS["time in ms"].change(short["15 N"], None))
    told = []
    for verb in ("identify", "diagnose"):
        assert main([verb, str(tmp_path / "bad"), "-o", str(tmp_path / "out")]) == 2
        told.append(capsys.readouterr().err.splitlines()[-1].removeprefix(f"vpp {verb}: "))
    assert told[0] == told[1]
    assert [word for word in ("open_loop.csv", "time", "time in ms", "--accept time_unit") if word not in told[0]] == []
    assert not (tmp_path / "out" / "parameters.json").exists()


def test_diagnose_fits_the_records_without_the_rows_that_the_gate_removes(short, monkeypatch):
    from identification.diagnose import diagnose as module

    class Seen(Exception):
        pass

    def stop(campaign, more):
        raise Seen(np.isnan(campaign.open_loop["thrust"]).sum())

    monkeypatch.setattr(module, "roles", stop)
    with pytest.raises(Seen) as seen:
        module.diagnose(FAULTS["thrust clipped"].change(short["15 N"], None))
    assert seen.value.args[0] > 50


def test_a_hold_out_record_that_is_too_short_is_refused(short):
    """Fewer than 20 rows or 2 s. A record at rest is accepted, as it is not fitted, and so are 15 s at 10 Hz."""
    own = short["15 N"]
    for rows in (2, 5, 199):
        with pytest.raises(BadInput, match=f"validation.csv: rows: found {rows} rows"):
            passed(replace(own, validation=own.validation.part(slice(0, rows))))
    ordered = {name: np.full(len(own.validation), own.validation[name][0]) for name in ("omega_ref", "beta_ref")}
    slow = replace(own.validation, columns={name: column[::25] for name, column in own.validation.columns.items()})
    assert 20 < len(slow) < 200
    for unseen in (own.validation.with_columns(**ordered), slow):
        assert not {"no_move", "too_short"} & {f.code for f in look(replace(own, validation=unseen)).findings}


def test_check_prints_files_rig_and_findings_and_says_how_it_ended(short, tmp_path, printed, capsys):
    folder = tmp_path / "bad"
    spoilt = replace(FAULTS["records' thrust in gf"].change(short["15 N"], None), validation=None)
    write_campaign(OutputFolder(folder), spoilt)
    assert main(["check", str(folder), "-o", str(tmp_path / "out")]) == 2
    out, err = capsys.readouterr()
    assert err.count("\n") == 1
    assert "thrust_unit" in err
    for word in ("missing validation.csv", "missing rig.json", "rig: speed 2000 to 6000 rpm", "error thrust_unit", "steps.csv"):
        assert word in out
    content = json.loads((tmp_path / "out" / "check.json").read_text(), parse_constant=pytest.fail)
    assert content["errors"] == sum(f["level"] == "error" for f in content["quality"]) > 0
    files = {f["file"]: f for f in content["files"]}
    assert files["open_loop.csv"]["rows"] == len(spoilt.open_loop)
    assert files["open_loop.csv"]["rate"] == pytest.approx(250.0)
    assert files["static.csv"]["columns"]["omega_ref"] == {"unit": "rpm", "min": 2000.0, "max": 6000.0, "empty": 0}
    assert "warning thrust_unit (accepted)" in printed("check", folder, "--accept", "thrust_unit")


def test_the_template_is_read_back_clean_and_explains_every_column(tmp_path, printed, capsys):
    folder = tmp_path / "mine"
    assert main(["check", "--template", str(folder)]) == 0
    assert {p.name for p in folder.iterdir()} == {*FILES, "README.md"}
    assert sum(p.stat().st_size for p in folder.iterdir()) < 80_000
    capsys.readouterr()
    out = printed("check", folder)
    assert "quality: nothing found" in out
    assert "missing" not in out
    explained = (folder / "README.md").read_text()
    campaign = read_campaign(folder)
    used = {*campaign.open_loop.columns, *campaign.steps[0].columns, "run", *GRID, *POWER}
    for name in used | set(FILES):
        assert f"`{name}`" in explained, name
    for name in set(COLUMNS) & set(QUANTITIES):
        assert f"| `{name}` | {QUANTITIES[name].unit} |" in explained
    assert main(["identify", str(folder), "--starts", "1", "-o", str(tmp_path / "out")]) == 0
    said_of_it = json.loads((tmp_path / "out" / "identification.json").read_text())
    assert said_of_it["quality"] == []
    assert said_of_it["fit_thrust"]["validation"] > 90.0


def test_the_unit_of_pitch_is_not_judged_if_the_blades_hardly_move():
    """A map rotated about the only pitch fits as well as the true one, and has an arbitrary slope."""
    rng, n, turned = np.random.default_rng(0), 2000, 40.0
    span = Span((2500.0, 5500.0), (8.9, 9.9))
    omega, beta = rng.uniform(*span.speed, n), 9.9 - 0.1 * np.abs(rng.standard_normal(n))
    thrust = 15.0 * (omega / 5500.0) ** 2 + rng.normal(0.0, 0.3, n)
    coefficients = np.zeros(6)
    coefficients[1 + list(TERMS).index("c20")] = 15.0 - turned * np.mean(beta - 8.9)
    coefficients[1 + list(TERMS).index("c21")] = turned
    response = Response(span, omega, beta, thrust, coefficients, {"omega": 0.0, "beta": 0.0}, 0.004)
    assert response.explained > FOLLOWS
    assert response.rise("beta") > np.ptp(np.quantile(beta, [0.1, 0.9])) * response.size  # as if all lay within a degree
    file = SimpleNamespace(response=response, where="open_loop.csv", column=lambda name: beta)
    assert list(_pitches([file])) == []
    file.response = replace(response, thrust=response.at(omega, beta) + rng.normal(0.0, 0.3, n))  # that map is the true one
    assert [finding.code for finding in _pitches([file])] == ["pitch_unit"]


@pytest.mark.parametrize(("middle", "codes"), [(-1.35, []), (0.05, ["pitch_unit"])])
def test_a_nearly_constant_pitch_is_in_rad_only_if_degrees_are_beyond_the_other_files(middle, codes):
    """0.3 of a range of 14.5 about -1.35: that many rad would be -77 deg, far from the other file's -5.5 to 9 deg."""
    files = [
        SimpleNamespace(response=None, where=where, column=lambda name, ends=ends: np.linspace(*ends, 50))
        for where, ends in (("static.csv", (-5.5, 9.0)), ("validation.csv", (middle - 0.13, middle + 0.13)))
    ]
    assert [finding.code for finding in _pitches(files)] == codes


@pytest.mark.parametrize("command", [0.0, -4000.0, 1e-310])
def test_commands_next_to_zero_have_no_ratio_of_speeds(command):
    assert speed_ratio(np.full(9, 4000.0), np.full(9, command)) is None
