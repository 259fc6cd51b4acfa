"""Tuning any rig: its limits, a reachable profile, first gains scaled to its speed of response, and fixed channels."""

import json
from dataclasses import asdict, replace

import numpy as np
import pytest
from builders import FAST_PITCH

from identification.tune.controllers import DESIGNED, controllers, sampling
from identification.tune.profile import rig_profile
from identification.tune.tune import TuningTask
from vpp_fmu.errors import BadInput
from vpp_fmu.kernel.controller import CONTROLLER, DUAL
from vpp_fmu.kernel.plant import FINE_TUNED, plant
from vpp_fmu.kernel.scales import PAPER, Scales
from vpp_fmu.parameters import ParameterSet, read_parameters, to_json
from vpp_fmu.rig import Rig

MICRO = Rig("micro", (6660.0, 20000.0), (-12.0, 12.0), (0.0, 1.2), scales=Scales(20000.0, 20.0, 6.0, 1.2, 0.1))
LARGE = Rig("large", (832.0, 2500.0), (0.0, 25.0), (5.0, 180.0), scales=Scales(2500.0, 20.0, -6.0, 200.0, 0.8))
PACE = {"micro": 0.3, "large": 3.0}
"""How many times as slow as the paper's plant."""


def on(rig, slower=1.0, **values):
    """The paper's normalised model on another rig, with other time scales."""
    lags = {name: slower * value for name, value in {**FINE_TUNED, **FAST_PITCH}.items() if name.startswith("tau")}
    return ParameterSet(plant(scales=rig.scales), source={"rig": rig.summary()}).replaced({**lags, **values})


def by_hand(rig, omega, beta):
    """The paper's eq. 8 [N] at speed [rpm] and pitch [deg]."""
    s, c = rig.scales, FINE_TUNED
    w, b = omega / s.omega_scale, (beta + s.beta_offset) / s.beta_scale
    normal = c["c20"] * w**2 + c["c11"] * w * b + c["c21"] * w**2 * b + c["c12"] * w * b**2 + c["c30"] * w**3
    return s.thrust_scale * normal


def any_rig(rng):
    scales = Scales(10 ** rng.uniform(2.5, 4.8), rng.uniform(2.0, 40.0), rng.uniform(-20.0, 20.0), 10 ** rng.uniform(-1.5, 3.0))
    speed = tuple(scales.omega_scale * np.array([rng.uniform(0.1, 0.5), rng.uniform(0.7, 1.2)]))
    pitch = tuple(scales.absolute(b, "position") for b in (rng.uniform(-0.3, 0.3), rng.uniform(0.5, 1.1)))
    low = by_hand(Rig(scales=scales), speed[0], pitch[0])
    thrust = (low - 0.1 * scales.thrust_scale, scales.thrust_scale * rng.uniform(0.3, 1.2))
    return Rig("any", speed, pitch, thrust, scales=scales)


def test_the_profile_stays_within_the_reach_of_random_rigs():
    rng = np.random.default_rng()
    for _ in range(100):
        rig = any_rig(rng)
        own = controllers(on(rig))
        wanted = rig_profile(on(rig), own.settings)["thrust_set"]
        # Of the dual the ends are both channels' ends; of speed alone, speed's at the highest pitch.
        low = max(rig.thrust[0], by_hand(rig, rig.speed[0], rig.pitch[0]), by_hand(rig, rig.speed[0], rig.pitch[1]))
        high = min(rig.thrust[1], by_hand(rig, rig.speed[1], rig.pitch[1]))
        assert low - 1e-9 * abs(low) <= wanted.min() < wanted.max() <= high * (1.0 + 1e-9), rig
        for settings in own.settings.values():
            ends = [settings[f"{u}_{end}"] for u in ("omega", "beta") for end in ("min", "max")]
            assert ends == [*rig.speed, *rig.pitch]
            assert settings["beta_fixed"] == rig.pitch[1]
            assert all(settings[n] == value for n, value in asdict(rig.scales).items() if n != "time_scale")


@pytest.mark.parametrize("rig", [MICRO, LARGE], ids=lambda rig: rig.name)
def test_first_gains_hold_another_rig_within_its_limits(rig):
    parameters = on(rig, PACE[rig.name])
    own = controllers(parameters)
    profile = rig_profile(parameters, own.settings)
    assert own.reference == "scaled"
    for settings in own.settings.values():
        objective = TuningTask(parameters, profile).objective(settings)
        run = objective.run(objective.gains)
        assert rig.speed[0] <= run["omega_ref"].min() <= run["omega_ref"].max() <= rig.speed[1]
        assert rig.pitch[0] <= run["beta_ref"].min() <= run["beta_ref"].max() <= rig.pitch[1]
        assert [s.settling is not None and s.overshoot < 5.0 for s in objective.steps(objective.gains)] == [True, True]


@pytest.mark.parametrize("slower", [0.25, 4.0])
def test_scaled_gains_are_the_same_loop_at_another_pace(slower):
    """Plant, sampling, filter and gains are all r times as slow: the same numbers, sample by sample."""
    shown = []
    for r in (1.0, slower):
        rig = Rig(scales=replace(PAPER, time_scale=0.5 * r))
        lags = {f"tau_{u}_{k}": 0.5 * r * DESIGNED[u] for u in DESIGNED for k in (1, 2)}
        parameters = on(rig, **lags)
        settings = controllers(parameters, sample_time=0.004 * r).settings["dual"]
        objective = TuningTask(parameters, rig_profile(parameters, {"dual": settings})).objective(settings)
        shown.append(objective.run(objective.gains)["thrust"])
    np.testing.assert_allclose(shown[1], shown[0], rtol=1e-6)


def test_rigs_about_as_fast_as_the_papers_keep_the_published_gains_and_sampling():
    own = controllers(ParameterSet(plant()).replaced(FAST_PITCH))
    assert own.reference == "published"
    assert {n: own.settings["dual"][n] for n in DUAL} == DUAL
    assert own.settings["dual"]["sample_time"] == 0.004
    assert own.settings["dual"]["t_filter"] == 0.02


@pytest.mark.parametrize(("lag", "expected"), [(0.225, 0.004), (0.04, 0.004), (0.8, 0.004), (0.01, 0.001), (4.0, 0.02)])
def test_the_sampling_is_the_usual_one_unless_the_plant_needs_another(lag, expected):
    assert sampling(lag, 0.004) == pytest.approx(expected)


def fixed(**ranges):
    return replace(MICRO, thrust=(0.0, 1.2), **ranges)


def test_a_fixed_pitch_leaves_speed_alone_and_a_fixed_speed_pitch():
    no_pitch = controllers(on(fixed(pitch=(10.0, 10.0)), PACE["micro"]))
    assert list(no_pitch.settings) == ["speed_only"]
    assert no_pitch.left_out == {"dual": "the rig's pitch is fixed at 10 deg"}
    assert no_pitch.settings["speed_only"]["beta_fixed"] == 10.0
    parameters = on(fixed(speed=(15000.0, 15000.0)), PACE["micro"])
    no_speed = controllers(parameters)
    assert list(no_speed.settings) == ["dual"]
    objective = TuningTask(parameters, rig_profile(parameters, no_speed.settings)).objective(no_speed.settings["dual"])
    assert objective.names == ("kp_beta", "ki_beta", "kd_beta")
    with pytest.raises(BadInput, match="speed fixed at 15000 rpm and pitch at 10 deg"):
        controllers(on(fixed(speed=(15000.0, 15000.0), pitch=(10.0, 10.0))))


def test_the_command_on_a_rig_of_fixed_pitch(tmp_path, printed, short_search):
    (tmp_path / "plant.json").write_text(to_json(on(fixed(pitch=(10.0, 10.0)), PACE["micro"])))
    said = printed("tune", "--parameters", tmp_path / "plant.json", "-o", tmp_path / "out")
    assert "no gains for both actuators: the rig's pitch is fixed at 10 deg" in said
    assert "6660 to 20000 rpm, 10 deg" in said
    assert not (tmp_path / "out" / "gains.json").exists()
    gains = read_parameters(tmp_path / "out" / "gains_speed_only.json", lambda _: CONTROLLER)
    limits = [gains.values[n] for n in ("omega_min", "omega_max", "beta_fixed", "thrust_scale")]
    assert limits == [6660.0, 20000.0, 10.0, 1.2]
    assert gains.rig == replace(fixed(pitch=(10.0, 10.0)), origin=gains.rig.origin)
    content = json.loads((tmp_path / "out" / "tuning.json").read_text())
    assert list(content["controllers"]) == ["speed_only"]
    assert content["left_out"] == {"dual": "the rig's pitch is fixed at 10 deg"}
