"""Gymnasium environments: vector equals single to the bit, parameters are drawn from the posterior."""

import gymnasium
import numpy as np
import pytest
from builders import refusal
from gymnasium.utils.env_checker import check_env

from vpp_fmu.errors import BadInput
from vpp_fmu.gym import Reward, VppThrustEnv, VppThrustVectorEnv
from vpp_fmu.kernel.plant import FINE_TUNED, plant
from vpp_fmu.kernel.simulation import Simulation
from vpp_fmu.parameters import ParameterSet
from vpp_fmu.record import Record
from vpp_fmu.structured import as_json

WITH_DELAY = {"speed_delay.delay": 0.0091, "pitch_command_deadband.half_width": 0.8}
STD = {"tau_omega_1": 0.01, "tau_beta_1": 0.02, "c20": 0.005, "c21": 0.01}
CORRELATION = np.array([[1.0, 0.5, 0.0, 0.0], [0.5, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, -0.8], [0.0, 0.0, -0.8, 1.0]])


@pytest.fixture(scope="module")
def fitted(tmp_path_factory):
    """A folder with parameters and the identification.json of a fit with this correlation."""
    folder = tmp_path_factory.mktemp("fitted")
    ParameterSet(plant()).replaced({n: FINE_TUNED[n] for n in STD}, STD).save(folder)
    entries = {n: {"value": FINE_TUNED[n], "std": s} for n, s in STD.items()}
    content = {"parameters": entries, "correlation": {"names": list(STD), "matrix": CORRELATION.tolist()}}
    (folder / "identification.json").write_text(as_json(content | {"effects": [], "noise_floor_thrust": 0.13}))
    return folder


def model_with_delay():
    parameters = ParameterSet(plant(("speed_delay", "pitch_command_deadband")))
    return parameters.replaced(WITH_DELAY)


@pytest.mark.filterwarnings("ignore:.*render_fps.*")
@pytest.mark.parametrize("options", [{}, {"action": "rate", "history": 3, "observe": ("thrust_set", "thrust", "integral")}])
def test_gymnasium_accepts_it(options):
    check_env(gymnasium.make("VppThrust-v0", seconds=0.2, **options).unwrapped)


@pytest.mark.filterwarnings("ignore:no C compiler:RuntimeWarning")
@pytest.mark.parametrize("way", ["lanes", "delays", "uneven steps", "no compiler"])
def test_each_environment_of_many_is_a_single_one_to_the_bit(way, fitted, request):
    if way == "no compiler":
        request.getfixturevalue("no_compiler")
    options = {"seconds": 0.08, "hold": 2, "noise": (0.1, 5.0), "history": 2}
    if way in ("lanes", "no compiler"):
        options |= {"parameters": str(fitted), "randomise": True}
    elif way == "delays":
        options |= {"parameters": model_with_delay()}
    else:  # the longest step differs between neighbours: some have a slow sensor, some have none
        own = ParameterSet(plant(("sensor_lag",))).replaced(
            {"sensor_lag.time_constant": 0.0}, {"sensor_lag.time_constant": 0.01}
        )
        options |= {"parameters": own, "randomise": True, "dt": 0.01}
    count = 6
    vector, rng = VppThrustVectorEnv(count, **options), np.random.default_rng(2)
    singles = [VppThrustEnv(**options) for _ in range(count)]
    seen = [vector.reset(seed=40)[0], np.array([env.reset(seed=40 + k)[0] for k, env in enumerate(singles)])]
    assert np.array_equal(*seen)
    for _ in range(vector.task.actions):
        actions = rng.uniform(-1.2, 1.2, (count, 2))
        found = vector.step(actions)
        alone = [env.step(action) for env, action in zip(singles, actions, strict=True)]
        for k in range(4):
            assert np.array_equal(found[k], np.array([each[k] for each in alone]))
    assert found[3].all()
    begun = vector.step(actions)  # the next episode continues the generator's draws
    assert not begun[1].any()
    assert not begun[3].any()
    assert np.array_equal(begun[0], np.array([env.reset()[0] for env in singles]))
    if way == "uneven steps":
        slow = vector.parameters[:, [p.name for p in own.model.parameters].index("sensor_lag.time_constant")] > 0.0
        assert slow.any()
        assert not slow.all()


def test_actions_become_commands_and_the_model_is_moved():
    """-1 and 1 are the ends of the ranges; a rate is a share of the fastest move."""
    model, env = Simulation(plant()), VppThrustEnv(seconds=1.0, hold=3, dt=0.005)
    env.reset(seed=0)
    model.start({"omega_ref": 2000.0, "beta_ref": -5.0})
    for action, omega, beta in (((1.0, -1.0), 6000.0, -5.0), ((0.0, 0.5), 4000.0, 6.25), ((-3.0, 3.0), 2000.0, 10.0)):
        *_, shown = env.step(np.array(action))
        for _ in range(3):
            exact = model.advance({"omega_ref": omega, "beta_ref": beta}, 0.005)
        assert (shown["omega_ref"], shown["beta_ref"]) == (omega, beta)
        assert {name: shown[name] for name in exact} == exact
    rate = VppThrustEnv(seconds=1.0, action="rate")
    rate.reset(seed=0)
    *_, shown = rate.step(np.array([0.5, 1.0]))  # 5 ranges a second, 4 ms
    assert shown["omega_ref"] == pytest.approx(2000.0 + 0.5 * 5.0 * 4000.0 * 0.004)
    assert shown["beta_ref"] == pytest.approx(-5.0 + 5.0 * 15.0 * 0.004)


def test_episodes_draw_their_parameters_from_the_covariance_of_the_fit(fitted):
    count = 4000
    env = VppThrustVectorEnv(count, parameters=str(fitted), randomise=True, seconds=0.004)
    env.reset(seed=7)
    names = [p.name for p in plant().parameters]
    drawn = env.parameters[:, [names.index(n) for n in STD]]
    std = np.array(list(STD.values()))
    # A correlation of n draws has the standard error (1 - r^2) / sqrt(n), a standard deviation 1 / sqrt(2 n) of itself.
    assert np.abs(np.corrcoef(drawn.T) - CORRELATION).max() < 5.0 / np.sqrt(count)
    assert np.abs(drawn.std(axis=0) / std - 1.0).max() < 5.0 / np.sqrt(2.0 * count)
    assert np.abs((drawn.mean(axis=0) - [FINE_TUNED[n] for n in STD]) / std).max() < 5.0 / np.sqrt(count)
    others = np.delete(env.parameters, [names.index(n) for n in STD], axis=1)
    assert (others == others[0]).all()


def test_noise_is_that_of_the_identification(fitted):
    env = VppThrustVectorEnv(2000, parameters=str(fitted), seconds=0.004)
    read, shown = env.reset(seed=1)
    assert (read[:, 1] - shown["thrust"]).std() == pytest.approx(0.13, rel=0.1)
    assert np.array_equal(read[:, 2], shown["omega"])


def test_a_profile_is_followed_and_ends_the_episode():
    profile = Record({"time": np.array([0.0, 0.1, 0.2]), "thrust_set": np.array([3.0, 9.0, 9.0])}, "test")
    env = VppThrustEnv(profile=profile, dt=0.01, hold=5)
    wanted, ended = [env.reset(seed=0)[0][0]], False
    while not ended:
        seen, _, _, ended, _ = env.step(np.zeros(2))
        wanted.append(seen[0])
    assert wanted == [3.0, 3.0, 9.0, 9.0, 9.0]


def test_the_reward_is_its_formula_and_can_be_another():
    def power(omega, beta):
        return 1e-3 * omega + beta

    def pay(**reward):
        env = VppThrustEnv(seconds=1.0, dt=0.01, reward=Reward(**reward))
        set_point = env.reset(seed=5)[0][0]
        _, paid, _, _, shown = env.step(np.array([0.0, 1.0]))
        return paid, set_point, shown

    paid, wanted, shown = pay(error=2.0, wear=0.0)
    assert paid == pytest.approx(-2.0 * abs(wanted - shown["thrust"]) / 15.0)
    assert pay(error=0.0, wear=3.0)[0] == pytest.approx(-3.0 * (0.5 + 1.0))
    paid, _, shown = pay(error=0.0, wear=0.0, energy=0.5, power=power)
    assert paid == pytest.approx(-0.5 * 0.01 * power(shown["omega"], shown["beta"]))
    with pytest.raises(BadInput, match="torque_map or power_map"):
        VppThrustEnv(reward=Reward(energy=1.0))
    powered = ParameterSet(plant(("power_map",))).replaced({"power_map.p30": 40.0})
    env = VppThrustEnv(parameters=powered, seconds=1.0, dt=0.01, reward=Reward(error=0.0, wear=0.0, energy=0.5))
    env.reset(seed=5)
    _, paid, _, _, shown = env.step(np.array([0.0, 1.0]))
    assert paid == pytest.approx(-0.5 * 0.01 * 40.0 * (shown["omega"] / 6000.0) ** 3)
    env = VppThrustEnv(seconds=1.0, reward=lambda moment: moment.omega)
    env.reset(seed=0)
    _, paid, _, _, shown = env.step(np.zeros(2))
    assert paid == shown["omega"]


def test_a_limit_of_the_rig_ends_the_episode_and_costs():
    strong = ParameterSet(plant()).replaced({"c20": 1.5})  # more than 25 N at full speed and pitch
    env = VppThrustEnv(parameters=strong, seconds=5.0)
    env.reset(seed=0)
    ended = False
    while not ended:
        _, paid, ended, over, shown = env.step(np.ones(2))
        assert not over
    assert 25.0 < shown["thrust"] < 26.0
    assert paid < -100.0


@pytest.mark.parametrize(
    "options",
    [
        {"observe": ("torque",)},
        {"action": "torque"},
        {"hold": 0},
        {"history": -1},
        {"noise": (-1.0, 0.0)},
        {"seconds": 0.0},
        {"randomise": True},
        {"speed": 3.0},
        {"parameters": "nowhere"},
        {"profile": "nowhere.csv"},
    ],
)
def test_bad_options_are_refused_in_one_line(options):
    refusal(lambda: VppThrustEnv(**options).reset(seed=0))


def test_make_vec_has_the_compiled_one():
    env = gymnasium.make_vec("VppThrust-v0", num_envs=3, vectorization_mode="vector_entry_point", seconds=0.1)
    assert isinstance(env, VppThrustVectorEnv)
    assert env.reset(seed=[1, 2, 3])[0].shape == (3, 3)
    assert env.observation_space.contains(env.reset()[0])
