"""The report: a page that needs no network, and figures with correct data."""

import re
from html.parser import HTMLParser
from types import SimpleNamespace

import numpy as np
import pytest

from vpp_fmu.app.report.figures import measured_against_predicted
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


def page() -> Page:
    report = Page("A rig", "It errs by 0.4 N.\n\nNoise: 0.3 N.")
    report.tiles([("Error", "0.40 N", "unseen record"), ("Parameters", 9, "")])
    report.section("The section", "What it shows.")
    report.figure(prediction(), "A caption.")
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
    fig = prediction(HOSTILE, name="<b>loud</b>").plotly()
    assert "<a" not in fig.layout.title.text
    assert not any("<b>" in trace.name for trace in fig.data)


def test_residual_and_its_size_are_those_of_the_data():
    fig = prediction()
    after = next(mark for mark in fig.marks if mark["name"].startswith("after, rmse"))
    residual = next(mark for mark in fig.marks if mark["name"] == "after, residual")
    assert after["name"] == "after, rmse 0.1 N"
    np.testing.assert_allclose(residual["y"], 0.1)
    assert residual["axis"] == fig.shapes[0]["axis"] == "y1"
    assert fig.shapes[0]["ends"] == [-0.2, 0.2]


def test_band_stands_around_the_prediction_and_in_the_residual():
    r = record(500)
    std = np.linspace(0.1, 0.2, 500)
    predicted = r["thrust"] - 0.1
    fig = measured_against_predicted(r, {"model": predicted}, "title", band=std)
    edges = [mark for mark in fig.marks if mark.get("mute")]
    assert [mark["axis"] for mark in edges] == ["y0", "y0", "y1", "y1"]
    for edge, centre, side in zip(edges, (predicted, predicted, 0.0, 0.0), (-1, 1, -1, 1), strict=True):
        np.testing.assert_allclose(edge["y"], centre + side * 1.96 * std, atol=1e-5)
    assert ["fill" in mark for mark in edges] == [False, True, False, True]
    assert sum(mark["shown"] and bool(mark["name"]) for mark in edges) == 1


def test_the_figure_of_a_notebook_has_the_same_lines_and_panels():
    own, fig = prediction(), prediction().plotly()
    assert [len(trace.x) for trace in fig.data] == [len(mark["x"]) for mark in own.marks]
    assert [fig.layout[f"yaxis{k}"].title.text for k in ("", 2, 3, 4)] == [own.axes[f"y{k}"]["title"] for k in range(4)]
    assert fig.layout.xaxis.title.text == "time [s]"
    assert {trace.yaxis for trace in fig.data} == {"y", "y2", "y3", "y4"}


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


def test_a_colour_that_may_be_invisible_on_dark_is_refused():
    fig = prediction()
    fig.marks[0]["colour"] = "#123456"
    with pytest.raises(ValueError, match="#123456 is in no scheme"):
        fig.drawing({})
