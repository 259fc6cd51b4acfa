"""Bad data: one clear line, or a result that says what was left out."""

import numpy as np
import pytest

from identification.identify import identify
from identification.screening import screen
from vpp_fmu.campaign import Campaign
from vpp_fmu.errors import BadInput
from vpp_fmu.kernel.plant import BASE, FINE_TUNED
from vpp_fmu.native import Simulator
from vpp_fmu.record import Record


@pytest.fixture
def good():
    """20 s of the paper's model with 0.1 N of noise, both commands moving."""
    rng = np.random.default_rng(3)
    time = np.arange(5000) * 0.004
    commands = {"omega_ref": np.repeat(rng.uniform(2500, 5500, 20), 250), "beta_ref": np.repeat(rng.uniform(-4, 9, 20), 250)}
    outputs = Simulator(BASE).simulate({}, commands, np.full(4999, 0.004))
    noisy = outputs[:, 0] + rng.normal(0, 0.1, 5000)
    return Record({"time": time, **commands, "omega": np.round(outputs[:, 1]), "thrust": noisy}, "open_loop.csv")


def campaign_of(record):
    return Campaign(None, None, (), record, None, None)


REFUSED = {
    "two rows": (lambda r: r.part(slice(0, 2)), "rows"),
    "dead thrust sensor": (lambda r: r.with_columns(thrust=np.full(len(r), 0.4)), "thrust"),
    "constant commands": (lambda r: r.with_columns(omega_ref=np.full(len(r), 4000.0), beta_ref=np.zeros(len(r))), "omega_ref"),
    "speed in rad/s": (lambda r: r.with_columns(omega=r["omega"] * np.pi / 30), "omega"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_unusable_data_are_refused_in_one_line(case, good):
    spoil, field = REFUSED[case]
    with pytest.raises(BadInput) as refused:
        screen(spoil(good))
    said = str(refused.value)
    assert "\n" not in said
    for word in ("open_loop.csv", field, "found", "allowed"):
        assert word in said


def test_good_data_lose_nothing(good):
    screened = screen(good)
    assert screened.notes == ()
    np.testing.assert_array_equal(screened.record["thrust"], good["thrust"])


def test_clipped_rows_are_left_out_and_the_fit_stays_right(good):
    """Clipping at 8 N would bend the map; the rows at the limit are left out and said."""
    clipped = good.with_columns(thrust=np.minimum(good["thrust"], 8.0))
    screened = screen(clipped)
    assert any("sensor's limit" in note for note in screened.notes)
    left_out = np.isnan(screened.record["thrust"])
    assert (clipped["thrust"][left_out] == 8.0).all()
    assert left_out.sum() > 0.8 * (clipped["thrust"] == 8.0).sum()


def test_dead_speed_sensor_is_left_out(good):
    screened = screen(good.with_columns(omega=np.zeros(len(good))))
    assert any("speed sensor" in note for note in screened.notes)
    assert "omega" not in screened.record


def test_what_follows_a_gap_is_left_out(good):
    gap = good.part(np.r_[0:2000, 2250:5000])
    screened = screen(gap)
    assert any("a gap of 1.00 s" in note for note in screened.notes)
    left_out = np.isnan(screened.record["thrust"])
    assert left_out.sum() == pytest.approx(500, abs=2)


def test_a_record_with_holes_still_gives_its_parameters(good, tmp_path):
    """A tenth of the cells empty and a gap: within 5 standard deviations of the truth."""
    thrust = good["thrust"].copy()
    thrust[::10] = np.nan
    holed = good.with_columns(thrust=thrust).part(np.r_[0:2000, 2250:5000])
    campaign = Campaign(tmp_path, None, (), holed, None, None)
    found = identify(campaign, starts=1)
    assert found.left_out
    for name, std in found.refinement.std.items():
        truth = FINE_TUNED[name] if "beta" not in name else {"tau_beta_1": 0.374, "tau_beta_2": 0.207}[name]
        assert abs(found.refinement.values[name] - truth) < 5 * std + 1e-3, name
