"""The paper's study in short, and the tables of tests/README.md."""

import numpy as np
import pytest
from builders import shorten_tuning
from studies.paper import COST_END, COST_START, QUICK, STATIC_MAP, compared, judged, lags, on_model, paper_thrust, study

from tests.tables import stored
from vpp_fmu.kernel.controller import DUAL, SPEED_ONLY
from vpp_fmu.kernel.plant import AVERAGED, FINE_TUNED, normalised_map


@pytest.fixture(scope="module")
def quick(short_waits, tmp_path_factory):
    with pytest.MonkeyPatch.context() as patch:
        shorten_tuning(patch.setattr)
        return study(tmp_path_factory.mktemp("paper"), QUICK, 1, 0)


@pytest.fixture(scope="module")
def rows(quick):
    return compared(quick)


def test_the_papers_numbers_are_consistent():
    assert normalised_map(**STATIC_MAP) == pytest.approx({name: AVERAGED[name] for name in STATIC_MAP})
    assert pytest.approx(0.383, abs=5e-4) == 1.0 - COST_END / COST_START
    w, b = 6000.0, 10.0
    papers = (0.21 * w**2 - 5.7 * w * b + 0.023 * w**2 * b - 1.25 * w * b**2 - 2.15e-6 * w**3) * 1e-6
    assert paper_thrust(np.array([w]), np.array([b])) == pytest.approx(papers)


@pytest.mark.slow
def test_the_static_map_is_a_plain_fit_in_the_papers_units(quick, rows):
    points = quick.campaign.static
    used = points.beta_ref >= -5.0
    w, b, thrust = points.omega[used], points.beta_ref[used], points.thrust[used]
    terms = np.column_stack([w**2, w * b, w**2 * b, w * b**2, w**3])
    scale = np.abs(terms).max(axis=0)
    weight = np.sqrt(points.samples[used]) / points.thrust_std[used]
    c = np.linalg.lstsq(terms / scale * weight[:, None], thrust * weight, rcond=None)[0] / scale
    assert quick.maps[0].coefficients == pytest.approx(dict(zip(STATIC_MAP, c, strict=True)), rel=1e-6)
    residual, n = thrust - terms @ c, len(thrust)
    r2 = 1.0 - (residual @ residual / (n - 5)) / np.var(thrust, ddof=1)
    assert rows["r2_adjusted"].rig == pytest.approx(r2, abs=1e-9)
    assert quick.maps[1].coefficients["c20"] == pytest.approx(STATIC_MAP["c20"], rel=0.1)


@pytest.mark.slow
def test_the_sum_of_the_pitch_lags_is_the_area_above_the_step_response(quick):
    """For two lags the area above the step response is the sum of their time constants."""
    sums = {}
    for record in quick.campaign.steps:
        size = abs(record["beta_ref"][-1] - record["beta_ref"][0])
        if size in (8.0, 20.0) and record["omega_ref"][0] == 6000.0:
            at = int(np.argmax(np.diff(record["beta_ref"]) != 0.0)) + 1
            before, after = record["thrust"][:at].mean(), record["thrust"][-150:].mean()
            sums.setdefault(size, []).append(np.sum((after - record["thrust"][at:]) / (after - before)) * 0.004)
    for size, areas in sums.items():
        runs = [run for run in quick.steps[0].used("beta") if abs(run.end - run.start) == pytest.approx(size)]
        assert lags(runs)[0].sum() == pytest.approx(np.mean(areas), rel=0.12)
    assert np.mean(sums[20.0]) > 1.5 * np.mean(sums[8.0]), "the actuator's speed has a limit"


@pytest.mark.slow
def test_fine_tuning_recovers_the_papers_model_and_the_table_is_that_of_the_page(quick, rows):
    """The page's table is of a full study. Columns that do not depend on the size of the campaign must agree: the paper's, and
    the results of its gains on its model."""
    on_rig, on_model = quick.tuned
    assert on_model.costs[-1] == pytest.approx(COST_END, rel=0.1)
    for tuned, shown in ((on_rig, rows["cost_fall"].rig), (on_model, rows["cost_fall"].model)):
        assert tuned.costs[-1] < tuned.costs[0]
        assert shown == pytest.approx(100.0 * (1.0 - tuned.costs[-1] / tuned.costs[0]))
    assert rows["fine_tuned.tau_omega_1"].model == pytest.approx(FINE_TUNED["tau_omega_1"], rel=0.2)
    assert on_model.best["c21"] == pytest.approx(FINE_TUNED["c21"], rel=0.1)
    cells, page = [row.cells() for row in rows.values()], [x.strip("| ").split(" | ") for x in stored("paper").splitlines()]
    assert [line[:2] for line in page[2:]] == [line[:2] for line in cells]
    for name in ("reached", "overshoot", "up", "down"):
        assert page[list(rows).index(name) + 2][3] == rows[name].cells()[3]


@pytest.mark.parametrize("gains", [DUAL, SPEED_ONLY], ids=["both", "speed"])
def test_the_figures_of_a_step_are_those_of_its_rows(gains):
    done = on_model(gains)
    for merit, wanted, part in zip(judged(done), (12.0, 1.5), (slice(833, 1665), slice(1665, None)), strict=True):
        outside = np.abs(done["thrust"][part] - wanted) > 0.02 * 10.5
        assert merit.settling == pytest.approx(0.004 * (len(outside) - np.argmax(outside[::-1])), abs=0.005)
        error = np.sum((done["thrust_set"] - done["thrust"])[part] ** 2) / 15.0**2 * 0.004
        assert merit.squared_error == pytest.approx(error, rel=1e-3)
