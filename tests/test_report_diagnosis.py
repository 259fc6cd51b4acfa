"""Figures of a diagnosis: what they show is what the data hold."""

import re
from types import SimpleNamespace

import numpy as np
import pytest

from vpp_fmu.app.report.figures.map import behind_against_before, reached_against_commanded
from vpp_fmu.app.report.figures.parameters import FAILED, PASSED, TAKEN, Bar, evidence_bars, overlap_heatmap
from vpp_fmu.app.report.figures.residual import correlations, residual_by_move, residual_spectrum
from vpp_fmu.app.report.figures.time import stacked
from vpp_fmu.app.report.pages.diagnosis import headline
from vpp_fmu.app.report.style import AFTER, BEFORE, MEASURED
from vpp_fmu.app.report.summary import LEFT_OUT, reached
from vpp_fmu.kernel.plant import plant
from vpp_fmu.native import Simulator
from vpp_fmu.record import Record

BARS = [
    Bar("pitch_backlash (1)", 300.0, PASSED, "another explains more"),
    Bar("pitch_command_deadband", 5000.0, TAKEN, "in the final set"),
    Bar("sensor_gain", -4.0, FAILED, "evidence too weak"),
]


def figures(title: str = "The message") -> dict:
    x = np.linspace(0.1, 2.0, 20)
    both = {"before": np.exp(-x), "after": 0.1 * np.exp(-x)}
    names = ["a", "b", "c"]
    return {
        "correlations": correlations(x, {"itself": both, "pitch command": both}, 0.05, title),
        "spectrum": residual_spectrum(x, both, 0.3 + 0.0 * x, title),
        "moves": residual_by_move(x - 1.0, x > 1.0, both, title, "move of the pitch command [deg]", 0.02),
        "overlap": overlap_heatmap(names, np.array([[1.0, 0.95, 0.1], [0.95, 1.0, 0.2], [0.1, 0.2, 1.0]]), title),
        "evidence": evidence_bars(BARS, 10.0, title),
        "curve": reached_against_commanded(x, both, title, "pitch", "deg"),
        "change": behind_against_before(x, 0.1 * x, x, title),
        "stacked": stacked(x, {"pitch [deg]": {"pitch command": x, **both}, "thrust [N]": {"measured": x, **both}}, title),
    }


@pytest.mark.parametrize("name", figures())
def test_every_axis_names_its_quantity_and_unit(name):
    layout = figures()[name].layout.to_plotly_json()
    axes = [value for key, value in layout.items() if re.fullmatch(r"[xy]axis\d*", key)]
    assert len(axes) >= 2
    for axis in axes:
        assert re.search(r"\w.*\[.+\]$", axis["title"]["text"].replace("<br>", " "))


@pytest.mark.parametrize("name", figures())
def test_every_figure_has_its_message_and_height(name):
    fig = figures()[name]
    assert "The message" in fig.layout.title.text
    assert fig.layout.height > 200


@pytest.mark.parametrize("name", ["correlations", "spectrum", "curve", "stacked"])
def test_before_and_after_keep_their_colours(name):
    colours = {t.name: t.line.color for t in figures()[name].data if t.name in ("before", "after", "measured")}
    assert (colours["before"], colours["after"]) == (BEFORE, AFTER)
    assert colours.get("measured", MEASURED) == MEASURED


def test_one_legend_entry_a_line_and_one_for_the_band_over_all_panels():
    fig = figures()["correlations"]
    assert [t.name for t in fig.data if t.showlegend] == ["before", "after"]
    assert [shape.showlegend for shape in fig.layout.shapes] == [True, False]
    assert [shape.y1 for shape in fig.layout.shapes] == [0.05, 0.05]
    assert len({t.yaxis for t in fig.data}) == 2


def test_candidates_are_ranked_and_say_at_which_gate_they_failed():
    fig = figures()["evidence"]
    assert fig.layout.yaxis.categoryarray[-1] == "pitch_command_deadband"  # plotly draws the last on top
    assert fig.layout.yaxis.categoryarray[0] == "sensor_gain"
    bars = {trace.name: trace for trace in fig.data}
    assert set(bars) == {TAKEN, PASSED, FAILED}
    assert bars[TAKEN].x == (5000.0,)
    assert bars[FAILED].x == (1.0,)  # a rise has no bar on a logarithmic axis
    assert "-4  evidence too weak" in bars[FAILED].text[0]
    assert fig.layout.shapes[0].x0 == 10.0


def test_no_reason_runs_out_of_the_figure():
    low, high = figures()["evidence"].layout.xaxis.range
    assert low == 0.0
    assert high >= 2.0 * np.log10(5000.0)


def test_moves_that_reverse_are_told_from_those_that_go_on():
    fig = figures()["moves"]
    points = {trace.name: trace for trace in fig.data}
    assert set(points) == {f"{name}, {kind}" for name in ("before", "after") for kind in ("onwards", "reversed")}
    assert points["before, onwards"].x.max() <= 0.0 < points["before, reversed"].x.min()
    assert points["after, onwards"].marker.symbol != points["after, reversed"].marker.symbol
    assert (fig.layout.shapes[0].y0, fig.layout.shapes[0].y1) == (-0.04, 0.04)


def test_each_pair_is_shown_once_and_only_what_is_close_has_a_number():
    trace = figures()["overlap"].data[0]
    assert np.isfinite(trace.z).sum() == 3
    assert trace.z[0][0] == 0.95
    assert sorted(text for row in trace.text for text in row) == ["", "", "", "0.95"]
    assert (list(trace.y), list(trace.x)) == (["b", "c"], ["a", "b"])


def test_how_often_a_limit_is_reached_is_counted():
    """Three pulses of 1 s beyond the limit: it acts while they last and until two lags have forgotten them."""
    name, maximum = "speed_saturation", 5000.0
    time = np.arange(0.0, 20.0, 0.01)
    fast = (time % 6.0 >= 3.0) & (time % 6.0 < 4.0)
    columns = {"time": time, "omega_ref": np.where(fast, 5500.0, 3000.0), "beta_ref": np.full(len(time), 4.0)}
    model = plant([name])
    fit = SimpleNamespace(
        problem=SimpleNamespace(
            model=model,
            simulator=Simulator(model),
            experiments=[SimpleNamespace(record=Record(columns | {"thrust": np.zeros(len(time))}, "made"))],
        ),
        values=model.values({f"{name}.maximum": maximum}),
    )
    seconds, times = reached(fit, name)["maximum"]
    assert times == 3
    assert 3.0 < seconds < 3.0 * (1.0 + np.log(1e3) * (0.172 + 0.053))
    fit.values[f"{name}.maximum"] = 5600.0
    assert reached(fit, name)["maximum"] == (0.0, 0)
    fit.values[f"{name}.maximum"] = 1e6
    assert reached(fit, name) == {}


@pytest.mark.parametrize(("shipped", "errors"), [((), ["0.2 N"]), (("pitch_backlash",), ["0.3 N before", "0.2 N after"])])
def test_an_effect_that_is_named_and_does_not_ship_is_in_the_headline_with_the_reason(shipped, errors):
    """Beside one that ships, before and after are that one's."""
    model = plant((*shipped, "rotor_vibration"))
    base, final = SimpleNamespace(effects=()), SimpleNamespace(effects=shipped)
    found = SimpleNamespace(
        errors=lambda fit: (0.3 if fit is base and shipped else 0.2, None),
        base=base,
        final=final,
        noise=SimpleNamespace(floor=0.1),
        unseen=None,
        refuted="",
        verdict="attributed",
        learned=None,
        selection=SimpleNamespace(final=SimpleNamespace(problem=SimpleNamespace(model=model))),
        left_out=("rotor_vibration",),
        best_guess=None,
    )
    said = headline(found)
    for part in ("rotor_vibration (", LEFT_OUT, *shipped, *errors):
        assert part in said
    assert ("before" in said) == bool(shipped)
