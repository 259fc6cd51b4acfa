"""Commands executed in steps: the search over step sizes, and its result with and without such steps."""

from dataclasses import replace

import numpy as np
import pytest
from studies.synthetic import TRUTH, commands

from identification.demo import example_folder
from identification.diagnose.diagnose import diagnose
from identification.diagnose.search.fits import Searcher
from identification.diagnose.search.rounding import Rounding, rounded
from identification.fit.experiment import Experiment
from identification.fit.noise import independent
from identification.roles import Fitted
from vpp_fmu.campaign import Campaign
from vpp_fmu.kernel.plant import LIBRARY, plant
from vpp_fmu.native import Simulator
from vpp_fmu.rig import infer_rig

PITCH, SPEED = "pitch_command_resolution", "speed_command_resolution"
FEW = tuple(e for e in LIBRARY if e.off is None or e.name in (PITCH, SPEED, "pitch_command_deadband", "sensor_lag"))
NOISE, STEP = 0.1, 0.008  # N, s
NAMES = ("tau_omega_1", "tau_omega_2", "tau_beta_1", "tau_beta_2", "c20", "c11", "c21", "c12", "c30")


def measured(record, rng, **steps):
    """A record with thrust and speed of the paper's model, whose commands are executed in the `steps` of an effect."""
    coarse = {u: rounded(record[u], steps.get(n, 0.0)) for n, u in ((PITCH, "beta_ref"), (SPEED, "omega_ref"))}
    shown = Simulator(plant(())).simulate(TRUTH, record.columns | coarse, record.steps)
    noise = rng.standard_normal((2, len(record)))
    return record.with_columns(thrust=shown[:, 0] + NOISE * noise[0], omega=shown[:, 1] + 5.0 * noise[1])


def campaign(*records):
    """A campaign of these records with a declared speed sensor."""
    rig = infer_rig(records[:1], None, {"sensor": {"kind": "encoder"}})
    return Campaign(example_folder(), None, (), *records, *[None] * (3 - len(records)), rig=rig)


def effect_of(name):
    return next(e for e in LIBRARY if e.name == name)


def look(name, step, seed=3):
    """(the search beside the base model, its linearised fit, searcher, base) for a record with this step."""
    rng = np.random.default_rng(seed)
    record = measured(commands(rng, 20.0), rng, **{name: step})
    experiment = Experiment([Fitted("drawn", record)], independent(15.0))
    searcher = Searcher([experiment], NAMES, None, LIBRARY)
    base = searcher.fit((), {}, (), plant(()).values(TRUTH))
    about, effect = base.linearised(), effect_of(name)
    found = Rounding(about, Simulator(plant([name]), [f"{name}.step"]), effect, [record])
    return found, about, searcher, base


@pytest.fixture(scope="module")
def pitch():
    return look(PITCH, 0.4)


def test_costs_from_the_levels_are_those_of_simulations(pitch):
    found, about, *_ = pitch
    steps = [0.15, 0.26, 0.4, 0.55, 1.1]
    simulator = Simulator(plant([PITCH]), [found.name])
    exact = np.array(about.costs(simulator, [{found.name: step} for step in steps]))
    nothing = 0.5 * about.residual @ about.residual
    assert nothing - exact[2] > 100.0
    np.testing.assert_allclose(found.costs(np.array(steps)), exact, rtol=0, atol=0.05 * np.abs(exact - nothing).max())


@pytest.mark.parametrize(("name", "step"), [(PITCH, 0.273), (SPEED, 63.7)])
def test_the_true_step_is_among_the_simulated_ones(name, step):
    """To a tenth of the distance at which the highest level is another multiple."""
    found = look(name, step)[0]
    highest = {PITCH: 10.0, SPEED: 6000.0}[name]
    assert min(abs(1.0 / s - 1.0 / step) for s in found.best()) * highest < 0.1


def test_a_fit_closes_in_on_the_step_and_says_how_well_it_is_known(pitch):
    _, _, searcher, base = pitch
    name = f"{PITCH}.step"
    fit = searcher.fit((PITCH,), {}, (name,), {**base.values, name: 0.43})
    low, high = fit.thresholds[name]
    assert low < 0.4 < high
    assert high - low < 0.01
    assert 0.0 < fit.std()[name] < 0.005
    assert low <= fit.values[name] <= high


def test_the_step_of_a_command_is_named():
    """Of speed; the tests above search that of pitch."""
    name, rng = SPEED, np.random.default_rng(11)
    step = float(np.exp(rng.uniform(*np.log([10.0, 100.0]))))
    told, other = commands(rng, 20.0, STEP), commands(rng, 8.0, STEP)
    records = [
        replace(measured(r, rng, **{name: step}), source=f"{n}.csv")
        for r, n in ((told, "open_loop"), (told, "repeat"), (other, "validation"))
    ]
    found = diagnose(campaign(*records), FEW, thorough=False)
    assert (found.verdict, found.final.effects) == ("attributed", (name,))
    assert found.final.values[f"{name}.step"] == pytest.approx(step, rel=0.01)
    assert found.errors(found.final)[0] == pytest.approx(NOISE, rel=0.05)


def test_no_step_is_named_where_commands_are_executed_as_they_are():
    rng = np.random.default_rng(13)
    told = commands(rng, 20.0, STEP)
    records = [replace(measured(told, rng), source=f"{n}.csv") for n in ("open_loop", "repeat")]
    found = diagnose(campaign(*records), FEW)
    assert (found.verdict, found.final.effects) == ("none", ())
