"""Every kind of report as a reader sees it, on a phone and on a desk, light and dark: nothing overlaps, nothing is empty."""

import re
from datetime import date, timedelta

import numpy as np
import pytest

import vpp_fmu as vpp
from hil.outcome import Outcome
from hil.timing import timing
from tests import test_report
from tests.browser import browser as opened
from vpp_fmu.app.report.drawing import Arrays, drawing
from vpp_fmu.app.report.page import Page
from vpp_fmu.app.report.pages.effects import effects_page
from vpp_fmu.app.report.pages.fleet import Entry, fleet_page
from vpp_fmu.app.report.pages.rig import run_page
from vpp_fmu.kernel.plant import LIBRARY
from vpp_fmu.record import Record

BOUND = 1.5e6
"""Largest report, bytes."""

READERS = {"phone": (390, 844), "desk": (1100, 900)}

FAULTS = """(() => {
  const slack = 2; // pixels: the box of a text is higher than its letters
  const faults = [];
  const told = (element) => `${element.closest(".plot")?.id ?? element.tagName} "${element.textContent.slice(0, 40)}"`;
  const room = document.documentElement.clientWidth;
  if (document.documentElement.scrollWidth > room) faults.push(`the page is ${document.documentElement.scrollWidth} wide`);
  for (const element of document.querySelectorAll("main *")) {
    if (element.closest(".table, .sheet, .tip, pre")) continue;
    if (element.getBoundingClientRect().right > room + 1) faults.push(`beyond the page: ${told(element)}`);
  }
  // Turned labels stand side by side in their own direction: there they are compared.
  const box = (text) => {
    const turn = /translate\\(([-.\\d]+) ([-.\\d]+)\\) rotate\\(-40\\)/.exec(text.getAttribute("transform") ?? "");
    if (!turn) return { turned: false, ...text.getBoundingClientRect().toJSON() };
    const [x, y, c, s] = [+turn[1], +turn[2], Math.cos((40 * Math.PI) / 180), Math.sin((40 * Math.PI) / 180)];
    const [own, left, top] = [text.getBBox(), x * c - y * s, x * s + y * c];
    return { turned: true, left: left + own.x, right: left + own.x + own.width, top: top + own.y,
      bottom: top + own.y + own.height };
  };
  const share = (a, b) =>
    Math.min(Math.min(a.right, b.right) - Math.max(a.left, b.left), Math.min(a.bottom, b.bottom) - Math.max(a.top, b.top));
  for (const plot of document.querySelectorAll(".plot")) {
    const sheet = plot.querySelector(".sheet svg");
    if (!sheet) { faults.push(`not drawn: ${plot.id}`); continue; }
    for (const panel of sheet.querySelectorAll("g[clip-path]")) {
      const marks = [...panel.querySelectorAll(".mark")].map((mark) => mark.getBBox());
      if (!marks.some((one) => one.width > 1 || one.height > 1)) faults.push(`empty panel: ${plot.id}`);
    }
    const texts = [...sheet.querySelectorAll("text")].filter((text) => text.textContent);
    const [frame, boxes] = [sheet.getBoundingClientRect(), texts.map(box)];
    texts.forEach((text, k) => {
      const own = text.getBoundingClientRect();
      if (own.left < frame.left - 1 || own.right > frame.right + 1 || own.bottom > frame.bottom + 1 || own.top < frame.top - 1)
        faults.push(`cut off: ${told(text)} of ${plot.id}`);
      for (let j = 0; j < k; j += 1)
        if (boxes[j].turned === boxes[k].turned && share(boxes[j], boxes[k]) > slack)
          faults.push(`overlap in ${plot.id}: "${texts[j].textContent}" and "${text.textContent}"`);
    });
    const keys = plot.querySelector(".keys").getBoundingClientRect();
    if (keys.bottom > frame.top + 1) faults.push(`the legend covers ${plot.id}`);
  }
  return [...new Set(faults)];
})()"""
"""Faults in the layout of a page, one a line."""

CONTRAST = """(() => {
  const light = (colour) => {
    const linear = (v) => (v <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4);
    const [r, g, b] = colour.match(/[\\d.]+/g).slice(0, 3).map((v) => linear(v / 255));
    return 0.2126 * r + 0.7152 * g + 0.0722 * b;
  };
  const ground = light(getComputedStyle(document.body).backgroundColor);
  const ratio = (colour) => (Math.max(light(colour), ground) + 0.05) / (Math.min(light(colour), ground) + 0.05);
  const least = (selector, property) =>
    Math.min(...[...document.querySelectorAll(selector)].map((one) => ratio(getComputedStyle(one)[property])));
  return { ground, text: least("p, td, figcaption, h3, .key", "color"), labels: least(".sheet .tick, .sheet .title", "fill"),
    lines: least(".sheet .line.mark", "stroke") };
})()"""
"""Contrast of text, labels and lines to the background of the page, as in WCAG 2."""


def figures_page() -> Page:
    """All kinds of figures that the page of an identification does not have."""
    page = Page("Figures", "One of each kind.", "campaign made up, no date of measurement")
    page.tiles([("pitch_command_deadband.half_width", "1.70 deg", "95 %: 1.69 to 1.71 deg")] * 3)
    for name, fig in test_report.figures().items():
        page.section(name)
        page.figure(fig, "What it shows.")
    return page


def rig_page(begin: float = 0.0) -> Page:
    """The page of a run on the rig, whose profile begins at `begin` s of its log."""
    run = test_report.record(2000)
    rng = np.random.default_rng(2)
    alarm = (run["time"] > 6.0).astype(float)
    units = {"residual": "N", "band": "N", "alarm": "1", "changes": "1"}
    units |= {"adapted.sensor_gain.gain": "1", "std.sensor_gain.gain": "1"}
    shown = 0.1 * rng.normal(size=2000), np.full(2000, 0.2), alarm, np.zeros(2000), 1.0 + 0.1 * alarm, np.full(2000, 0.02)
    columns = {f"twin.{name}": column for name, column in zip(units, shown, strict=True)} | {"omega_wanted": run["omega_ref"]}
    log = Record({"time": begin + run["time"]} | columns, "log")
    ticks = timing(rng.exponential(2e-4, 2000), rng.exponential(1e-4, 2000), np.zeros(2000))
    content = {
        "ended": "",
        "real_time": "no real-time kernel",
        "limits": {"omega_min": 2000.0, "omega_max": 6000.0, "beta_min": -5.0, "beta_max": 10.0},
        "log": {"rows": 2000, "ticks": 2000, "lost": 0},
        "tares": [{"zero_counts": 12.0, "noise_N": 0.1}],
        "counters": {"adc": {"repeated": 3}},
        "transitions": [
            {"time": begin, "state": "safe", "why": "start"},
            {"time": begin + 0.1, "state": "running", "why": "all answer"},
        ],
        "twin": {
            "false_alarms_per_hour": 0.1,
            "units": units,
            "alarms": [{"time": begin + 6.0, "direction": "sensor_gain.gain", "cause": "the rig is not its model"}],
        },
    }
    return run_page(Outcome(content, log, {"rig": Record(run, "run")}, ticks))


def test_all_times_of_a_run_count_from_the_start_of_its_profile():
    assert run_html(5.0) == run_html(12.5)


def run_html(begin: float) -> str:
    return re.sub(r'id="[^"]*"', "", rig_page(begin).html())


def campaigns_page() -> Page:
    """Sixty campaigns over half a year."""

    def entry(k: int) -> Entry:
        day = (date(2026, 1, 1) + timedelta(days=3 * k)).isoformat()
        sizes = {"sensor_drift.rate": (1.0 + 0.01 * k, 0.1, "N/s")}
        return Entry(f"{day}_bench", f"{day}_bench", day, "attributed", ("sensor_drift",), 0.3, 0.2, 0.1, sizes)

    return fleet_page([entry(k) for k in range(60)])


def effect_page() -> Page:
    chosen = [e for e in LIBRARY if e.name in ("pitch_backlash", "sensor_lag", "rotor_vibration")]
    return effects_page(chosen, LIBRARY)


PAGES = {
    "identification": lambda: vpp.identify(vpp.example_campaign(), starts=1).page(),
    "figures": figures_page,
    "rig": rig_page,
    "campaigns": campaigns_page,
    "effects": effect_page,
}


@pytest.fixture(scope="module")
def pages(tmp_path_factory):
    """Paths of one page of each kind."""
    folder = tmp_path_factory.mktemp("pages")
    for name, make in PAGES.items():
        (folder / f"{name}.html").write_text(make().html(), encoding="utf-8")
    return {name: folder / f"{name}.html" for name in PAGES}


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    with opened(tmp_path_factory.mktemp("profile")) as tab:
        yield tab


@pytest.mark.parametrize("name", PAGES)
def test_a_page_is_small(pages, name):
    assert pages[name].stat().st_size < BOUND


@pytest.mark.parametrize("reader", READERS)
@pytest.mark.parametrize("name", PAGES)
def test_nothing_overlaps_is_cut_off_or_empty_and_all_can_be_read(pages, browser, name, reader):
    browser.show(pages[name], *READERS[reader], dark=False)
    assert browser.run(FAULTS) == []
    light = browser.run(CONTRAST)
    browser.scheme(dark=True)
    dark = browser.run(CONTRAST)
    assert (light["ground"] > 0.9, dark["ground"] < 0.05) == (True, True)
    for seen in (light, dark):
        assert seen["text"] > 4.5
        assert seen["labels"] > 4.5
        assert seen["lines"] > 1.5  # faint lines are still visible
    assert browser.problems == []


def test_faults_that_are_planted_are_found(pages, browser):
    browser.show(pages["rig"], *READERS["phone"], dark=False)
    browser.run("document.querySelector('.sheet .tick').after(document.querySelector('.sheet .tick').cloneNode(true))")
    browser.run("document.querySelectorAll('#figure-2 .mark').forEach((mark) => mark.remove())")
    browser.run("document.querySelector('h1').style.width = '500px'")
    faults = " / ".join(browser.run(FAULTS))
    for wanted in ("overlap in figure-1", "empty panel: figure-2", "beyond the page: H1", "the page is"):
        assert wanted in faults


def test_a_name_of_the_legend_hides_its_line_and_dragging_zooms(pages, browser):
    browser.show(pages["rig"], *READERS["desk"], dark=False)
    count = "document.querySelectorAll('#figure-1 .mark').length"
    before = browser.run(count)
    browser.run("document.querySelector('#figure-1 .key').click()")
    assert browser.run(count) < before
    browser.run("document.querySelector('#figure-2').scrollIntoView()")
    box = browser.run("document.querySelector('#figure-2 .ground').getBoundingClientRect().toJSON()")
    ticks = "[...document.querySelectorAll('#figure-2 .tick[text-anchor=middle]')].map((text) => +text.textContent)"
    whole = browser.run(ticks)
    across = [box["x"] + share * box["width"] for share in (0.25, 0.5)]
    browser.drag(across[0], across[1], box["y"] + 30)
    zoomed = browser.run(ticks)
    assert (min(whole), max(whole)) == (0.0, pytest.approx(7.0, abs=1.1))
    assert 1.9 < min(zoomed) < max(zoomed) < 4.1  # a quarter to a half of 8 s
    assert "N" in browser.run("document.querySelector('#figure-2 .tip').textContent")


def test_a_colour_that_may_be_invisible_on_dark_is_refused():
    fig = test_report.prediction()
    fig.data[0].line.color = "#123456"
    with pytest.raises(ValueError, match="#123456 is in no scheme"):
        drawing(fig, Arrays())
