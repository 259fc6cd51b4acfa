"""Commands stay within the range and the slews of any rig; and the declarations of a rig.json."""

from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from math import inf, isfinite

import numpy as np
import pytest
from builders import declared

from hil.campaign import steep
from hil.commands import grid as campaign_grid
from hil.commands import open_loop, steps, validation
from hil.loop.cycle import PERIOD
from hil.safety.limits import Limiter, limits_of
from identification.diagnose.experiment import discriminating_experiment
from identification.plan.excitation import candidate, paper_plan, variant
from identification.plan.plan import plan
from identification.tune.profile import step_profile
from vpp_fmu.commands import commanded, idle
from vpp_fmu.errors import BadInput
from vpp_fmu.kernel.plant import BASE
from vpp_fmu.kernel.scales import Scales
from vpp_fmu.record import Record
from vpp_fmu.rig import DECLARED, Rig, declared_rig, infer_rig, read_rig

ROUNDING = 1e-9
"""Relative rounding error that is allowed for a sum of floating-point numbers."""


class Count:
    """Numbers of commands checked, and of those outside their range or steeper than their slew, each by the commands' source. A
    command is one row of one channel; ranges and slews are checked independently of the code that makes the commands."""

    def __init__(self):
        self.checked, self.wrong = Counter(), Counter()

    def add(self, name: str, rig: Rig, commands: np.ndarray, step: float = inf) -> None:
        """Check commands (rows, 2) of speed [rpm] and pitch [deg], every `step` s; infinite: they are not consecutive."""
        channels = zip(commands.T, (rig.speed, rig.pitch), (rig.speed_slew, rig.pitch_slew), strict=True)
        for column, (low, high), slew in channels:
            self.within(name, column, low, high)
            if isfinite(slew) and isfinite(step):
                allowed = slew * step * (1.0 + ROUNDING) + ROUNDING * max(abs(low), abs(high))
                self.wrong[f"{name}, steeper"] += int(np.sum(np.abs(np.diff(column)) > allowed))

    def within(self, name: str, column: np.ndarray, low: float, high: float) -> None:
        """Check one channel's range, exactly and as a file has it."""
        written = np.array([float(f"{x:.9g}") for x in np.unique(column)])
        self.checked[name] += len(column)
        outside = ~((column >= low) & (column <= high))
        self.wrong[f"{name}, outside"] += int(np.sum(outside)) + int(np.sum((written < low) | (written > high)))


def random_rig(rng: np.random.Generator) -> Rig:
    """A rig of 100 to 60 000 rpm, 0.02 to 5 s, any pitch, with slews or without; a channel is fixed in one of eight."""
    top = np.exp(rng.uniform(np.log(100.0), np.log(60000.0)))
    speed = _span(rng, top * rng.uniform(0.0, 0.9), top)
    kinds = (
        (-5.0, 10.0),
        (12.0, 25.0),
        tuple(np.sort(rng.uniform(-30.0, -1.0, 2))),
        tuple(np.sort(rng.uniform(-40.0, 40.0, 2))),
    )
    pitch = _span(rng, *kinds[rng.integers(len(kinds))])
    force = np.exp(rng.uniform(np.log(0.1), np.log(1000.0)))
    measured = {
        "omega_ref": np.array(speed),
        "beta_ref": np.array(pitch),
        "thrust": force * np.array([rng.uniform(-0.5, 0.2), 1.0]),
    }
    unit = float(np.exp(rng.uniform(np.log(0.02), np.log(5.0))))
    rig = infer_rig([], measured, {}).timed(unit)
    spans = (speed[1] - speed[0]) or speed[1], (pitch[1] - pitch[0]) or 1.0
    slews = [
        inf if rng.random() < 0.5 else float(f"{size / unit * np.exp(rng.uniform(np.log(0.1), np.log(30.0))):.6g}")
        for size in spans
    ]
    return replace(rig, speed_slew=slews[0], pitch_slew=slews[1])


def _span(rng: np.random.Generator, low: float, high: float) -> tuple[float, float]:
    """Two ends as a file has them, with two to eight digits; equal in one of eight."""
    low, high = (float(f"{x:.{rng.integers(2, 9)}g}") for x in (low, high))
    return (high, high) if rng.random() < 0.125 or not low < high else (low, high)


def check(rig: Rig, rng: np.random.Generator, count: Count) -> None:
    """All checks but the search for a plan."""
    for name, commands, step in _experiments(rig, rng):
        count.add(name, rig, commands, step)
    for name, asked in _campaign(rig, rng):
        count.add(name, rig, asked, PERIOD if name.startswith("hil, record") else inf)
        count.add(f"{name}, behind the limits", rig, _acting(rig, asked), PERIOD)
    count.add("idle", rig, np.array([idle(rig)]))
    count.within("step profile, N", step_profile(rig)["thrust_set"], *rig.thrust)


def check_plan(rig: Rig, count: Count) -> None:
    """Check a whole plan from a short search."""
    unit = rig.scales.time_scale
    lags = {
        f"tau_{u}_{k}": share * unit
        for u, k, share in (("omega", 1, 0.3), ("omega", 2, 0.1), ("beta", 1, 0.7), ("beta", 2, 0.3))
    }
    found = plan(BASE.sized(rig.scales), lags, rig, 20.0 * unit, evaluations=6)
    count.add("plan", rig, _columns(found.commands), found.step)


def _experiments(rig: Rig, rng: np.random.Generator) -> Iterator[tuple[str, np.ndarray, float]]:
    """(name, commands, step) of segments as the search for a plan has them, and of a diagnosis' next experiment."""
    step, seed = 0.04 * rig.scales.time_scale, int(rng.integers(2**31))
    for _ in range(3):
        segment = candidate(rng, 250, step, rig)
        for targets in (segment, variant(rng, segment, step, rig)):
            yield "plan, segment", commanded(rig, targets, step), step
        yield "plan, segment as sampled", commanded(rig, segment.repeat(4, axis=0), 0.25 * step), 0.25 * step
    yield "plan, the paper's", commanded(rig, paper_plan(rng, 500, step, rig), step), step
    period = (None, 0.02 * rig.scales.time_scale, 0.1)[rng.integers(3)]
    record = discriminating_experiment(rig, seed, period)
    yield "next experiment", _columns(record), float(record.time[1])


def _campaign(rig: Rig, rng: np.random.Generator) -> Iterator[tuple[str, np.ndarray]]:
    """(name, commands) that `vpp hil campaign` sends."""
    seed = int(rng.integers(2**31))
    yield "hil, grid", np.array(campaign_grid(4, rig))
    found = steps(2, rig)
    if found:
        yield "hil, steps", np.array([end for one in found for end in (one.before, one.after) for _ in range(3)])
    yield "hil, record of the open loop", _columns(open_loop(seed, 1.0, PERIOD, rig))
    yield "hil, record of the validation", _columns(validation(seed, 1.0, PERIOD, rig))


def _acting(rig: Rig, asked: np.ndarray) -> np.ndarray:
    """The commands after the rig's limits in a campaign, (rows, 2)."""
    limiter = Limiter(steep(limits_of(rig), rig), *asked[0].tolist())
    return np.array([limiter.apply(*row, PERIOD)[:2] for row in asked.tolist()])


def _columns(record: Record) -> np.ndarray:
    return np.column_stack([record["omega_ref"], record["beta_ref"]])


def test_no_command_leaves_its_range_or_slew_on_random_rigs():
    """Of any size; two rigs also get the search for a whole plan, which takes a hundred times as long."""
    count = Count()
    for k in range(30):
        rng = np.random.default_rng([1, k])
        rig = random_rig(rng)
        check(rig, rng, count)
        if k % 15 == 0:
            check_plan(rig, count)
    assert not any(count.wrong.values()), count.wrong
    names = ("plan", "plan, segment", "next experiment", "hil, grid", "hil, steps", "step profile, N")
    assert all(count.checked[name] > 25 for name in names)


def test_a_step_becomes_a_ramp_of_the_slews_slope_in_whole_tenths():
    rig = Rig(speed=(2013.37, 5987.7), speed_slew=6000.0)
    told = commanded(rig, np.array([[0.0, 1.23456]] + [[1e9, 1.23456]] * 200), 0.005)
    assert told[0, 0] == 2013.4
    np.testing.assert_allclose(np.diff(told[:130, 0]), 30.0, rtol=1e-12)
    assert told[-1, 0] == 5987.7
    assert set(told[:, 1]) == {1.235}


@pytest.mark.parametrize(
    ("speed", "wanted", "told"),
    [
        ((100.0, 250.0), 123.45678, 123.46),
        ((12345.678, 60000.0), 12345.0, 12346.0),
        ((4321.09, 4321.09), 5000.0, 4321.09),
        ((4321.0987, 4321.09870001), 5000.0, 4321.0987),
    ],
)
def test_commands_are_rounded_to_a_resolution_that_suits_their_range(speed, wanted, told):
    assert commanded(Rig(speed=speed), np.array([[wanted, 0.0]]), 0.004)[0, 0] == told


def test_a_slow_slew_gets_the_digits_that_it_needs():
    told = commanded(Rig(pitch_slew=0.05), np.array([[2000.0, 0.0]] + [[2000.0, 5.0]] * 100), 0.004)
    np.testing.assert_allclose(np.diff(told[:, 1]), 0.0002, rtol=1e-6)


@pytest.mark.parametrize(
    ("pitch", "beta"), [((-10.0, 10.0), 0.0), ((12.0, 25.0), 12.0), ((-20.0, -3.5), -3.5), ((4.0, 4.0), 4.0)]
)
def test_a_loop_begins_from_the_lowest_speed_and_the_pitch_next_to_0(pitch, beta):
    assert idle(Rig(speed=(900.0, 2500.0), pitch=pitch)) == (900.0, beta)


def test_the_step_profile_is_the_papers_and_leaves_room_on_other_rigs():
    np.testing.assert_allclose(step_profile()["thrust_set"], [1.5, 12.0, 1.5, 1.5])
    np.testing.assert_allclose(step_profile().time, [0.0, 3.0, 6.0, 9.0])
    large = Rig(thrust=(40.0, 140.0), scales=Scales(2500.0, 20.0, -6.0, 200.0, 2.0))
    np.testing.assert_allclose(step_profile(large)["thrust_set"], [43.0, 137.0, 43.0, 43.0])
    assert step_profile(large).time[-1] == 36.0


def test_the_discriminating_experiment_of_the_papers_rig():
    found = discriminating_experiment(Rig())
    assert found.time[-1] == pytest.approx(96.0, abs=0.1)
    assert found.period == 0.004
    assert (found["omega_ref"].min(), found["omega_ref"].max(), found["beta_ref"].max()) == (2000.0, 6000.0, 10.0)
    assert found["beta_ref"].min() < -4.0
    sizes = np.unique(np.round(np.abs(np.diff(found["beta_ref"])), 3))
    for share in (0.02, 0.05, 0.1, 0.2):
        assert np.abs(sizes - 15.0 * share).min() < 2e-3  # the stairs
    first, last = found.part(slice(None, 700)), found.part(slice(-700, None))
    for rest in (first, last):
        assert set(rest["omega_ref"]) == {2000.0}
        assert set(rest["beta_ref"]) == {2.5}


RANGES = {"speed": {"min": 6660, "max": 20000}, "pitch": {"min": -12, "max": 12}, "thrust": {"min": -0.1, "max": 1.15}}


def test_a_rig_json_alone_declares_a_rig(tmp_path):
    rig = declared_rig(declared(tmp_path / "rig.json", **RANGES, slew={"pitch": 200}))
    assert (rig.speed, rig.pitch, rig.pitch_slew) == ((6660.0, 20000.0), (-12.0, 12.0), 200.0)
    assert (rig.scales.omega_scale, rig.scales.thrust_scale) == (20000.0, 1.2)
    assert rig.unknown == ()
    assert "slew of pitch 200 deg/s (rig.json)" in rig.command_lines()
    for name in RANGES:
        less = {key: entry for key, entry in RANGES.items() if key != name}
        with pytest.raises(BadInput, match=f"{name}: found nothing"):
            declared_rig(declared(tmp_path / "less.json", **less))


def test_a_rig_json_overrides_measured_ranges_and_keeps_the_scales(tmp_path):
    measured = replace(Rig(), origin={"speed": "the campaign", "pitch": "the campaign"})
    rig = declared_rig(declared(tmp_path / "rig.json", speed=RANGES["speed"], scales={"omega_scale": 30000}), measured)
    assert (rig.speed, rig.pitch, rig.scales) == ((6660.0, 20000.0), measured.pitch, measured.scales)
    assert rig.origin == {"speed": DECLARED, "pitch": "the campaign"}
    path = declared(tmp_path / "rig.json", scales={"time_scale": 2.0, "omega_scale": 30000})
    assert declared_rig(path, Rig()).scales == replace(Rig().scales, time_scale=2.0)  # which is no scale of the map


@pytest.mark.parametrize(("name", "unit", "own"), [("speed", "rad/s", "rpm"), ("pitch", "rad", "deg"), ("thrust", "kgf", "N")])
def test_a_range_in_another_unit_is_refused(tmp_path, name, unit, own):
    right = {**RANGES, name: RANGES[name] | {"unit": own}}
    assert getattr(declared_rig(declared(tmp_path / "rig.json", **right)), name) == tuple(RANGES[name].values())
    wrong = {**RANGES, name: RANGES[name] | {"unit": unit}}
    with pytest.raises(BadInput, match=f'{name}, unit: found "{unit}", expected "{own}"'):
        declared_rig(declared(tmp_path / "rig.json", **wrong))


@pytest.mark.parametrize(
    ("entries", "said"),
    [
        ({"speed": {"min": 3000, "max": 2999}}, "speed, max: found 2999, expected at least its min, 3000 rpm"),
        ({"slew": {"pitch": 0}}, "slew, pitch: found 0"),
        ({"scales": {"omega_scale": 0}}, "scales, omega_scale: found 0"),
        ({"scales": {"beta_offset": -1001}}, "scales, beta_offset: found -1001, expected a number from -1000 to 1000"),
        ({"mass": 3}, "mass: found an unknown field"),
        ({"speed": {"min": 0, "max": 1, "mean": 1}}, "speed, mean: found an unknown field"),
    ],
)
def test_impossible_values_in_a_rig_json_are_refused_with_their_field(tmp_path, entries, said):
    with pytest.raises(BadInput, match=said):
        read_rig(declared(tmp_path / "rig.json", **entries))


def grid(speed, pitch, thrust):
    """Steady points at the ends of these ranges, repeated so that none is an outlier."""
    columns = {"omega_ref": speed, "beta_ref": pitch, "thrust": thrust}
    return {name: np.repeat(np.array(ends, float), 50) for name, ends in columns.items()}


PAPERS_RANGES = (2000.0, 6000.0), (-10.0, 10.0), (0.0, 14.0)


@pytest.mark.parametrize(
    ("k", "inside", "beyond"),
    [
        (0, (2000.0, 12000.0), (2000.0, 12001.0)),
        (0, (500.0, 3000.0), (500.0, 2999.0)),
        (1, (-12.5, 17.5), (-12.6, 17.5)),
        (1, (-12.5, 17.5), (-12.5, 17.6)),
        (2, (0.0, 30.0), (0.0, 30.1)),
        (2, (-7.5, 0.0), (-7.4, 0.0)),
    ],
)
def test_a_rig_keeps_the_papers_scales_up_to_twice_its_size_and_down_to_half(k, inside, beyond):
    """Speed 6000 rpm, thrust 15 N of either sign; pitch half of its 15 deg beyond the ends of the scale, -5 and 10 deg."""
    ranges = [[*PAPERS_RANGES[:k], ends, *PAPERS_RANGES[k + 1 :]] for ends in (inside, beyond)]
    near, far = (infer_rig([], grid(*own), {}) for own in ranges)
    assert (near.scales, near.origin["scales"]) == (Scales(), "the paper's, whose size it has")
    assert far.scales != Scales()
    assert far.origin["scales"] == "round numbers for what was measured"


def test_declared_ranges_override_measured_ones():
    record = Record({"time": np.arange(3.0), "omega_ref": np.array([0.0, 7000.0, 0.0]), "beta_ref": np.zeros(3)}, "a record")
    points = grid(*PAPERS_RANGES)
    both = infer_rig([record], points, {"pitch": (-9.0, 9.0), "scales": {"thrust_scale": 20.0}})
    assert (both.speed, both.pitch, both.thrust) == ((0.0, 7000.0), (-9.0, 9.0), (0.0, 14.0))
    assert both.scales == replace(Scales(), thrust_scale=20.0)
    papers = "the paper's, whose size it has"
    assert both.origin == {
        "speed": "the campaign",
        "pitch": DECLARED,
        "thrust": "the campaign",
        "scales": f"thrust_scale: rig.json; {papers}",
    }
    whole = {"omega_scale": 6000.0, "beta_scale": 15.0, "beta_offset": 5.0, "thrust_scale": 15.0}
    assert infer_rig([], points, {"scales": whole}).origin["scales"] == f"{', '.join(whole)}: rig.json"
    assert infer_rig([], points, {}).origin["scales"] == papers
