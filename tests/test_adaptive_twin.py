"""The adaptive twin as a model: the same bits in Python and C, and estimates that agree with closed forms."""

import numpy as np
import pytest
from builders import OPTIONAL
from fmpy.validation import validate_fmu
from scipy.interpolate import RegularGridInterpolator

from vpp_fmu.export import python_fmu
from vpp_fmu.fmu import Fmu, FmuInstance
from vpp_fmu.kernel.ops import NUMBERS
from vpp_fmu.kernel.plant import plant
from vpp_fmu.kernel.simulation import Simulation
from vpp_fmu.kernel.twin.model import DAILY, adapted_by_default, twin
from vpp_fmu.kernel.twin.noises import BETWEEN, NODE, NODES, weights
from vpp_fmu.kernel.twin.prediction import BROUGHT
from vpp_fmu.kernel.twin.watch import LATELY, threshold, watched
from vpp_fmu.native import Simulator
from vpp_fmu.native.stepper import Stepper

DT = 0.004
PLANT = plant(BROUGHT)
ADAPTED = adapted_by_default(PLANT.values())
TWIN = twin(PLANT, ADAPTED)


def driven(rows, seed=1, hold=250, **changed):
    """Commands in steps, and noise-free readings of the plant with `changed` parameters."""
    rng = np.random.default_rng(seed)
    count = -(-rows // hold)
    told = {
        "omega_ref": np.repeat(rng.uniform(2500.0, 5800.0, count), hold)[:rows],
        "beta_ref": np.repeat(rng.uniform(-3.0, 9.0, count), hold)[:rows],
    }
    values = {name.replace("__", "."): value for name, value in changed.items()}
    shown = Simulator(PLANT).simulate(values, told, np.full(rows - 1, DT))
    return told | {"thrust": shown[:, 0], "omega": shown[:, 1]}


def ran(inputs, values=None, model=TWIN):
    simulator = Simulator(model)
    shown = simulator.simulate(values or {}, inputs, np.full(len(inputs["thrust"]) - 1, DT))
    return dict(zip(simulator.outputs, shown.T, strict=True))


def noisy(inputs, seed=2, white=0.05):
    return inputs | {"thrust": inputs["thrust"] + white * np.random.default_rng(seed).standard_normal(len(inputs["thrust"]))}


def test_fmu_and_stepper_are_the_simulator_to_the_bit(tmp_path, request, recwarn):
    """The stepper compiled and without a compiler. `test_twin` has the native FMU, which compiles for long."""
    inputs = noisy(driven(120, hold=40, sensor_gain__gain=0.9))
    expected = np.column_stack(list(ran(inputs).values()))[1:].tolist()
    given = np.column_stack([inputs.get(u.name, np.zeros(120)) for u in TWIN.inputs]).tolist()
    (tmp_path / "twin.fmu").write_bytes(python_fmu(TWIN))
    assert validate_fmu(str(tmp_path / "twin.fmu")) == []
    fmu, compiled = Fmu(tmp_path / "twin.fmu"), Stepper(TWIN)
    one = FmuInstance(fmu, [u.name for u in TWIN.inputs], [y.name for y in TWIN.outputs])
    one.start(given[0])
    assert [step(row) for step in [one.stepper(DT)] for row in given[:-1]] == expected
    one.close()
    fmu.close()
    compiled.start(given[0])
    assert [compiled.step(row, DT) for row in given[:119]] == expected
    small = twin(PLANT, ADAPTED[:1])  # as generated Python a whole one takes seconds to be made
    alone = np.column_stack(list(ran(inputs, model=small).values()))[1:31].tolist()
    request.getfixturevalue("no_compiler")
    stepper = Stepper(small)
    stepper.start(given[0])
    assert [stepper.step(row, DT) for row in given[:30]] == alone


def test_beside_an_identical_plant_the_innovation_is_zero():
    """Without noise the innovation is 0 to the bit, and only the uncertainties change."""
    shown = ran(driven(3000))
    assert not np.any(shown["residual"])
    assert not np.any(shown["alarm"])
    for name in ADAPTED:
        assert np.all(shown[f"adapted.{name}"][1:] == PLANT.values()[name])
        assert np.all(np.diff(shown[f"std.{name}"][1:]) < 1e-3 * shown[f"std.{name}"][1])


def test_one_parameter_at_rest_has_the_bayesian_posterior():
    """At one place: reading = offset + model error there + white noise, whose mean of n has variance var / n.

    The model error there is interpolated from the four nodes around, at 3/4 of speed and 3/5 of pitch, plus the error between
    nodes.
    """
    model, rows = twin(PLANT, ["sensor_drift.offset"]), 5000
    at = {"omega_ref": np.full(rows, 4500.0), "beta_ref": np.full(rows, 4.0)}
    told = Simulation(PLANT).start({name: column[0] for name, column in at.items()})
    inputs = at | {"thrust": np.full(rows, told["thrust"] + 0.05), "omega": np.full(rows, told["omega"])}
    by_speed, by_pitch = (0.75, 0.25), (0.2, 0.8)
    nodes = sum((x * y) ** 2 for x in by_speed for y in by_pitch)
    own, there, white = 0.1**2, (NODE**2 * nodes + BETWEEN**2) * 0.03**2, 0.05**2
    shown = ran(inputs, {"slow": 0.0, "steady": 0.03, "white": 0.05, "prior.sensor_drift.offset": 0.1}, model)
    n = rows - 1
    assert shown["adapted.sensor_drift.offset"][-1] == pytest.approx(0.05 * own / (own + there + white / n), rel=1e-6)
    expected = own - own**2 / (own + there + white / n)
    assert shown["std.sensor_drift.offset"][-1] == pytest.approx(np.sqrt(expected), rel=1e-6)


def test_shares_of_the_nodes_are_linear_interpolation():
    rng = np.random.default_rng(3)
    at = np.column_stack([rng.uniform(1.0 / 3.0, 1.0, 50), rng.uniform(0.0, 1.0, 50)])
    ones = np.eye(12).reshape(3, 4, 12)
    for (w, b), expected in zip(at, RegularGridInterpolator(NODES, ones)(at), strict=True):
        assert weights(NUMBERS, w, b) == pytest.approx(expected, abs=1e-12)
    assert weights(NUMBERS, 0.1, 1.3) == [0.0, 0.0, 0.0, 1.0] + 8 * [0.0]  # beyond, the nearest one's


def test_a_known_model_error_is_not_taken_for_a_change():
    """On return to two places with a constant model error the twin learns nothing. If the thrust there changes by a plausible
    share, it raises an alarm."""
    rows, hold = 30_000, 1500
    at = np.arange(rows) // hold % 2
    told = {"omega_ref": np.choose(at, (3500.0, 5000.0)), "beta_ref": np.choose(at, (2.0, 6.0))}
    values, steps = PLANT.values(), np.full(rows - 1, DT)
    shown = Simulator(PLANT).simulate(values, told, steps)
    off = np.interp(shown[:, 1], (3500.0, 5000.0), (0.15, -0.15))
    inputs = noisy(told | {"thrust": shown[:, 0] + off, "omega": shown[:, 1]})
    same = ran(inputs, {"steady": 0.1})
    assert not np.any(same["alarm"])
    std = same["std.sensor_gain.gain"]
    assert std[-1] > 0.9 * std[rows // 3]  # the tenth visit adds no information to the third
    inputs["thrust"] = inputs["thrust"] * np.where(np.arange(rows) < rows // 2, 1.0, 0.9)
    changed = ran(inputs, {"steady": 0.1})
    assert not np.any(changed["alarm"][: rows // 2])
    assert np.any(changed["alarm"][rows // 2 :])


def test_a_constant_set_point_counts_as_one_visit():
    shown = ran(noisy({name: np.repeat(column[:1], 60_000) for name, column in driven(2).items()}))
    first, last = (shown["std.sensor_gain.gain"][k] for k in (5000, -1))
    assert last == pytest.approx(first, rel=0.05)
    assert shown["changes"][-1] == 0


def test_only_lags_that_the_data_excite_are_forgotten():
    """Pitch moves for a minute and is then constant for four, while speed moves on. The uncertainty of the pitch's lag does not
    increase, whatever the memory. That of the speed's lag increases with a shorter memory, at most to a plausible change. The
    gain is not affected."""
    inputs = driven(75_000)
    still = np.where(np.arange(75_000) < 15_000, inputs["beta_ref"], 3.0)
    inputs["thrust"] = Simulator(PLANT).simulate({}, inputs | {"beta_ref": still}, np.full(74_999, DT))[:, 0]
    inputs["beta_ref"] = still
    gain, (by_pitch, by_speed) = ADAPTED[0], ADAPTED[-2:]
    lags, gains = {}, {}
    for memory in (2.0, 20.0, 1e9):
        shown = ran(inputs, {"memory": memory, "speed_error": 1e5})  # learned from the thrust alone
        assert np.all(np.diff(shown[f"std.{by_pitch}"][16_000:]) < 1e-9)  # other learned parameters inform it, too
        lags[memory], gains[memory] = shown[f"std.{by_speed}"][-1], shown[f"std.{gain}"][-1]
    assert 1.5 * lags[1e9] < lags[2.0] < TWIN.values()[f"change.{by_speed}"]
    assert lags[1e9] < lags[20.0] < lags[2.0]
    assert gains[2.0] == pytest.approx(gains[1e9], rel=0.05)


@pytest.mark.parametrize(
    ("name", "before", "after"), [("sensor_gain.gain", 1.0, 0.85), ("pitch_offset.offset", 0.0, 2.0)], ids=["gain", "pitch"]
)
def test_a_change_of_a_parameter_is_detected_and_tracked(name, before, after):
    rows, at = 45_000, 22_500
    same, other = driven(rows, hold=625), driven(rows, hold=625, **{name.replace(".", "__"): after})
    changed = {q: np.where(np.arange(rows) < at, same[q], other[q]) for q in same}
    shown = ran(noisy(changed))
    assert not np.any(shown["alarm"][:at])
    assert np.flatnonzero(shown["alarm"])[0] < at + 30.0 / DT
    assert shown["alarm"][-1] == 0.0
    assert shown["changes"][-1] >= 1
    assert np.all(shown["learning"][1:] == 1.0)
    assert shown[f"adapted.{name}"][-1] == pytest.approx(after, abs=0.15 * abs(after - before))


def test_a_departure_from_the_identified_value_is_an_alarm_at_its_bayes_factor():
    """At rest, with the reading 0.4 N off from the start: the alarm comes a sample after the Savage-Dickey ratio of the offset
    exceeds its level."""
    model, rows = twin(PLANT, ["sensor_drift.offset"]), 1000
    at = {"omega_ref": np.full(rows, 4500.0), "beta_ref": np.full(rows, 4.0)}
    told = Simulation(PLANT).start({name: column[0] for name, column in at.items()})
    inputs = at | {"thrust": np.full(rows, told["thrust"] + 0.4), "omega": np.full(rows, told["omega"])}
    shown = ran(inputs, {"slow": 0.02, "steady": 0.03, "white": 0.5, "prior.sensor_drift.offset": 0.1}, model)
    offset, std = (shown[f"{kind}.sensor_drift.offset"][1:] for kind in ("adapted", "std"))
    factor = 0.5 * (offset**2 / std**2 + np.log(std**2 / 0.1**2))
    level = threshold(0.01, 1, DT) - np.log(LATELY / DT)
    assert np.flatnonzero(shown["alarm"])[0] == 2 + np.flatnonzero(factor > level)[0]
    assert shown["direction"][-1] == 1.0


def test_a_sudden_change_is_detected_while_the_commands_never_rest():
    """Under steps of 0.4 s each move's error hides a change of a parameter; the slow noise takes it up at first."""
    inputs = noisy(driven(17_000, hold=100))
    inputs["thrust"] = inputs["thrust"] + 2.0 * (np.arange(17_000) >= 15_000)
    alarms = np.flatnonzero(ran(inputs, {"steady": 0.05})["alarm"])
    assert 15_000 < alarms[0] < 15_000 + 3.0 / DT


def test_an_unexplained_change_stops_the_learning_and_restores_the_parameters():
    rows, at = 30_000, 15_000
    inputs = noisy(driven(rows))
    shaken = 1.5 * np.sin(2.0 * np.pi * 9.0 * DT * np.arange(rows)) * (np.arange(rows) >= at)
    inputs["thrust"] = inputs["thrust"] + shaken
    stopped = ran(inputs)
    assert stopped["alarm"][-1] == 1.0
    begins = np.flatnonzero(stopped["alarm"])[0]
    gives_up = 1 + np.flatnonzero(stopped["learning"][1:] == 0.0)[0]
    assert begins < gives_up  # it follows first, to see whether that explains it
    assert not np.any(stopped["learning"][gives_up:])
    for name in ADAPTED:  # back to where they were when nothing was suspicious yet
        path, left = stopped[f"adapted.{name}"], stopped[f"adapted.{name}"][-1]
        assert np.min(np.abs(path[at - 250 : begins] - left)) < 1e-12
    inputs["thrust"] -= shaken * (np.arange(rows) >= 25_000)
    inputs["acknowledge"] = (np.arange(rows) == 26_000).astype(float)
    seen = ran(inputs)
    assert seen["learning"][25_999] == 0.0
    assert (seen["alarm"][-1], seen["learning"][-1]) == (0.0, 1.0)


def test_adapted_parameters_stay_within_their_bounds():
    shown = ran(driven(6000, sensor_gain__gain=0.7), {"sensor_gain.gain": 1.29})
    assert np.all(shown["adapted.sensor_gain.gain"][1:] <= 1.3)
    assert np.all(shown["adapted.sensor_gain.gain"][1:] >= 0.7)


@pytest.mark.sampled("effect")
@pytest.mark.parametrize("effect", OPTIONAL, ids=lambda e: e.name)
def test_every_effects_plant_has_a_twin_that_starts_settled(effect):
    """Also with delayed commands, late rows, and forms that need short steps."""
    wider = plant({*BROUGHT, effect.name})
    values = {effect.full(name): value for name, value in effect.probe.items()}
    model = twin(wider, DAILY)
    one, own = Simulation(model, values | {f"prior.{name}": 0.0 for name in DAILY}), Simulation(wider, values)
    given = {"omega_ref": 4000.0, "beta_ref": 4.0}
    inputs = given | {u.name: 0.004 for u in wider.inputs if u.clock}
    thrust = own.start(inputs)["thrust"]
    reading = given | {"thrust": thrust, "omega": 4000.0}
    one.start(reading)
    for _ in range(5):
        assert one.advance(reading, DT)["predicted_thrust"] == pytest.approx(own.advance(inputs, DT)["thrust"], rel=1e-3)
    assert np.isfinite(list(one.states.values())).all()


def test_watched_parameters_and_the_alarm_threshold():
    assert watched(PLANT, ADAPTED) == DAILY
    assert threshold(0.01, 3, DT) == pytest.approx(np.log(8 * 3600.0 * 100.0 / DT))
    with pytest.raises(KeyError):
        twin(PLANT, ["tau_gamma"])
