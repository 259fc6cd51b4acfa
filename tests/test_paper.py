import json
import re

import numpy as np
import pytest
from builders import shorten_tuning
from jsonschema import Draft202012Validator
from studies.paper import numbers

from tests.tables import stored, table, written
from vpp_fmu.app.cli import main
from vpp_fmu.app.cli.answer import SCHEMAS
from vpp_fmu.app.paper.control import Merit, profile
from vpp_fmu.app.paper.published import ASSUMED, COST_END, COST_START, FIGURES, KEY, NUMBERS, STATIC_MAP, shown
from vpp_fmu.app.paper.rows import as_paper
from vpp_fmu.app.paper.study import paper_thrust
from vpp_fmu.campaign import read_campaign
from vpp_fmu.kernel.controller import CONTROLLER, DUAL, SPEED_ONLY
from vpp_fmu.kernel.plant import AVERAGED, FINE_TUNED, normalised_map, plant
from vpp_fmu.loop import run as run_loop
from vpp_fmu.parameters import read_parameters
from vpp_fmu.plants import KernelController, KernelPlant


class Quick:
    """What `vpp paper --quick` wrote and said."""

    def __init__(self, out, said):
        self.out, self.said = out, said
        self.told = json.loads((out / "paper.json").read_text())
        self.rows = {row["name"]: row for row in self.told["rows"]}
        self.page = (out / "report.html").read_text()
        self.campaign = read_campaign(out / "campaign")

    def test(self, plant, gains, controller):
        """The step test of one loop."""
        wanted = {"plant": plant, "gains": gains, "controller": controller}
        return next(test for test in self.told["step_tests"] if wanted.items() <= test.items())


pytestmark = pytest.mark.usefixtures("short_waits")


@pytest.fixture(scope="module")
def quick(tmp_path_factory, request):
    out = tmp_path_factory.mktemp("paper")
    capture = request.config.pluginmanager.getplugin("capturemanager")
    with capture.global_and_fixture_disabled(), pytest.MonkeyPatch.context() as patch:
        lines = []
        patch.setattr("builtins.print", lambda *words, **_: lines.append(" ".join(map(str, words))))
        shorten_tuning(patch.setattr)
        assert main(["paper", "--quick", "--verbose", "-o", str(out)]) == 0
    return Quick(out, "\n".join(lines))


def test_the_papers_numbers_are_consistent():
    initial = {name: AVERAGED[name] for name in STATIC_MAP}
    assert normalised_map(**STATIC_MAP) == pytest.approx(initial)
    assert NUMBERS["cost_fall"].value == pytest.approx(100.0 * (1.0 - COST_END / COST_START), abs=0.05)
    w, b = 6000.0, 10.0
    papers = (0.21 * w**2 - 5.7 * w * b + 0.023 * w**2 * b - 1.25 * w * b**2 - 2.15e-6 * w**3) * 1e-6
    assert paper_thrust(np.array([w]), np.array([b])) == pytest.approx(papers)
    assert {n: NUMBERS[f"fine_tuned.{n}"].value for n in FINE_TUNED} == FINE_TUNED
    assert {n: NUMBERS[f"dual.{n}"].value for n in DUAL} == DUAL


def test_every_number_of_the_paper_has_a_row_with_an_explanation(quick):
    assert list(quick.rows) == list(NUMBERS)
    for name, row in quick.rows.items():
        assert row["value"] == NUMBERS[name].value
        assert len(row["why"]) >= len("as the paper"), name
        assert NUMBERS[name].what in quick.page.replace("&#x27;", "'"), name
    nothing = [name for name, row in quick.rows.items() if row["rig"] is None and row["model"] is None]
    assert nothing == ["supplies", "esc"]


def test_every_figure_of_the_paper_is_on_the_page(quick):
    table = quick.page[quick.page.index("Figures of the paper and of this page") :]
    for number, what in FIGURES.items():
        cells = re.search(rf"<td>figure {number}</td><td[^>]*>{re.escape(what)}</td><td[^>]*>(.*?)</td>", table)
        if number in ("1a", "1b"):
            assert cells[1].startswith("a ")
        else:
            here = cells[1].split()[-1]
            assert f'id="figure-{here}"' in quick.page


def test_the_page_needs_no_network_and_says_that_the_study_is_quick(quick):
    assert "default-src 'none'" in quick.page
    assert not re.search(r"<(script|link|img|iframe)[^>]*\s(src|href)=", quick.page)
    assert "A quick study" in quick.page
    for drawn in ("paper: 0.15 and 0.04 s", "paper: 0.28 and 0.11 s", "paper, published", "paper, 2000 rpm", "paper's map"):
        assert drawn in quick.page


def test_every_step_of_the_campaign_is_one_that_identification_reads(quick):
    steps = json.loads((quick.out / "identification.json").read_text())["steps"]
    assert steps["unreadable"] == {}
    assert len(steps["runs"]) == 40
    assert {(run["channel"], run["direction"]) for run in steps["runs"]} == {
        (channel, way) for channel in ("omega", "beta") for way in ("up", "down")
    }


def test_the_campaign_is_what_the_rigs_own_command_measures(quick, tmp_path):
    words = ["--virtual", "--parts", "validation", "--validation-seconds", "8", "--settle", "1", "-o", str(tmp_path)]
    assert main(["hil", "campaign", *words]) == 0
    assert (tmp_path / "validation.csv").read_bytes() == (quick.out / "campaign" / "validation.csv").read_bytes()


def test_its_campaign_identifies_to_its_parameters(quick, tmp_path):
    assert main(["identify", str(quick.out / "campaign"), "-o", str(tmp_path)]) == 0
    again, study = (read_parameters(folder / "parameters.json", plant) for folder in (tmp_path, quick.out))
    assert again.values == study.values
    for name in ("c20", "c30", "tau_omega_1"):
        assert quick.rows[f"fine_tuned.{name}"]["rig"] == study.values[name]


def test_the_static_rows_are_a_plain_fit_in_the_papers_units(quick):
    points = quick.campaign.static
    used = points.beta_ref >= -5.0
    w, b, thrust = points.omega[used], points.beta_ref[used], points.thrust[used]
    terms = np.column_stack([w**2, w * b, w**2 * b, w * b**2, w**3])
    scale = np.abs(terms).max(axis=0)
    weight = np.sqrt(points.samples[used]) / points.thrust_std[used]
    c = np.linalg.lstsq(terms / scale * weight[:, None], thrust * weight, rcond=None)[0] / scale
    assert [quick.rows[f"static.{name}"]["rig"] for name in STATIC_MAP] == pytest.approx(c, rel=1e-6)
    left, n = thrust - terms @ c, len(thrust)
    r2 = 1.0 - (left @ left / (n - 5)) / np.var(thrust, ddof=1)
    assert quick.rows["r2_adjusted"]["rig"] == pytest.approx(r2, abs=1e-9)
    on_paper = [quick.rows[f"static.{name}"]["model"] for name in ("c20", "c21")]
    assert on_paper == pytest.approx([STATIC_MAP["c20"], STATIC_MAP["c21"]], rel=0.1)


def test_the_sum_of_the_pitch_lags_is_the_area_above_the_step_response(quick):
    """For two lags the area above the step response is the sum of their time constants."""
    sums = {}
    for record in quick.campaign.steps:
        size = abs(record["beta_ref"][-1] - record["beta_ref"][0])
        if size in (8.0, 20.0) and record["omega_ref"][0] == 6000.0:
            at = int(np.argmax(np.diff(record["beta_ref"]) != 0.0)) + 1
            before, after = record["thrust"][:at].mean(), record["thrust"][-150:].mean()
            area = np.sum((after - record["thrust"][at:]) / (after - before)) * 0.004
            sums.setdefault(size, []).append(area)
    table = quick.page[quick.page.index("Why averages of pitch steps mislead") :]
    for size, areas in sums.items():
        row = re.search(rf"{size:.4g}[0.]*</td>" + r'<td class="number">([\d.]+)</td>' * 3, table)
        assert float(row[3]) == pytest.approx(np.mean(areas), rel=0.12)
        assert float(row[1]) + float(row[2]) == pytest.approx(float(row[3]), abs=2e-4)
    assert np.mean(sums[20.0]) > 1.5 * np.mean(sums[8.0])


def test_fine_tuning_recovers_the_papers_model(quick):
    assert quick.rows["cost_end"]["model"] == pytest.approx(COST_END, rel=0.1)
    assert quick.rows["cost_start"]["rig"] > quick.rows["cost_end"]["rig"]
    for which in ("rig", "model"):
        start, end = (quick.rows[name][which] for name in ("cost_start", "cost_end"))
        assert quick.rows["cost_fall"][which] == pytest.approx(100.0 * (1.0 - end / start))
    assert quick.rows["fine_tuned.tau_omega_1"]["model"] == pytest.approx(FINE_TUNED["tau_omega_1"], rel=0.2)
    assert quick.rows["fine_tuned.c21"]["model"] == pytest.approx(FINE_TUNED["c21"], rel=0.1)


@pytest.mark.parametrize(("controller", "gains"), [("both actuators", DUAL), ("speed alone", SPEED_ONLY)])
def test_the_step_test_of_the_papers_model_is_the_kernels_own_loop(quick, controller, gains):
    start = (2000.0, gains.get("beta_fixed", 0.0))
    done = run_loop(KernelPlant(parameters=ASSUMED), KernelController(gains), profile(15.0), start)
    told = quick.test("paper's model", "published gains", controller)
    for way, wanted, size, rows in (("up", 12.0, 10.5, slice(833, 1665)), ("down", 1.5, 10.5, slice(1665, None))):
        outside = np.abs(done["thrust"][rows] - wanted) > 0.02 * size
        assert told[way]["settling"] == pytest.approx(0.004 * (len(outside) - np.argmax(outside[::-1])), abs=0.005)
        error = np.sum((done["thrust_set"] - done["thrust"])[rows] ** 2) / 15.0**2 * 0.004
        assert told[way]["squared_error"] == pytest.approx(error, rel=1e-3)


def test_the_lag_beside_the_assumed_one_is_the_rigs_own_of_that_name(quick):
    """The paper assumes 0.05 s for its slower pitch lag; a fit writes the slower one first."""
    lags = sorted(quick.rows[f"fine_tuned.tau_beta_{k}"]["rig"] for k in (1, 2))
    found = read_parameters(quick.out / "parameters.json", plant).values
    assert lags == sorted(found[f"tau_beta_{k}"] for k in (1, 2))
    assert quick.rows["assumed"]["rig"] == lags[1] == quick.rows["fine_tuned.tau_beta_2"]["rig"]
    assert quick.rows["assumed"]["model"] == 0.05


def test_a_row_of_the_setup_reads_as_the_paper_only_if_the_rig_has_the_papers_value(quick):
    files = quick.campaign
    at = np.argmax(np.diff(files.steps[0]["omega_ref"]) != 0.0) + 1
    read = {
        "grid": f"{len(set(files.static.omega_ref))} x {len(set(files.static.beta_ref))}",
        "speeds": f"{files.static.omega_ref.min():g} to {files.static.omega_ref.max():g}",
        "samples": float(np.median(files.static.samples)),
        "rate": 1.0 / files.open_loop.period,
        "before": files.steps[0].time[at],
        "order": 4.0,
        "adc": 16.0,
    }
    for name, value in read.items():
        row = quick.rows[name]
        assert row["rig"] == (value if isinstance(value, str) else pytest.approx(value)), name
        assert row["why"].startswith("as the paper" if shown(row["value"]) == shown(row["rig"]) else "not as the paper"), name
    assert [quick.rows[n]["why"][:3] for n in ("grid", "samples", "before")] == ["not"] * 3, "a quick study"
    assert as_paper("kv", 560.0) == "not as the paper"
    assert as_paper("kv", 550.0, "the same part") == "as the paper; the same part"


def test_a_cost_that_agrees_by_construction_is_marked(quick):
    assert quick.rows["cost_end"]["why"].startswith("agrees by construction on the paper's model")


def test_the_pages_table_is_what_the_study_prints(quick):
    """The table is of a full study. Columns that do not depend on the size of the campaign must agree: the paper's, and the
    results of its gains on its model. The rig's column takes minutes: `python -m tests.studies paper --write`."""
    today, page = ([line.split(" | ") for line in text.splitlines()] for text in (numbers(quick.told), stored("paper")))
    assert [line[:2] for line in page] == [line[:2] for line in today]
    names = ("reached", "overshoot", "up", "down")
    places = [KEY.index(name) + 2 for name in names]
    assert [page[k][3] for k in places] == [today[k][3] for k in places]


def test_a_table_goes_between_its_comments_and_nowhere_else():
    page = "# A\n<!-- table x: by y -->\n| old |\n<!-- end of x -->\n<!-- table z: by y -->\n<!-- end of z -->\nend\n"
    made = written("x", table(("a", "b"), [(1, None)]), page)
    assert made == page.replace("| old |\n", "| a | b |\n| --- | --- |\n| 1 | - |\n")
    assert stored("z", made) == ""
    with pytest.raises(KeyError, match="w"):
        written("w", "", page)


def test_its_object_is_as_its_schema_describes(quick):
    schema = Draft202012Validator(json.loads((SCHEMAS / "paper.json").read_text()))
    found = quick.told | {"sentence": quick.told["verdict"]}  # of the file, which has all but the sentence
    schema.validate(found)
    assert not schema.is_valid(found | {"another": 1})


def test_the_verdict_is_what_the_step_tests_say(quick):
    dual, alone = (quick.test("emulated rig", "tuned gains", name) for name in ("both actuators", "speed alone"))
    for way in ("up", "down"):
        better = dual[way]["squared_error"] < alone[way]["squared_error"]
        assert f"{'better' if better else 'worse'} {way} " in quick.told["verdict"]
    assert quick.told["verdict"] in quick.said
    assert dual["down"]["squared_error"] < alone["down"]["squared_error"], "the paper's claim"


def test_errors_within_their_uncertainty_count_as_equal():
    sure, unsure = Merit(0.5, 0.0, 0.0635, 0.0002), Merit(0.5, 0.0, 0.0612, 0.002)
    assert sure.against(Merit(0.5, 0.0, 0.0612, 0.0002)) == "worse"
    assert Merit(0.5, 0.0, 0.0612).against(sure) == "better"
    assert sure.against(unsure) == unsure.against(sure) == "as good"


def test_gains_and_fmus_are_those_of_the_rows(quick):
    for file, prefix in (("gains.json", "dual"), ("gains_speed_only.json", "speed_only")):
        gains = read_parameters(quick.out / file, lambda _: CONTROLLER).values
        for name in ("kp_omega", "ki_omega", "kd_omega"):
            assert gains[name] == pytest.approx(quick.rows[f"{prefix}.{name}"]["rig"])
    assert len(list(quick.out.glob("Vpp*.fmu"))) == 2


def test_every_stage_is_printed_as_it_begins(quick):
    """Minutes without output would look like a hang."""
    told = re.findall(r"^vpp paper: (.*) \(\d+ s\)$", quick.said, re.MULTILINE)
    assert told[-2:] == ["export", "report"]
    assert {"steps the paper's way", "the paper's descent"} <= set(told)


def test_the_time_of_every_stage_and_of_the_whole_is_printed(quick):
    seconds = dict(quick.told["seconds"])
    total = seconds.pop("total")
    assert sum(seconds.values()) == pytest.approx(total, abs=0.5)
    for name in seconds:
        assert re.search(rf"^{re.escape(name)}: [\d.]+ s$", quick.said, re.MULTILINE)
    assert re.search(r"^the whole study: [\d.]+ s$", quick.said, re.MULTILINE)


def test_values_in_cells_stay_short():
    assert [shown(value) for value in (5.0, 0.15, 0.16961234, 2.3e-8, None, "minor")] == [
        *("5", "0.15", "0.1696", "2.3e-08"),
        None,
        "minor",
    ]
