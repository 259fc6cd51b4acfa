"""Incomplete and unusual campaigns: identifiable parameters are identified, the others are named, and no verb ends otherwise
than with its files or one line. The truth is the model of three sizes of synthetic rigs."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from planted_faults import SIZES, written

from identification.assessment.prediction import Prediction
from identification.assessment.reading_noise import reading_noise
from identification.fit.noise import noise_from
from identification.gate.synthetic import write_campaign
from identification.identify import identify
from identification.steps.response import covariance
from vpp_fmu.app.cli import main
from vpp_fmu.app.report.pages.identification import IdentifyResult, not_identifiable, remarks
from vpp_fmu.campaign import Campaign
from vpp_fmu.files import OutputFolder
from vpp_fmu.kernel.plant import BASE, FINE_TUNED
from vpp_fmu.record import Record, read_record, write_record

SECTIONS = {"1.2 N": 5.0, "15 N": 14.0, "180 N": 30.0}
"""s of a section of moves."""

LAGS = ("tau_omega_1", "tau_omega_2", "tau_beta_1", "tau_beta_2")
MAP = ("c20", "c11", "c21", "c12", "c30")
LONG = ("open_loop", "repeat", "validation")

FAR = 5.0
"""Allowed error of an identifiable parameter in standard deviations: by chance one of two million exceeds it."""


def scales_of(size):
    scales = SIZES[size].scales
    return {n: getattr(scales, n) for n in ("omega_scale", "beta_scale", "beta_offset", "thrust_scale")}


class Made:
    """A whole campaign of a rig, and changes to it."""

    def __init__(self, size: str):
        self.size, self.rng = size, np.random.default_rng(4)
        self.rig = replace(SIZES[size], section=SECTIONS[size])
        self.truth = BASE.sized(self.rig.scales).values(self.rig.values)
        self.campaign = self.rig.campaign(self.rng, Path(size))

    def only(self, *names: str) -> "Made":
        """Keep these files."""
        for name in {"static", "steps", *LONG} - set(names):
            self.campaign = replace(self.campaign, **{name: () if name == "steps" else None})
        return self

    def commanded(self, names=LONG[:2], rows=slice(None), **given: float) -> "Made":
        """Measure long records anew, with constant commands, and without the others."""
        orders = self.rig.orders(self.rng)
        orders = {n: (np.full(len(c), given[n]) if n in given else c)[rows] for n, c in orders.items()}
        self.campaign = replace(self.campaign, validation=None)
        return self.with_records(**{n: self.rig.record(orders, self.rng, f"{n}.csv") for n in names})

    def with_records(self, **records: Record) -> "Made":
        self.campaign = replace(self.campaign, **records)
        return self

    def with_static(self, count: int, **ends) -> "Made":
        """Other steady points: `count` a range, ends of the ranges."""
        self.campaign = replace(self.campaign, static=replace(self.rig, grid=count, **ends).steady(self.rng))
        return self

    def changed(self, names=LONG, **columns) -> "Made":
        """Long records with columns changed by functions of (values, record)."""
        for name in names:
            if (record := getattr(self.campaign, name)) is not None:
                moved = {n: change(record[n].copy(), record) for n, change in columns.items()}
                self.with_records(**{name: record.with_columns(**moved)})
        return self

    def read(self, folder: Path) -> Campaign:
        """The campaign after its files were written and read again, with declared scales."""
        return written(self.campaign, folder, {"scales": scales_of(self.size)})

    def pulls(self, found) -> np.ndarray:
        """Errors of identifiable parameters in standard deviations."""
        known = found.uncertainty
        own = [k for k, name in enumerate(known.names) if name not in found.not_identifiable]
        return np.array([(known.values[k] - self.truth[known.names[k]]) / known.std[k] for k in own])


@pytest.mark.parametrize("size", SIZES)
def test_steady_points_alone_give_the_map_and_name_the_lags(size, tmp_path):
    made = Made(size).only("static")
    found = identify(made.read(tmp_path))
    assert found.refinement is None
    assert found.uncertainty.names == MAP
    assert np.abs(made.pulls(found)).max() < FAR
    assert tuple(found.not_identifiable) == LAGS
    assert all("no record to fit" in why for why in found.not_identifiable.values())
    entries = found.parameters.estimates
    assert {n for n, e in entries.items() if e.std is None} >= set(LAGS)
    assert all(entries[n].std > 0.0 for n in MAP)
    assert found.parameters.values["tau_beta_1"] in (FINE_TUNED["tau_beta_1"], FINE_TUNED["tau_beta_2"])  # the default


def test_steps_beside_steady_points_give_the_lags_as_well(tmp_path):
    made = Made("180 N").only("static", "steps")
    found = identify(made.read(tmp_path))
    assert set(found.uncertainty.names) == {*LAGS, *MAP}
    assert not found.not_identifiable
    assert np.abs(made.pulls(found)).max() < FAR
    content = found.summary()
    assert content["cost_final"] is content["residual_tests"] is None
    assert content["rmse_thrust"] == {}
    matrix, names = np.array(content["correlation"]["matrix"]), content["correlation"]["names"]
    one, other = names.index("tau_beta_1"), names.index("c21")
    assert matrix[one, other] == 0.0
    assert matrix[one, names.index("tau_beta_2")] < 0.0  # their sum is known better than either
    page = IdentifyResult(found).page().html()
    assert "How well the model predicts" not in page
    assert "The step responses" in page
    figures = IdentifyResult(found).key_figures()
    assert ("identifiable parameters", "9 of 9", "all fitted parameters") in figures
    (value,) = [value for label, value, _ in figures if label == "fit of the static map"]
    assert value == f"adjusted R² {found.static.r2_adjusted:.4f}"


@pytest.mark.parametrize("files", [("repeat",), ("validation",), ("open_loop", "validation")])
def test_a_single_record_is_fitted_and_not_called_unseen(files, tmp_path):
    made = Made("15 N").only(*files)
    found = identify(made.read(tmp_path), starts=1)
    assert (found.fitted, found.unseen) == (files[:1], files[1:])
    assert np.abs(made.pulls(found)).max() < FAR
    assert any("no hold-out record" in line for line in remarks(found)) == (len(files) == 1)


def test_a_pitch_that_never_moved_is_named_whatever_the_steady_points_are(tmp_path):
    made = Made("1.2 N").only().commanded(beta_ref=4.0).with_static(6, pitch=(4.0, 4.0))
    found = identify(made.read(tmp_path / "one"), starts=1)
    assert {"tau_beta_1", "tau_beta_2", "c21", "c12"} <= set(found.not_identifiable)
    assert found.not_identifiable["c21"] == "the data identify only its combination with c20"
    assert found.not_identifiable["c12"] == "the data identify only its combination with c11"
    assert any(line.startswith("not identifiable from these data: c21 (stays at ") for line in not_identifiable(found))
    # The same record beside a whole grid: the map is identifiable, the pitch's lags are not.
    found = identify(made.with_static(5).read(tmp_path / "grid"), starts=1)
    assert set(found.not_identifiable) == {"tau_beta_1", "tau_beta_2"}
    assert np.abs(made.pulls(found)).max() < FAR


def test_a_static_map_at_one_pitch_does_not_limit_a_record_that_moves_pitch(tmp_path):
    made = Made("15 N").with_static(6, pitch=(3.0, 3.0))
    found = identify(made.read(tmp_path), starts=1)
    assert set(found.static.not_identifiable) == {"c20", "c11", "c21", "c12"}
    assert not found.not_identifiable
    assert np.abs(made.pulls(found)).max() < FAR


def test_parameters_without_information_are_not_identifiable(tmp_path):
    made = Made("15 N").only()
    made.rig = replace(made.rig, noise=4.0)
    found = identify(made.commanded(("open_loop",), slice(-800, None)).read(tmp_path), starts=1)
    std = dict(zip(found.uncertainty.names, found.uncertainty.std, strict=True))
    assert found.not_identifiable
    for name, uncertainty in std.items():
        vague = uncertainty >= (found.parameters.values[name] if name.startswith("tau_") else 1.0)
        assert (name in found.not_identifiable) == vague


def test_a_value_on_its_bound_is_shown_with_it(tmp_path):
    made = Made("15 N").only("open_loop").changed(thrust=lambda x, record: 40.0 * x)
    found = identify(made.read(tmp_path), starts=1)
    assert {"c21", "c20"} & set(found.at_bounds)
    assert found.summary()["at_bounds"] == found.at_bounds
    page = IdentifyResult(found).page().html()
    for name, bound in found.at_bounds.items():
        assert bound in (-10.0, 10.0, 0.001)
        assert f"On a bound: {name}, which ended at {bound:g}." in page
    assert ">on its bound<" in page


def test_means_of_runs_scatter_as_their_covariance_says():
    """With and without scatter between runs in excess of their own uncertainty."""
    rng = np.random.default_rng(0)
    # Excess scatter is never negative: if there is none, its estimate by chance makes the answer too wide.
    for between, most in ((np.zeros((2, 2)), 1.5), (np.array([[4.0, 1.0], [1.0, 2.0]]), 1.2)):
        means, expected = [], []
        for _ in range(1000):
            own = np.array([np.diag(rng.uniform(0.5, 2.0, 2)) for _ in range(8)])
            values = np.array([rng.multivariate_normal([1.0, 0.5], one + between) for one in own])
            share = 1.0 / np.trace(own, axis1=1, axis2=2)
            share /= share.sum()
            means.append(share @ values)
            expected.append(covariance(values, own, share))
        ratio = np.diag(np.mean(expected, axis=0)) / np.var(means, axis=0)
        assert np.all((ratio > 0.85) & (ratio < most))
    alone = covariance(np.array([[1.0, 0.5]]), np.array([[[4.0, -1.0], [-1.0, 2.0]]]), np.ones(1))
    np.testing.assert_allclose(alone, [[4.0, -1.0], [-1.0, 2.0]])


def one_move(made: Made) -> Made:
    """Records with a single step of the speed."""
    rows, top = 2000, made.rig.speed[1]
    speed = np.where(np.arange(rows) < rows // 4, 0.5 * top, 0.9 * top)
    orders = {"omega_ref": speed, "beta_ref": np.full(rows, 5.0)}
    return made.only().with_records(**{n: made.rig.record(orders, made.rng, f"{n}.csv") for n in LONG[:2]})


def emptied(part):
    """Cells without a value in a part of the record's time."""
    return lambda x, record: np.where(
        (record.time >= part[0] * record.time[-1]) & (record.time < part[1] * record.time[-1]), np.nan, x
    )


def noiseless(made: Made) -> Made:
    """The plant's own response, without a repeat, which would be a copy."""
    made.rig = replace(made.rig, noise=0.0, digit=1e-9)
    return made.only().with_static(5).commanded(("open_loop",))


def raw(made: Made, seconds: float) -> Record:
    """Nine raw steady stretches, each `seconds` long."""
    grid = np.meshgrid(*(np.linspace(*ends, 3) for ends in (made.rig.speed, made.rig.pitch)))
    orders = {
        n: np.repeat(axis.ravel(), round(seconds / made.rig.row))
        for n, axis in zip(("omega_ref", "beta_ref"), grid, strict=True)
    }
    return made.rig.record(orders, made.rng, "static_raw.csv")


def constant(x, record):
    return np.full(len(x), 1.0)


CASES = {
    "fixed pitch": ("1.2 N", lambda m: m.only().commanded(beta_ref=4.0).with_static(6, pitch=(4.0, 4.0))),
    "one move": ("180 N", one_move),
    "no move": ("15 N", lambda m: m.only().commanded(omega_ref=4000.0, beta_ref=2.5)),
    "static alone": ("1.2 N", lambda m: m.only("static")),
    "steps alone": ("15 N", lambda m: m.only("steps")),
    "raw steady samples alone": ("1.2 N", lambda m: (m.only(), raw(m, 4.0))),
    "thrust of a section empty": ("180 N", lambda m: m.changed(LONG[:2], thrust=emptied((1 / 3, 2 / 3)))),
    "speed empty": ("180 N", lambda m: m.changed(omega=emptied((0.0, 1.1)))),
    "static of one point": ("15 N", lambda m: m.with_static(1, speed=(3000.0, 3000.0), pitch=(5.0, 5.0))),
    "no noise": ("15 N", noiseless),
    "record of 2 s": ("1.2 N", lambda m: m.only().commanded(rows=slice(-1010, None))),
}
REFUSED = {
    "rotor at rest": ("15 N", lambda m: m.only().commanded(omega_ref=0.0, beta_ref=2.5), "no identifiable parameter"),
    "raw samples that never rest": ("15 N", lambda m: (m.only(), raw(m, 2.0)), "steady stretches"),
    "dead load cell": ("1.2 N", lambda m: m.changed(thrust=constant), "look at the load cell"),
}


def folder_of(size, change, folder: Path) -> Path:
    """Write a case."""
    made, out = change(Made(size)), OutputFolder(folder)
    if isinstance(made, tuple):
        write_record(out, "static_raw.csv", made[1])
    else:
        write_campaign(out, made.campaign)
    (folder / "rig.json").write_text(json.dumps({"format": "vpp-rig/1", "scales": scales_of(size)}))
    return folder


def done(out: Path, verb: str, *words) -> dict:
    """Run a verb, which must succeed with strict JSON and a report; its JSON files by name."""
    assert main([verb, *map(str, words), "-o", str(out)]) == 0
    return {path.name: json.loads(path.read_text(), parse_constant=pytest.fail) for path in out.glob("*.json")}


@pytest.mark.sampled("name")
@pytest.mark.parametrize("name", CASES)
def test_parameters_are_identified_or_named_and_the_other_verbs_take_them(name, tmp_path):
    folder = folder_of(*CASES[name], tmp_path / "campaign")
    found = done(tmp_path / "out", "identify", folder, "--starts", "1")["identification.json"]
    assert set(found["parameters"]) | set(found["not_identifiable"]) >= {*LAGS, *MAP}
    assert (tmp_path / "out" / "report.html").exists()
    if (record := folder / "open_loop.csv").exists():
        done(tmp_path / "predicted", "simulate", record, "--parameters", tmp_path / "out")
        done(tmp_path / "compared", "compare", record, tmp_path / "predicted" / "prediction.csv")


@pytest.mark.parametrize("name", REFUSED)
def test_a_campaign_without_information_is_refused_in_one_line(name, tmp_path, refused):
    *case, reason = REFUSED[name]
    assert reason in refused("identify", folder_of(*case, tmp_path / "campaign"), "-o", tmp_path / "out")


@pytest.mark.parametrize("name", ["no move", "record of 2 s"])
def test_a_diagnosis_has_its_verdict(name, tmp_path):
    words = folder_of(*CASES[name], tmp_path / "campaign"), "--effects", "pitch_delay,sensor_drift", "--budget", "0"
    found = done(tmp_path / "out", "diagnose", *words)["diagnosis.json"]
    assert found["verdict"] in ("none", "unexplained", "partly", "attributed")


def test_a_record_at_rest_is_not_called_a_poor_fit(tmp_path):
    """One thrust at one point is known as well as the mean of the readings; there is no response that a fit could miss."""
    folder = folder_of(*CASES["no move"], tmp_path / "campaign")
    found = done(tmp_path / "out", "identify", folder)["identification.json"]
    assert {f["code"] for f in found["quality"]} == {"no_move", "thin"}
    records = [read_record(folder / f"{name}.csv") for name in LONG[:2]]
    (c20,) = found["parameters"].values()
    residuals = [r["thrust"] - r["thrust"].mean() for r in records]
    mean = np.std(np.concatenate(residuals)) / np.sqrt(sum(map(len, residuals)))  # N, of white noise
    assert c20["std"] == pytest.approx(mean / (15.0 * (4000.0 / 6000.0) ** 2), rel=0.15)


@pytest.mark.parametrize("method", ["gradient-descent", "adjoint"])
def test_every_method_names_the_same_parameters(method, tmp_path):
    folder = folder_of(*CASES["fixed pitch"], tmp_path / "campaign")
    found = done(tmp_path / "out", "identify", folder, "--starts", "1", "--method", method)["identification.json"]
    assert set(found["not_identifiable"]) == {"c12", "c21", "tau_beta_1", "tau_beta_2"}


def test_readings_that_repeat_to_the_last_digit_have_the_noise_of_that_digit():
    time = np.arange(1000) * 0.004
    thrust = np.round(5.0 + np.sin(time), 2)
    record = Record({"time": time, "omega_ref": time, "beta_ref": time, "thrust": thrust}, "synthetic")
    shown = Prediction(record, thrust, time, time)
    assert reading_noise([shown, shown], None, BASE.values()).std == pytest.approx(0.01 / np.sqrt(12.0))
    noise = noise_from(record, [np.zeros(1000)] * 2, [], 0.016, 10.0, 0.0, verified=True)
    assert np.isfinite(noise.colour.whiten(np.linspace(0.0, 1.0, 50))).all()
    assert noise.slow > 0.0
