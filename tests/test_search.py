"""The search: candidates, fits, thresholds and refits, each against a closed form or a fit from the truth."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from identification.diagnose.search import refits
from identification.diagnose.search.candidates import candidates
from identification.diagnose.search.fits import Searcher
from identification.diagnose.search.screening import Screening
from identification.diagnose.search.threshold import FINE, FINEST, divided, scan
from identification.fit.experiment import Experiment
from identification.fit.noise import independent
from identification.fit.problem import Prior, Problem
from identification.roles import Fitted
from identification.static.static_map import TERMS
from vpp_fmu.kernel.plant import LIBRARY, plant, sized
from vpp_fmu.kernel.scales import PAPER
from vpp_fmu.loop import run
from vpp_fmu.native import Simulator
from vpp_fmu.plants import KernelController, KernelPlant
from vpp_fmu.record import Record

RNG = np.random.default_rng(20)


@pytest.mark.parametrize(("name", "widened"), [("pitch_asymmetry", False), ("map_terms", True)])
def test_steady_points_lose_weight_only_beside_effects_of_the_map(name, widened):
    """The records shift a coefficient of the thrust map by five of the map's standard deviations. A dynamic effect can't have
    shifted the steady points; terms of the map itself may have."""
    effect = next(e for e in LIBRARY if e.name == name)
    model, rng = plant([name]), np.random.default_rng(4)
    free = [n for n in effect.probe if effect.full(n) not in ("pitch_asymmetry.form",)]
    values = model.values({effect.full(n): effect.probe[n] for n in free})
    shown = Simulator(model).simulate(values, commanded(2000), np.full(1999, 0.01))
    columns = {"time": 0.01 * np.arange(2000), **commanded(2000), "omega": shown[:, 1]}
    record = Record(columns | {"thrust": shown[:, 0] + 0.1 * rng.standard_normal(2000)}, "drawn")
    names = ["tau_beta_1", "tau_beta_2", "c20", "c11"]
    told = Prior(("c20",), np.array([values["c20"] + 0.05]), np.array([[0.01**2]]))
    knowledge = lambda *_: told  # noqa: E731
    searcher = Searcher([Experiment([Fitted("drawn", record)], independent(15.0))], names, knowledge, LIBRARY)
    found = searcher.fit([name], {}, [effect.full(n) for n in free], values)
    assert found.at_rest is widened
    agreed = found.agreed(knowledge)
    if widened:
        assert agreed.problem.prior.wider_than(told) > 3.0
        assert abs(agreed.values["c20"] - values["c20"]) < abs(found.values["c20"] - values["c20"])
    else:
        assert agreed is found


def test_the_search_for_a_resonance_spans_the_frequencies_of_the_record():
    """From two cycles in 20 s, 0.1 Hz, to half of 100 rows a second, 50 Hz; twelve per decade are a factor of 1.22 apart."""
    time = 0.01 * np.arange(2001)
    record = Record({"time": time, "omega_ref": np.full(2001, 4000.0), "beta_ref": np.zeros(2001)}, "made up")
    (candidate,) = candidates([e for e in LIBRARY if e.name == "stand_resonance"], [record])
    found = np.array(candidate.fine_axis("stand_resonance.frequency"))
    assert (found[0], found[-1]) == pytest.approx((0.1, 50.0))
    assert np.all(found[1:] / found[:-1] < 10.0 ** (1.0 / 11.0))


def test_effects_of_a_pitch_that_never_moves_are_no_candidates():
    """Each of them leaves the pitch at one value there, which the map takes. Where the pitch moves, all are candidates."""
    commands = commanded(400) | {"beta_ref": np.full(400, 5.0), "voltage": np.linspace(24.0, 23.0, 400)}
    still = Record({"time": 0.02 * np.arange(400), **commands}, "fixed pitch")
    moved = Record({**still.columns, "time": still.time, "beta_ref": commanded(400)["beta_ref"]}, "both")
    at_rest, all_names = ({c.name for c in candidates(LIBRARY, [r])} for r in (still, moved))
    assert all_names - at_rest > {"pitch_backlash", "pitch_delay", "pitch_rate_limit", "pitch_overshoot"}
    for name in all_names - at_rest:
        model, (effect,) = plant([name]), [e for e in LIBRARY if e.name == name]
        on = {effect.full(n): value for n, value in effect.probe.items()}
        pitch = Simulator(model).simulate(model.values(on), *still.run)[:, [y.name for y in model.outputs].index("beta")]
        assert np.ptp(pitch) < 1e-9


def test_a_fit_with_the_same_arguments_is_computed_once():
    """Another start or another order of the lags is another fit."""
    record = Record({"time": 0.02 * np.arange(400), **commanded(400), "thrust": RNG.standard_normal(400)}, "drawn")
    values = plant(()).values()
    searcher = Searcher([Experiment([Fitted("drawn", record)], independent(15.0))], ["c20", "c11"], None, LIBRARY)
    found = searcher.fit((), {}, (), values)
    assert searcher.fit([], {}, [], dict(values)) is found
    assert searcher.fit((), {}, (), {**values, "c20": 0.1}) is not found
    assert searcher.fit((), {}, (), values, {"beta": False}) is not found


def commanded(rows: int) -> dict[str, np.ndarray]:
    """Commands (rows,) of levels, 50 rows each."""
    levels = np.random.default_rng(4).uniform(size=(2, rows // 50))
    return {"omega_ref": np.repeat(2500.0 + 3000.0 * levels[0], 50), "beta_ref": np.repeat(12.0 * levels[1] - 3.0, 50)}


def test_an_estimate_with_the_map_of_another_fit_changes_the_lags_alone():
    """Records of a rotor that is slower in one direction: the map and its standard deviations are unchanged to the digit."""
    model, rng, name = plant(["speed_asymmetry"]), np.random.default_rng(6), "speed_asymmetry.asymmetry"
    told = commanded(2000)
    shown = Simulator(model).simulate(model.values({name: 0.3}), told, np.full(1999, 0.01))
    read = shown[:, 0] + 0.1 * rng.standard_normal(2000)
    record = Record({"time": 0.01 * np.arange(2000), **told, "omega": shown[:, 1], "thrust": read}, "drawn")
    names, values = ["tau_omega_1", "tau_omega_2", "c20", "c11"], plant(()).values()
    searcher = Searcher([Experiment([Fitted("drawn", record)], independent(15.0))], names, None, LIBRARY)
    other, found = searcher.fit((), {}, (), values), searcher.fit(["speed_asymmetry"], {}, [name], values)
    held = found.with_map_of(other)
    assert {n: held.values[n] for n in ("c20", "c11")} == {n: other.values[n] for n in ("c20", "c11")}
    assert held.values[name] == pytest.approx(0.3, abs=0.03)
    assert held.values["tau_omega_1"] != other.values["tau_omega_1"]
    for n in ("c20", "c11"):
        assert held.std()[n] == pytest.approx(other.std()[n], rel=1e-12)
    assert held.std()[name] > 0.0


@pytest.mark.parametrize(
    ("low", "grid"),
    [(0.5, np.geomspace(0.02, 4.5, FINE)), (-4.0, np.linspace(-4.5, 4.5, FINE)), (-4.0, np.linspace(-4.5, -0.5, FINE))],
)
def test_the_threshold_search_finds_every_wide_piece(low, grid):
    """The edges are known, and the rows of each piece are orthogonal to those of all others. A grid misses most pieces;
    bisection finds every piece wider than its finest part."""
    edges, grid, rows = np.sort(np.random.default_rng(9).uniform(low, low + 2.5, 300)), grid.tolist(), 30.0 * np.eye(301)
    changing = min(b for b in grid if b > edges[-1]) - max(a for a in grid if a < edges[0])
    wide = np.flatnonzero(np.diff(edges) > changing / FINEST) + 1
    assert len(wide) > 150
    assert len(set(wide) & set(np.searchsorted(edges, grid))) < 0.3 * len(wide)
    for right in wide[:: len(wide) // 10]:
        asked = []

        def left(points, right=right, asked=asked):
            asked.extend(points)
            return (rows[np.searchsorted(edges, points)] - rows[right]).T

        found = divided(left, grid)
        assert min(found.values()) == 0.0
        assert len(asked) == len(set(asked)) <= FINEST + FINE
    asked.clear()
    above = edges[-1] + 0.5
    divided(left, [above, above + 0.5, above + 1.0])  # all the same: nothing to halve
    assert len(asked) == 3


def test_the_threshold_search_finds_the_best_of_many_similar_pieces():
    """The position of a bump in noise has 3000 small pieces. The cost found exceeds the least by at most that of half the
    finest step, and few pieces are evaluated."""
    edges, axis, width = np.linspace(0.5, 3.0, 3001), np.linspace(-1.0, 5.0, 600), 0.3
    bumps = 4.0 * np.exp(-(((axis - edges[:, None]) / width) ** 2))
    curvature = 4.0**2 * np.sqrt(0.5 * np.pi) / width / (axis[1] - axis[0])  # of half the squared distance of two bumps
    worse = 0.5 * curvature * (0.5 * 4.5 / FINEST + edges[1] - edges[0]) ** 2
    for seed in range(40):
        rng, asked = np.random.default_rng(seed), []
        read = bumps[rng.integers(len(edges))] + rng.standard_normal(len(axis))

        def left(points, read=read, asked=asked):
            asked.extend(points)
            return (bumps[np.abs(edges[:, None] - points).argmin(axis=0)] - read).T

        best = 0.5 * float(np.min(np.sum((bumps - read) ** 2, axis=1)))
        assert min(divided(left, np.geomspace(0.1, 4.5, FINE).tolist()).values()) - best < 2.0 * worse  # noise bends it, too
        assert len(asked) < FINEST / 4


@pytest.mark.parametrize(("small", "expected"), [(1.0, 2.0), (2.0, 0.0)])
def test_the_middle_of_equivalent_thresholds_is_taken(small, expected):
    """Moves of 1 deg are ignored and moves of 3 deg are followed, so any value between is equivalent. If all moves are of 2 deg
    and none is ignored, the value of least influence is taken."""
    model, time = plant(["pitch_command_deadband"]), 0.01 * np.arange(3001)
    moves = np.cumsum(np.tile([2.0, -small, -2.0, small], 8))[:30]
    columns = {
        "time": time,
        "omega_ref": np.full(3001, 5000.0),
        "beta_ref": np.repeat(np.append(moves, moves[-1:]), 100)[:3001],
    }
    name = "pitch_command_deadband.half_width"
    shown = Simulator(model).simulate(model.values({name: 1.5}), columns, np.diff(time))[:, 0]
    record = Record(columns | {"thrust": shown + 0.02 * np.random.default_rng(4).standard_normal(3001)}, "steps")
    experiment = Experiment([Fitted("steps", record)], independent(15.0))
    problem = Problem(model, [experiment], model.values({name: 1.4}), ["tau_beta_1", "c20"])
    scan(problem, problem.fit(problem.values), name, 0.0)
    assert problem.values[name] == pytest.approx(expected, abs=0.03)


@pytest.mark.parametrize(("half_width", "start"), [(0.731, 1.0), (1.618, 0.0)])
def test_a_dead_band_in_a_closed_loop_is_found(half_width, start):
    """Commands of a loop creep: close to the true dead band other values explain nothing, so that a grid misses it."""
    model, rng = plant(["pitch_command_deadband"]), np.random.default_rng(12)
    name, time = "pitch_command_deadband.half_width", np.cumsum(np.r_[0.0, rng.uniform(1.5, 4.0, 20)])
    wanted = Record({"time": time, "thrust_set": rng.uniform(3.0, 11.0, len(time))}, "wanted")
    flown = run(KernelPlant(model, {name: half_width}), KernelController(), wanted)

    def shown(at):
        return Simulator(model).simulate(model.values({name: at}), *flown.run)[:, 0]

    read = shown(half_width) + 0.05 * rng.standard_normal(len(flown))
    record = Record({n: flown[n] for n in ("time", "omega_ref", "beta_ref")} | {"thrust": read}, "flown")
    names, values = ["tau_omega_1", "tau_beta_1", "tau_beta_2", "c20"], plant().values()
    searcher = Searcher([Experiment([Fitted("flown", record)], independent(15.0))], names, None, LIBRARY)
    (candidate,) = candidates([e for e in LIBRARY if e.name == "pitch_command_deadband"], [record])
    seen = Screening(searcher.fit([], {}, [], values), LIBRARY).at(candidate)
    assert np.std(shown(seen.values[name]) - shown(half_width)) < 0.05  # less than the noise
    found = searcher.fit(["pitch_command_deadband"], {}, [name], {**values, name: start})
    low, high = found.thresholds[name]
    assert low - 1e-3 < half_width < high + 1e-3
    assert high - low < 0.05


FAST, SLOW = replace(PAPER, time_scale=0.2), replace(PAPER, time_scale=1.0)
"""Rigs whose actuators settle in 0.2 s and in 1 s."""


@pytest.mark.parametrize(
    ("name", "truth"),
    [
        ("inflow_lag", {"inflow_lag.gain": 0.23, "inflow_lag.time_constant": 0.22, "tau_beta_1": 0.2, "tau_beta_2": 0.08}),
        ("pitch_overshoot", {"pitch_overshoot.inertia": 0.4, "tau_beta_1": 0.19, "tau_beta_2": 0.001}),
    ],
)
@pytest.mark.parametrize("seed", range(2))
def test_a_refit_leaves_the_double_pole_of_a_fit_without_the_effect(name, truth, seed):
    """Two equal lags of pitch nearly replace the lead of an inflow or the complex poles of a servo. The refit is as good as one
    that starts from the true values."""
    model, rng = plant([name]), np.random.default_rng(seed)
    told = {"omega_ref": np.repeat(rng.uniform(2500.0, 5800.0, 80), 50), "beta_ref": np.repeat(rng.uniform(-3.0, 9.0, 80), 50)}
    read = Simulator(model).simulate(model.values(truth), told, np.full(3999, 0.01))[:, 0] + 0.05 * rng.standard_normal(4000)
    record = Record({"time": 0.01 * np.arange(4000), **told, "thrust": read}, "drawn")
    names, values, library = ["tau_beta_1", "tau_beta_2", *TERMS], plant().values(), sized(LIBRARY, FAST)
    searcher = Searcher([Experiment([Fitted("drawn", record)], independent(15.0))], names, None, library)
    candidate = candidates([e for e in library if e.name == name], [record])[0]
    base = searcher.fit([], {}, [], values)
    linear = base.linearised().residual
    assert linear @ linear == pytest.approx(2.0 * base.solution.cost, rel=1e-3)  # no parameter that is free lowers a minimum
    best = searcher.fit([name], candidate.form, list(candidate.free), {**values, **truth})
    assert base.deviance - best.deviance > 100.0
    (tried,) = refits.search_round(searcher, base, [candidate], SimpleNamespace(map=map), lambda *_: None)
    assert tried.fit.deviance == pytest.approx(best.deviance, abs=0.1)


@pytest.mark.parametrize(
    ("name", "limit", "value", "form", "lags"),
    [
        ("pitch_travel_limit", "maximum", 4.8, 1.0, (0.3, 0.12)),
        ("pitch_travel_limit", "minimum", -1.0, 2.0, (0.3, 0.12)),
        ("pitch_rate_limit", "rate", 1.2, 1.0, (0.8, 0.4)),
        ("pitch_rate_limit", "rate", 1.2, 2.0, (0.8, 0.4)),
    ],
)
def test_a_limit_of_the_pitch_is_found_wherever_it_is(name, limit, value, form, lags):
    """Commands from -2.5 to 6.5 deg do not reach the effect's plausible limits: -3 and 7 deg, or 5 deg/s. Without the limit,
    map and lags absorb much of it. The search is as good as a fit that starts from the true values."""
    library, model, rng = sized(LIBRARY, SLOW), plant([name]), np.random.default_rng(int(10 * abs(value)))
    truth = {f"{name}.{limit}": value, f"{name}.form": form, "tau_beta_1": lags[0], "tau_beta_2": lags[1]}
    told = {"omega_ref": np.repeat(rng.uniform(2500.0, 5800.0, 80), 50), "beta_ref": np.repeat(rng.uniform(-2.5, 6.5, 80), 50)}
    read = Simulator(model).simulate(model.values(truth), told, np.full(3999, 0.01))[:, 0] + 0.2 * rng.standard_normal(4000)
    record = Record({"time": 0.01 * np.arange(4000), **told, "thrust": read}, "drawn")
    names, values = ["tau_beta_1", "tau_beta_2", *TERMS], plant().values()
    searcher = Searcher([Experiment([Fitted("drawn", record)], independent(15.0))], names, None, library)
    options = candidates([e for e in library if e.name == name], [record])
    base = searcher.fit([], {}, [], values)
    right = next(c for c in options if c.form[f"{name}.form"] == form)
    best = searcher.fit([name], right.form, list(right.free), {**values, **truth})
    tried = refits.search_round(searcher, base, options, SimpleNamespace(map=map), lambda *_: None)
    assert min(t.fit.deviance for t in tried) == pytest.approx(best.deviance, abs=0.5)
