"""Learned terms: columns against the kernel's tangents, the level of the score test, the term that is learned, and its file."""

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import chi2, kstest
from studies.synthetic import TRUTH, commands

from identification.demo import example_folder
from identification.diagnose import diagnose as diagnosis
from identification.diagnose.crossval import contiguous_folds
from identification.diagnose.judgement import ALPHA
from identification.diagnose.learned.columns import Course, hats, holds, lagged, plays, relay
from identification.diagnose.learned.description import FILE, sentence, source
from identification.diagnose.learned.learn import by_chance
from identification.diagnose.learned.refit import Term, effect_of
from identification.diagnose.learned.score import Scores
from identification.diagnose.learned.screening import screened
from identification.logger import Logger
from vpp_fmu.app.report.pages.diagnosis import DiagnoseResult
from vpp_fmu.app.report.summary import summary, write_diagnosis
from vpp_fmu.campaign import Campaign
from vpp_fmu.export import python_fmu
from vpp_fmu.files import OutputFolder
from vpp_fmu.fmu import simulate_in_fmpy
from vpp_fmu.kernel.learned import DRIVERS, PORTS, learned, placed
from vpp_fmu.kernel.plant import LIBRARY, plant
from vpp_fmu.kernel.scales import PAPER
from vpp_fmu.native import Simulator
from vpp_fmu.own_effects import library_with
from vpp_fmu.parameters import ParameterSet, read_parameters
from vpp_fmu.record import write_record

NOISE = 0.05  # N
GAIN = 0.06  # N.s/deg: the hidden term, from pitch rate to thrust
FEW = tuple(e for e in LIBRARY if e.off is None or e.name in ("pitch_command_deadband", "sensor_lag"))


def with_term(gain):
    """The plant with a thrust term proportional to the pitch rate."""
    effect = learned("hidden", "thrust", "pitch_rate", "line", {"gain": gain}, (-60.0, 60.0))
    return plant(["hidden"], placed(LIBRARY, effect, PORTS["thrust"])), {"hidden.gain": gain}


def campaign(gain, seed=0) -> Campaign:
    """Records of the paper's model with that term, a repeat and a validation record; no steps, no static map."""
    rng, (model, term) = np.random.default_rng(seed), with_term(gain)
    first, other = commands(rng, 12.0, 0.01), commands(rng, 8.0, 0.01)
    simulator, found = Simulator(model), []
    for record, name in ((first, "open_loop"), (first, "repeat"), (other, "validation")):
        thrust = simulator.simulate({**model.values(TRUTH), **term}, *record.run)[:, 0]
        found.append(
            replace(record.with_columns(thrust=thrust + NOISE * rng.standard_normal(len(record))), source=f"{name}.csv")
        )
    return Campaign(example_folder(), None, (), *found)


@pytest.fixture(scope="module")
def found():
    """The diagnosis of a rig with a term that its library does not have. It hastens the thrust: beside the base model alone,
    the logger is taken to be a row early."""
    early, real, calls = Logger(rows=-1.0, std=0.1, period=0.01), diagnosis.as_logged, []

    def as_logged(gate, *rest, **more):
        calls.append(rest)
        return replace(gate.changed(early.applied), logger=early) if len(calls) == 1 else real(gate, *rest, **more)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(diagnosis, "as_logged", as_logged)
        return diagnosis.diagnose(campaign(GAIN), FEW)


@pytest.fixture(scope="module")
def nothing():
    """The diagnosis of a rig that equals the model."""
    return diagnosis.diagnose(campaign(0.0), FEW)


def test_hats_add_up_to_one_and_make_the_curve():
    at, v = np.array([-2.0, 0.0, 1.0, 5.0]), np.linspace(-3.0, 6.0, 91)
    found = hats(v, at)
    np.testing.assert_allclose(found.sum(axis=1), 1.0)
    values = np.array([1.0, -1.0, 4.0, 2.0])
    np.testing.assert_allclose(found @ values, np.interp(v, at, values))


def test_play_hold_and_relay_are_the_closed_forms():
    v = np.array([0.0, 1.0, 3.0, 2.5, 1.0, 0.0, 4.0])
    np.testing.assert_allclose(plays(v, np.array([1.0]))[:, 0] + v, [0.0, 0.0, 2.0, 2.0, 2.0, 1.0, 3.0])
    np.testing.assert_allclose(holds(v, np.array([1.2]))[:, 0] + v, [0.0, 0.0, 3.0, 3.0, 1.0, 1.0, 4.0])
    np.testing.assert_array_equal(relay(v, 0.5, 2.0), [0, 0, 1, 1, 1, 0, 1])


def test_a_lag_of_a_step_is_the_exponential():
    u = np.r_[0.0, np.ones(200)]
    np.testing.assert_allclose(lagged(u, 0.5, 0.01)[1:], 1.0 - np.exp(-0.01 * np.arange(1, 201) / 0.5), rtol=1e-12)


@pytest.mark.parametrize("port", [p for p in PORTS if p != "reading"])
def test_a_port_s_response_is_the_kernel_s_tangent(nothing, port):
    """Curves over pitch or speed, linearised at 0: the linear response of the screening against the tangent of the model."""
    base, form = nothing.base, 2.0
    e, driver = base.problem.experiments[0], "speed" if PORTS[port].channel == "beta" else "pitch"
    outputs = Simulator(base.problem.model).simulate(base.values, *e.record.run)
    course = Course.of(e, base.values, outputs)
    at = np.linspace(*np.quantile(course.drivers[driver], [0.1, 0.9]), 3)
    values = {f"at_{k + 1}": float(v) for k, v in enumerate(at)} | {f"value_{k + 1}": 0.0 for k in range(3)}
    effect = learned("term", port, driver, "curve", values, (float(at[0]), float(at[-1])), form=form)
    model = plant(["term"], placed(nothing.base.problem.model.effects, effect, PORTS[port]))
    wrt = [f"term.value_{k + 1}" for k in range(3)]
    _, tangents = Simulator(model, wrt).sensitivities(
        {**base.values, "term.form": form} if PORTS[port].staged else base.values, *e.record.run
    )
    shown, _ = course.response(port, form, False, hats(course.drivers[driver], at))
    told, whole = e.white_thrust(shown), e.thrust_columns(tangents[:, 0])
    for k in range(3):
        assert told[:, k] @ whole[:, k] / np.linalg.norm(told[:, k]) / np.linalg.norm(whole[:, k]) > 0.97
        assert np.linalg.norm(told[:, k]) == pytest.approx(np.linalg.norm(whole[:, k]), rel=0.1)


def test_the_score_test_of_noise_has_its_distribution(nothing):
    """For noise, twice the likelihood gain of a group is chi^2 with its rank: 200 draws, Kolmogorov-Smirnov test."""
    base = nothing.base
    e, about = base.problem.experiments[0], base.linearised()
    outputs = Simulator(base.problem.model).simulate(base.values, *e.record.run)
    course, (_, jacobian) = Course.of(e, base.values, outputs), base.tangent()
    columns, rng, falls = jacobian[: base.problem.size], np.random.default_rng(0), []
    terms = hats(course.drivers["pitch_rate"], np.array([-10.0, -2.0, 0.0, 2.0, 10.0]))[:, [0, 1, 3, 4]]
    for _ in range(200):
        about.residual = about.orthogonal_part(rng.standard_normal(len(columns)))
        scores = Scores(about, columns, [course], base.problem.scale, base.problem.times, ())
        scored = scores.group(*scores.products([(terms * base.problem.scale["thrust"], None)]))
        falls.append(2.0 * scored.likelihood_gain)
    assert scored.rank == 4
    assert kstest(falls, chi2(4).cdf).pvalue > 0.01


def test_contiguous_folds_are_thirds():
    np.testing.assert_array_equal(contiguous_folds(np.array([0.0, 9.9, 10.0, 19.9, 20.0, 30.0]), 30.0), [0, 0, 1, 1, 2, 2])


def test_the_threshold_of_chance_is_the_closed_form():
    assert by_chance(100) == pytest.approx(np.log(100 / ALPHA))


def test_no_term_is_learned_where_nothing_is_missing(nothing):
    assert nothing.verdict == "none"
    assert nothing.attempt.comparisons == 0
    assert not [
        lead for lead in screened(nothing.base) if lead.promising and lead.scored.held_out > by_chance(lead.comparisons)
    ]


def test_a_missing_term_is_learned_and_added_to_the_model(found):
    assert found.verdict == "learned"
    term = found.learned.term
    assert (term.lead.port, term.lead.driver) == ("thrust", "pitch_rate")
    assert found.logger.rows == 0.0
    (before, _), (after, _) = found.errors(found.base), found.errors(found.final)
    assert (before**2 - after**2) / (before**2 - NOISE**2) > 0.9
    assert not found.after.significant
    if term.lead.shape == "line":
        std = found.std["learned.gain"]
        assert abs(term.values["gain"] - GAIN) < 4.0 * std


@pytest.mark.parametrize(
    ("port", "driver", "elsewhere"),
    [
        ("thrust", "pitch_rate", False),
        ("thrust_share", "pitch_rate", False),
        ("thrust", "speed", True),
        ("reading", "pitch_rate", True),
    ],
)
def test_a_rival_elsewhere_is_of_another_place_or_driver(found, port, driver, elsewhere):
    """The learned term is at the thrust, driven by the pitch rate."""
    rival = replace(found.learned.term, lead=replace(found.learned.term.lead, port=port, driver=driver))
    assert replace(found.learned, rivals=(rival,)).elsewhere == (rival,) * elsewhere


def test_a_refuted_term_is_on_the_page_with_the_reason(found):
    """Refuted as if lack of fit remained: its place and the reason are in the table and in the JSON."""
    refuted = replace(found, verdict="unexplained", final=found.base, attempt=found.attempt.but_refuted("something is lacking"))
    page = DiagnoseResult(refuted).page().html()
    stood = next(term for term, judged in refuted.attempt.tried if judged.refused == ("something is lacking",))
    assert stood is found.learned.curve
    assert sentence(stood) in page
    assert "something is lacking<" in page
    told = summary(refuted)["learning"]
    assert (told["refuted"], "something is lacking" in [t["why_not"] for t in told["tried"]]) == ("something is lacking", True)


def test_its_files_are_read_exported_and_reported(found, tmp_path):
    write_diagnosis(OutputFolder(tmp_path), found)
    told = json.loads((tmp_path / "diagnosis.json").read_text())
    assert told["verdict"] == "learned"
    assert {"port", "driver", "lag", "shape", "parameters", "file"} <= set(told["learned"])
    assert told["learned"]["file"] == FILE
    assert told["after"]["rmse_thrust"] < told["before"]["rmse_thrust"]
    library = library_with([tmp_path / FILE])
    parameters = read_parameters(tmp_path / "parameters.json", lambda names: plant(names, library))
    record = found.campaign.validation
    shown = Simulator(parameters.model).simulate(parameters.values, *record.run)[:, 0]
    np.testing.assert_allclose(shown, found.prediction(found.final, record).thrust, rtol=0, atol=1e-4)
    path = tmp_path / "plant.fmu"
    path.write_bytes(python_fmu(parameters.model, parameters.values))
    error = simulate_in_fmpy(path, record) - record["thrust"]
    assert np.sqrt(np.mean(error**2)) == pytest.approx(told["after"]["rmse_thrust"], rel=1e-3)
    page = DiagnoseResult(found).page().html()
    assert "enters at the thrust, driven by the rate of pitch" in page


@pytest.mark.parametrize("end", ["minimum", "maximum"])
def test_a_value_on_its_bound_is_one_that_its_file_allows(tmp_path, end):
    """The bounds come from the range of the driver, which has many digits."""
    lead = SimpleNamespace(port="pitch_rate", driver="pitch_to_go", shape="sign", lag=None, times="", form=2.0)
    lead.values, lead.span = {"gain": -1.23456789, "width": 0.5}, (-1.95791771, 1.95791772)
    effect = effect_of(lead, "learned", PAPER)
    width = next(getattr(p, end) for p in effect.parameters if p.name == "width")
    library = placed(LIBRARY, effect, PORTS[lead.port])
    values = plant(["learned"], library).values({"learned.gain": -1.23456789, "learned.width": width})
    (tmp_path / FILE).write_text(source(Term(lead, effect, library, SimpleNamespace(values=values)), PAPER, "a rig"))
    ParameterSet(plant(["learned"], library)).replaced(values).save(tmp_path)
    own = library_with([tmp_path / FILE])
    assert read_parameters(tmp_path / "parameters.json", lambda names: plant(names, own)).values == values


@pytest.mark.parametrize("driver", DRIVERS)
def test_an_effect_that_starts_from_later_signals_is_read(tmp_path, driver):
    """At the first port, each driver but the commands and time is known later in the chain."""
    first = min(PORTS, key=lambda name: PORTS[name].position)
    text = f'PORT = "{first}"\nEFFECT = learned("x", PORT, "{driver}", "line", {{"gain": 0.05}}, (-60.0, 60.0))\n'
    (tmp_path / FILE).write_text("from vpp_fmu.kernel.learned import learned\n" + text)
    assert "x" in [e.name for e in library_with([tmp_path / FILE])]


OWN = """
from vpp_fmu.kernel.learned import learned
PORT = "thrust"
EFFECT = learned("camber", PORT, "pitch_rate", "line", {"gain": 0.05}, (-60.0, 60.0))
"""


def test_a_file_adds_its_effect_to_the_candidates(tmp_path):
    (tmp_path / "camber.py").write_text(OWN)
    found = diagnosis.diagnose(campaign(GAIN), library_with([tmp_path / "camber.py"], FEW), thorough=False)
    assert (found.verdict, found.final.effects) == ("attributed", ("camber",))
    assert found.final.values["camber.gain"] == pytest.approx(GAIN, rel=0.1)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (None, "no such file"),
        ("", "EFFECT: found nothing"),
        ("EFFECT = 3", "EFFECT: found a int"),
        ("1 / 0", "ZeroDivisionError: division by zero"),
        ("def", "SyntaxError"),
        (OWN.replace('PORT = "thrust"', 'PORT = "wing"').replace("PORT,", '"thrust",'), "PORT: found 'wing'"),
        (OWN.replace("camber", "sensor_lag"), "name that no other effect has"),
        (OWN.replace('PORT = "thrust"', 'BEFORE = "wing"').replace("PORT,", '"thrust",'), "BEFORE: found 'wing'"),
    ],
)
def test_a_bad_file_of_effects_is_refused_in_one_line(text, words, tmp_path, refused):
    record = campaign(0.0).validation
    write_record(OutputFolder(tmp_path), "record.csv", record)
    (tmp_path / "parameters.json").write_text('{"format": "vpp-parameters/1"}')
    path = Path(tmp_path, "own.py")
    if text is not None:
        path.write_text(text)
    given = tmp_path / "record.csv", "--parameters", tmp_path / "parameters.json", "--effects-from", path
    assert words in refused("simulate", *given, "-o", tmp_path / "out")
