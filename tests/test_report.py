"""The report: a page that needs no network, and figures with titles, units and correct data."""

import re
from html.parser import HTMLParser
from types import SimpleNamespace

import numpy as np
import pytest

from vpp_fmu.app.report.figures.loop import (
    cost_ranks,
    margins_over_thrust,
)
from vpp_fmu.app.report.figures.map import (
    best_pairs,
    map_lines,
    reached_against_commanded,
)
from vpp_fmu.app.report.figures.parameters import (
    interval_widths,
    learned_curve,
    learning_curve,
    parameter_change,
)
from vpp_fmu.app.report.figures.residual import (
    correlations,
    residual_spectrum,
)
from vpp_fmu.app.report.figures.time import closed_loop, measured_against_predicted, stacked, step_responses, two_records
from vpp_fmu.app.report.page import Page
from vpp_fmu.app.report.pages.diagnosis import DiagnoseResult
from vpp_fmu.app.report.summary import LEFT_OUT
from vpp_fmu.kernel.plant import plant
from vpp_fmu.parameters import ParameterSet

HOSTILE = '</script><a href="http://evil.example">x</a>'


def record(samples: int, seed: int = 1) -> dict[str, np.ndarray]:
    """A record with a peak of one sample in the thrust."""
    rng = np.random.default_rng(seed)
    time = np.arange(samples) * 0.004
    thrust = 5 + np.sin(time) + 0.1 * rng.normal(size=samples)
    thrust[samples // 3] = 14.5
    thrust[samples // 2] = -3.5
    held = np.where(time < 1, 4.0, 6.0)
    return {
        "time": time,
        "thrust": thrust,
        "thrust_set": held,
        "omega_ref": 900 * held,
        "omega": 900 * held,
        "beta_ref": held,
        "beta": held,
    }


def prediction(title: str = "The model errs by 0.1 N", samples: int = 500, name: str = "before"):
    r = record(samples)
    models = {name: r["thrust"] + 0.4, "after": r["thrust"] - 0.1}
    return measured_against_predicted(r, models, title, noise=0.1)


def grid_points() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    omega, beta = (axis.ravel() for axis in np.meshgrid([2000.0, 4000.0, 6000.0], [-5.0, 0.0, 5.0, 10.0]))
    return beta, omega, omega * (beta + 6) / 6000


def figures(title: str = "The message") -> dict:
    """A figure of each kind by name."""
    return _of_models(title) | _of_diagnoses(title) | _of_designs(title)


def _of_models(title: str) -> dict:
    r, other = record(400), record(400, seed=2)
    names = ["tau_beta_1", "c20", "added"]
    speeds = {2000.0: 1.0, 4000.0: 1.5, 6000.0: 2.0}
    lines = {speed: share * np.linspace(0, 10, 5) for speed, share in speeds.items()}
    return {
        "prediction": prediction(title),
        "map": map_lines(np.linspace(-5, 10, 5), lines, grid_points(), title, "pitch [deg]", "rpm"),
        "loop": closed_loop({"dual": r, "speed only": {k: v for k, v in other.items() if k != "beta"}}, title),
        "two": two_records(("a", r["time"], r["thrust"]), ("b", other["time"], other["thrust"]), title, "thrust", "N"),
        "parameters": parameter_change(names, [0.1, 0.3, 0.0], [0.2, 0.2, 0.8], [0.1, 0.1, 0.7], [0.3, np.nan, 0.9], title),
        "learning": learning_curve(np.arange(1, 9), np.geomspace(1, 1e-3, 8), title),
    }


def _of_diagnoses(title: str) -> dict:
    x = np.linspace(0.1, 2.0, 20)
    both = {"before": np.exp(-x), "after": 0.1 * np.exp(-x)}
    return {
        "correlations": correlations(x, {"itself": both, "pitch command": both}, 0.05, title),
        "spectrum": residual_spectrum(x, both, 0.3 + 0.0 * x, title),
        "curve": reached_against_commanded(x, both, title, "pitch", "deg"),
        "stacked": stacked(x, {"pitch [deg]": {"pitch command": x, **both}, "thrust [N]": {"measured": x, **both}}, title),
    }


def _of_designs(title: str) -> dict:
    x, rng = np.linspace(0.1, 20.0, 60), np.random.default_rng(1)
    surface = np.outer(x, x)
    step = SimpleNamespace(time=x, direction="up", reason="", normalised=lambda _: (x / 20, x / 20))
    names = ["tau_beta_1", "c20", "pitch_command_deadband.half_width"]
    widths = {"before": [20.0, 3.0, 400.0], "the paper's plan": [10.0, 2.0, 50.0], "after this plan": [2.0, 0.5, 5.0]}
    return {
        "learned": learned_curve(x, x**2, x, {"learned": (x, x**2)}, x, title, ("speed", "rpm"), ("thrust", "N")),
        "widths": interval_widths(names, {k: np.array(v) for k, v in widths.items()}, title),
        "pairs": best_pairs(x, x, {"thrust": (surface, [50.0, 100.0], "N"), "power": (surface**2, [1e3], "W")}, (x, x), title),
        "steps": step_responses([step], title),
        "margins": margins_over_thrust(
            {"tuned": x}, {"gain margin [-]": {"tuned": 2.0 + 0.1 * x}, "delay margin [s]": {"tuned": 0.1 / x}}, {}, title
        ),
        "ranks": cost_ranks({"tuned": rng.uniform(size=30), "published": rng.uniform(1, 2, 30)}, title),
    }


FIGURES = figures()


def page() -> Page:
    report = Page("A rig", "It errs by 0.4 N.\n\nNoise: 0.3 N.")
    report.tiles([("Error", "0.40 N", "unseen record"), ("Parameters", 9, "")])
    for section, fig in figures().items():
        report.section(section, "What it shows.")
        report.figure(fig, "A caption.")
    report.table(["parameter", "value [s]"], [["tau", 0.12345], ["late", None]], "Values.")
    report.note("Mind this.")
    return report


class Markup(HTMLParser):
    """Tags with attributes, and texts by the tag around them."""

    def __init__(self, html: str):
        super().__init__()
        self.tags, self.texts, self._open = [], [], ""
        self.feed(html)

    def handle_starttag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))
        self._open = tag

    def handle_data(self, data):
        self.texts.append((self._open, data))


def test_page_loads_nothing_from_outside():
    html = page().html()
    own = html.replace("http://www.w3.org/2000/svg", "")  # a name, which is not fetched
    assert "http:" not in own
    assert "https:" not in own
    assert not re.search(r"@import|@font-face|url\((?!#)|fetch\(|XMLHttpRequest|import\(", own)
    for tag, attributes in Markup(own).tags:
        assert tag not in {"link", "iframe", "img", "object", "base"}
        assert "src" not in attributes
        assert attributes.get("href", "#").startswith("#")


def test_page_forbids_the_browser_to_load():
    policy = next(a["content"] for tag, a in Markup(page().html()).tags if a.get("http-equiv") == "Content-Security-Policy")
    rules = dict(rule.strip().split(" ", 1) for rule in policy.split(";"))
    assert rules["default-src"] == "'none'"
    assert all(source in {"'none'", "'unsafe-inline'"} for r in rules.values() for source in r.split())


def test_page_has_the_same_bytes_twice():
    assert page().html() == page().html()


def test_page_escapes_every_text():
    report = Page(HOSTILE, HOSTILE)
    report.tiles([(HOSTILE, HOSTILE, HOSTILE)])
    for _ in range(3):
        report.section(HOSTILE, HOSTILE)
    report.figure(prediction(HOSTILE, name=HOSTILE), HOSTILE)
    report.table([HOSTILE], [[HOSTILE]], HOSTILE)
    report.note(HOSTILE)
    markup = Markup(report.html())
    assert [a["href"] for tag, a in markup.tags if tag == "a"] == ["#section-1", "#section-2", "#section-3"]
    assert sum(tag == "script" for tag, _ in markup.tags) == 2
    assert not any("<a href" in text for tag, text in markup.texts if tag == "script")


def test_tags_in_names_are_escaped_in_figures():
    fig = prediction(HOSTILE, name="<b>loud</b>")
    assert "<a" not in fig.layout.title.text
    assert not any("<b>" in trace.name for trace in fig.data)


@pytest.mark.parametrize("name", FIGURES)
def test_every_axis_names_its_quantity_and_unit(name):
    layout = FIGURES[name].layout
    axes = []
    for key, value in layout.to_plotly_json().items():
        if re.fullmatch(r"[xy]axis\d*", key):
            axes.append(value)
    assert len(axes) >= 2
    for axis in axes:
        if axis.get("type") == "category":  # its labels are names
            continue
        assert re.search(r"\w.*\[.+\]$", axis["title"]["text"].replace("<br>", " "))


def test_residual_and_its_size_are_those_of_the_data():
    fig = prediction()
    after = next(trace for trace in fig.data if trace.name.startswith("after, rmse"))
    residual = next(trace for trace in fig.data if trace.name == "after, residual")
    assert after.name == "after, rmse 0.1 N"
    np.testing.assert_allclose(residual.y, 0.1)
    assert residual.yaxis == "y2"
    assert [fig.layout.shapes[0].y0, fig.layout.shapes[0].y1] == [-0.2, 0.2]


def test_band_stands_around_the_prediction_and_in_the_residual():
    r = record(500)
    std = np.linspace(0.1, 0.2, 500)
    predicted = r["thrust"] - 0.1
    fig = measured_against_predicted(r, {"model": predicted}, "title", band=std)
    edges = [trace for trace in fig.data if trace.hoverinfo == "skip"]
    assert [trace.yaxis for trace in edges] == ["y", "y", "y2", "y2"]
    for edge, centre, side in zip(edges, (predicted, predicted, 0.0, 0.0), (-1, 1, -1, 1), strict=True):
        np.testing.assert_allclose(edge.y, centre + side * 1.96 * std, atol=1e-5)
    assert [trace.fill for trace in edges] == [None, "tonexty", None, "tonexty"]
    assert sum(bool(trace.showlegend) for trace in edges) == 1


@pytest.mark.parametrize(("shipped", "errors"), [((), ["0.2 N"]), (("pitch_backlash",), ["0.3 -> 0.2 N"])])
def test_an_effect_left_out_of_the_model_is_in_the_headline_with_the_reason(shipped, errors):
    """Beside an effect in the model, the errors before and after are those of that effect."""
    model = plant((*shipped, "rotor_vibration"))
    fit = {"problem": SimpleNamespace(model=model), "values": model.values({"rotor_vibration.amplitude": 0.31})}
    base, final = SimpleNamespace(effects=()), SimpleNamespace(effects=shipped, **fit)
    found = SimpleNamespace(
        parameters=lambda fit: ParameterSet(model),
        errors=lambda fit: (0.3 if fit is base and shipped else 0.2, None),
        base=base,
        final=final,
        noise=SimpleNamespace(floor=0.1),
        unseen=None,
        refuted="",
        verdict="attributed",
        learned=None,
        selection=SimpleNamespace(final=SimpleNamespace(**fit), family={}),
        left_out=("rotor_vibration",),
        best_guess=None,
    )
    said = DiagnoseResult(found).headline()
    for part in ("he rotor shakes the load cell by 0.31 N once a revolution (", LEFT_OUT, *errors):
        assert part in said
    assert ("backlash" in said) == ("->" in said) == bool(shipped)
