"""`vpp effects`: a page of theory, generated from the declarations."""

import re
from pathlib import Path

from vpp_fmu.app.cli import main
from vpp_fmu.app.report.pages.effects import effects_page
from vpp_fmu.kernel.plant import LIBRARY
from vpp_fmu.own_effects import library_with

OPTIONAL = [e for e in LIBRARY if e.off is not None]
OWN = Path(__file__).with_name("own_effect.py")


def test_every_effect_is_listed(printed):
    listed = [line.split()[0] for line in printed("effects", "--effects-from", OWN).splitlines()]
    assert listed == [*(e.name for e in OPTIONAL), "cell_lag"]


def test_every_effect_has_its_equation_its_bounds_and_its_response():
    chosen = [e for e in library_with([OWN]) if e.name in ("pitch_backlash", "pitch_delay", "speed_reading_delay", "cell_lag")]
    page = effects_page(chosen, library_with([OWN]))
    text = page.html()
    assert len(page.figures) == len(chosen)
    assert "<pre>driven &lt;- clip(driven, drive - half_gap, drive + half_gap)</pre>" in text
    assert "<pre>beta_ref(t) acts at t + delay</pre>" in text
    assert "time constant of the amplifier" in text
    for figure in page.figures:
        size = float(re.search(r"by ([-0-9.e]+)", figure.title)[1])
        assert size > 0.0


def test_the_page_is_written(tmp_path, monkeypatch):
    monkeypatch.setattr(
        "vpp_fmu.app.cli.effects.library_with", lambda paths: tuple(e for e in LIBRARY if e.off is None or e is OPTIONAL[3])
    )
    assert main(["effects", "--html", str(tmp_path / "effects.html")]) == 0
    assert "<h2" in (tmp_path / "effects.html").read_text()
