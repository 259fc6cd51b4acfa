"""Identification from single files: steady points alone, steps alone, or a record that moves one command."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from studies.degenerate import FAR
from studies.incomplete_campaigns import SIZES, commanded, gridded, measured, only, recorded, whole

from identification.identify import identify
from identification.steps.response import covariance
from vpp_fmu.app.report.pages.identification import identification_page, key_figures, not_identifiable, remarks
from vpp_fmu.campaign import Campaign, StaticMap
from vpp_fmu.kernel.plant import FINE_TUNED
from vpp_fmu.record import Record
from vpp_fmu.rig import infer_rig

LAGS = ("tau_omega_1", "tau_omega_2", "tau_beta_1", "tau_beta_2")
MAP = ("c20", "c11", "c21", "c12", "c30")


def campaign(size: str, *changes, parts: str = "wbx") -> Campaign:
    """A whole campaign of a rig, with changes; its scales are declared."""
    rig, rng = SIZES[size], np.random.default_rng(4)
    files = whole(rig, rng, parts)
    for change in changes:
        files = change(files, rig, rng)
    records = {n: Record(files[n], f"{n}.csv") if n in files else None for n in ("open_loop", "repeat", "validation")}
    static = StaticMap(**files["static"], source="static.csv") if "static" in files else None
    columns = files.get("steps", {"run": np.zeros(0)})
    runs = [{n: c[columns["run"] == number] for n, c in columns.items() if n != "run"} for number in np.unique(columns["run"])]
    steps = tuple(Record(run, f"steps.csv, run {k}") for k, run in enumerate(runs))
    scales = {n: v for n, v in vars(rig.scales).items() if n != "time_scale"}
    grid = None if static is None else files["static"]
    held = infer_rig([r for r in records.values() if r is not None] + list(steps), grid, {"scales": scales})
    return Campaign(Path("made up"), static, steps, **records, rig=held)


def pulls(found, size: str) -> np.ndarray:
    """Errors of identifiable parameters in standard deviations."""
    truth, uncertainty = SIZES[size].truth, found.uncertainty
    told = [k for k, name in enumerate(uncertainty.names) if name not in found.not_identifiable]
    return np.array([(uncertainty.values[k] - truth[uncertainty.names[k]]) / uncertainty.std[k] for k in told])


@pytest.mark.parametrize("size", SIZES)
def test_steady_points_alone_give_the_map_and_name_the_lags(size):
    found = identify(campaign(size, only("static")))
    assert found.refinement is None
    assert found.uncertainty.names == MAP
    assert np.abs(pulls(found, size)).max() < FAR
    assert tuple(found.not_identifiable) == LAGS
    assert all("no record to fit" in why for why in found.not_identifiable.values())
    entries = found.parameters.estimates
    assert {n for n, e in entries.items() if e.std is None} >= set(LAGS)
    assert all(entries[n].std > 0.0 for n in MAP)
    assert found.parameters.values["tau_beta_1"] in (FINE_TUNED["tau_beta_1"], FINE_TUNED["tau_beta_2"])  # the default


@pytest.mark.parametrize("size", SIZES)
def test_steps_beside_steady_points_give_the_lags_as_well(size):
    found = identify(campaign(size, only("static", "steps")))
    assert set(found.uncertainty.names) == {*LAGS, *MAP}
    assert not found.not_identifiable
    assert np.abs(pulls(found, size)).max() < FAR
    content = found.summary()
    assert content["cost_final"] is content["residual_tests"] is None
    assert content["rmse_thrust"] == {}
    matrix, names = np.array(content["correlation"]["matrix"]), content["correlation"]["names"]
    one, other = names.index("tau_beta_1"), names.index("c21")
    assert matrix[one, other] == 0.0
    assert matrix[names.index("tau_beta_1"), names.index("tau_beta_2")] < 0.0  # their sum is known better than either


def test_steps_alone_give_the_lags_of_the_thrust():
    found = identify(campaign("paper", only("steps")))
    assert found.uncertainty.names == LAGS
    assert set(found.not_identifiable) == set(MAP)
    assert any("lags are those of the thrust" in line for line in remarks(found))


def test_one_record_of_any_kind_is_fitted_and_nothing_is_called_unseen():
    for name in ("open_loop", "repeat", "validation"):
        found = identify(campaign("paper", only(name)), starts=1)
        assert found.fitted == (name,)
        assert found.unseen == ()
        assert np.abs(pulls(found, "paper")).max() < FAR
        assert any("no hold-out record" in line for line in remarks(found))
    found = identify(campaign("paper", only("open_loop", "validation")), starts=1)
    assert found.unseen == ("validation",)
    assert not any("unseen" in line for line in remarks(found))


def test_a_pitch_that_never_moved_is_named_whatever_the_steady_points_are():
    grid = {"speeds": np.linspace(0.35, 1.0, 8), "pitches": [4.0]}
    found = identify(campaign("micro", recorded("wwx", (4.0, 4.0), **grid)), starts=1)
    assert {"tau_beta_1", "tau_beta_2", "c21", "c12"} <= set(found.not_identifiable)
    assert found.not_identifiable["c21"] == "the data identify only its combination with c20"
    assert found.not_identifiable["c12"] == "the data identify only its combination with c11"
    assert any(line.startswith("not identifiable from these data: c21 (stays at ") for line in not_identifiable(found))
    # The same record beside a whole grid: the map is identifiable, the pitch's lags are not.
    whole_grid = gridded(np.linspace(0.35, 1.0, 5), np.linspace(-5.0, 10.0, 5))
    found = identify(campaign("micro", recorded("wwx", (4.0, 4.0)), whole_grid), starts=1)
    assert set(found.not_identifiable) == {"tau_beta_1", "tau_beta_2"}
    assert np.abs(pulls(found, "micro")).max() < FAR


def test_a_static_map_at_one_pitch_does_not_limit_a_record_that_moves_pitch():
    found = identify(campaign("paper", gridded(np.linspace(0.35, 1.0, 9), [3.0])), starts=1)
    assert set(found.static.not_identifiable) == {"c20", "c11", "c21", "c12"}
    assert not found.not_identifiable
    assert np.abs(pulls(found, "paper")).max() < FAR


def test_parameters_without_information_are_not_identifiable():
    rig, rng = SIZES["paper"], np.random.default_rng(0)
    told = {n: c[:400] for n, c in commanded(rig, rng, "x").items()}
    loud = Record(measured(rig, told, rng, 40.0), "open_loop.csv")
    found = identify(replace(campaign("paper", only()), open_loop=loud), starts=1)
    std = dict(zip(found.uncertainty.names, found.uncertainty.std, strict=True))
    assert found.not_identifiable
    for name, uncertainty in std.items():
        vague = uncertainty >= (found.parameters.values[name] if name.startswith("tau_") else 1.0)
        assert (name in found.not_identifiable) == vague


def test_a_value_on_its_bound_is_shown_with_it():
    whole_one = campaign("paper")
    lifted = whole_one.open_loop.with_columns(thrust=40.0 * whole_one.open_loop["thrust"])
    found = identify(replace(whole_one, open_loop=lifted, repeat=None, static=None, steps=()), starts=1)
    assert {"c21", "c20"} & set(found.at_bounds)
    assert found.summary()["at_bounds"] == found.at_bounds
    page = identification_page(found).html()
    for name, bound in found.at_bounds.items():
        assert bound in (-10.0, 10.0, 0.001)
        assert f"On a bound: {name}, which ended at {bound:g}." in page
    assert ">on its bound<" in page


def test_a_page_without_a_record_has_values_and_no_prediction():
    found = identify(campaign("big", only("static", "steps")))
    page = identification_page(found).html()
    assert "How well the model predicts" not in page
    assert "The step responses" in page
    figures = key_figures(found)
    assert ("identifiable parameters", "9 of 9", "all fitted parameters") in figures
    (value,) = [value for label, value, _ in figures if label == "fit of the static map"]
    assert value == f"adjusted R² {found.static.r2_adjusted:.4f}"


def test_means_of_runs_scatter_as_their_covariance_says():
    """With and without scatter between runs in excess of their own uncertainty."""
    rng = np.random.default_rng(0)
    # Excess scatter is never negative: if there is none, its estimate by chance makes the answer too wide.
    for between, most in ((np.zeros((2, 2)), 1.5), (np.array([[4.0, 1.0], [1.0, 2.0]]), 1.2)):
        means, told = [], []
        for _ in range(1000):
            own = np.array([np.diag(rng.uniform(0.5, 2.0, 2)) for _ in range(8)])
            values = np.array([rng.multivariate_normal([1.0, 0.5], one + between) for one in own])
            share = 1.0 / np.trace(own, axis1=1, axis2=2)
            share /= share.sum()
            means.append(share @ values)
            told.append(covariance(values, own, share))
        ratio = np.diag(np.mean(told, axis=0)) / np.var(means, axis=0)
        assert np.all((ratio > 0.85) & (ratio < most))
    alone = covariance(np.array([[1.0, 0.5]]), np.array([[[4.0, -1.0], [-1.0, 2.0]]]), np.ones(1))
    np.testing.assert_allclose(alone, [[4.0, -1.0], [-1.0, 2.0]])
