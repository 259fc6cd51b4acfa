"""The rounds of a day.

In each a mission is flown with the twin beside it. An alarm, or that the model predicts the mission worse than when it was
flown before, is explained where the adapted model leaves none of it; what is not goes to the diagnosis, the mission's own
record against the twin's model. Gains are retuned on the model and searched on the rig; the better of them, by what the rig
measures, flies next, and nothing that is worse than what flies takes its place (Reinforcement Twinning: Schena, Marques,
Poletti, Ahizi, Van den Berghe, Mendez, 2024).
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from itertools import product
from pathlib import Path

import numpy as np
from scipy.stats import ttest_ind, wilcoxon

from hil.rig import RunEnded
from hil.session import Setup
from hil.twin.adaptive import CERTAIN, adaptable
from hil.twin.band import Band
from hil.twin.twin import Twin
from identification.assessment.prediction import predict
from identification.diagnose.diagnose import diagnose
from identification.diagnose.validation import CHANGED
from identification.tune.profile import common_reach, rig_profile
from vpp_fmu.campaign import Campaign
from vpp_fmu.day.flight import GAINS, Flight, Twins, fly, mission
from vpp_fmu.day.policy import Referee, Search, retuned, task
from vpp_fmu.kernel.scales import PAPER
from vpp_fmu.kernel.twin import watched
from vpp_fmu.parameters import ParameterSet
from vpp_fmu.plants import KernelPlant
from vpp_fmu.record import Record

FIXED, MODEL_BASED, MODEL_FREE, BOTH = POLICIES = ("fixed", "model-based", "model-free", "both")

DIAGNOSED = "diagnosed"
"""Name of the model that a diagnosis made of a mission."""

TIMES = 4
"""How often a finalist goes through the profile: the step's cost scatters by 2 % from one time to the next, the best gains are
that much better than fair ones, and each time lasts as long as a try of the search."""

BETTER = 0.1
"""Probability with which gains that are no better than what flies take its place (t test): lowered, better ones are passed
over, which may come again in the next round."""

WORSE = 0.01
"""Probability with which a mission that is flown again counts as predicted worse: one needless alarm in a hundred rounds."""

LEFT = 0.1
"""The same after an alarm: a diagnosis for nothing costs a minute, an effect that passes for a changed parameter stays."""


@dataclass(frozen=True, eq=False)
class Model:
    """A model that the rig may be: `name`, its `parameters`, and the rms error of its thrust [N] in the mission that it was
    made from, and in the next one, which it never saw."""

    name: str
    parameters: ParameterSet
    fitted: float
    unseen: float


@dataclass(frozen=True, eq=False, kw_only=True)
class Modelled:
    """A round's model: `mission`: as it was flown; `alarm`: (s, what it pointed to), None without; `models`: those that were
    compared after it, the `chosen` by its error on a mission that none of them saw; `named`: effects that the diagnosis added,
    and its `verdict`, "" where none was asked for. `wanted`: the round's last mission, which the next one flies again, and
    `usual` the chosen model's mean square error at each of its levels, (levels,) N^2.
    """

    mission: Flight
    alarm: tuple[float, str] | None
    models: tuple[Model, ...]
    chosen: Model
    verdict: str
    named: tuple[str, ...]
    wanted: Record
    usual: np.ndarray


@dataclass(frozen=True, eq=False, kw_only=True)
class Round(Modelled):
    """A round, its `number` from 1, with what was `hidden` in the rig.

    `costs`: by branch, what the finalists cost on the rig, time by time; `tries`: single flights of the search, `refused`:
    how many of its gains the model did not let fly. `winner`: the branch that flies next, with `settings`.
    """

    number: int
    hidden: tuple[str, ...]
    costs: Mapping[str, tuple[float, ...]]
    tries: tuple[float, ...]
    refused: int
    winner: str
    settings: Mapping[str, float]

    @property
    def cost(self) -> float:
        """Of what flies next."""
        return float(np.mean(self.costs[self.winner]))


@dataclass(eq=False)
class Day:
    """A day's rounds, and what it began with. `search`: on the rig, from round to round while it goes on from what flies."""

    begun: ParameterSet
    settings: Mapping[str, float]
    profile: Record
    rounds: list[Round] = field(default_factory=list)
    search: Search | None = None

    @property
    def parameters(self) -> ParameterSet:
        """The model as it is now."""
        return self.rounds[-1].chosen.parameters if self.rounds else self.begun

    @property
    def flies(self) -> Mapping[str, float]:
        """The controller's values as they are now."""
        return self.rounds[-1].settings if self.rounds else self.settings


@dataclass(frozen=True, eq=False)
class Rig:
    """What flies: `setup(round, flight)` is the rig in it; `word(what)` waits until somebody lets `what` fly."""

    setup: Callable[[int, int], Setup]
    word: Callable[[str], None]
    hidden: Callable[[int], tuple[str, ...]]


def new_day(parameters: ParameterSet, settings: Mapping[str, float]) -> Day:
    """A day that begins with this model and this controller."""
    return Day(parameters, dict(settings), rig_profile(parameters, {"dual": settings}))


def next_round(
    day: Day, rig: Rig, band: Band, policy: str, folder: Path, seed: int, workers: int, stage: Callable[[str], None]
) -> Round:
    """Fly one round; its logs go to `folder`. BadInput; RunEnded for a flight that ended before its time."""
    number, flights = len(day.rounds) + 1, _Flights(rig, len(day.rounds) + 1, folder)
    flies = day.flies
    modelled = _modelled(day, flights, band, seed, workers, stage)
    chosen, as_it_was = modelled.chosen, modelled.models[0]
    tuning = task(chosen.parameters, day.profile, band.noise, flies["sample_time"], seed)
    finalists: dict[str, Mapping[str, float]] = {"what flew": flies}
    tries: list[float] = []
    refused = 0
    flies_already = bool(day.rounds) and day.rounds[-1].winner == MODEL_BASED and chosen is as_it_was
    if policy in (MODEL_BASED, BOTH) and not flies_already:
        stage("retune on the model")
        finalists[MODEL_BASED] = retuned(tuning, flies)
    if policy in (MODEL_FREE, BOTH):
        stage("search on the rig")
        best, tries, refused = _searched(day, flights, Referee(tuning, flies), flies, 1000 * seed + number)
        if best is not None:
            finalists[MODEL_FREE] = best
    stage("compare on the rig")
    costs = {name: flights(name, each, day.profile, times=TIMES).costs for name, each in finalists.items()}
    winner = best_of(costs)
    if winner == MODEL_BASED:
        day.search = None  # it was about other gains
    return Round(
        **vars(modelled),
        number=number,
        hidden=rig.hidden(number),
        costs=costs,
        tries=tuple(tries),
        refused=refused,
        winner=winner,
        settings=dict(finalists[winner]),
    )


def _modelled(day: Day, flights: "_Flights", band: Band, seed: int, workers: int, stage: Callable[[str], None]) -> Modelled:
    """Fly the round's missions, and choose the model that goes on."""
    number, model, flies = len(day.rounds) + 1, day.parameters, day.flies
    low, high = common_reach(model, {"dual": flies})
    low, high = low + 0.1 * (high - low), high - 0.1 * (high - low)
    pace = max(model.rig.scales.time_scale / PAPER.time_scale, 1.0)

    def flown(k: int, profile: Record) -> Flight:
        return flights(f"mission {k}", flies, profile, Twins(model, band))

    def fresh(k: int) -> Record:
        return mission(low, high, pace, 1000 * seed + 10 * number + k)

    stage("mission")
    before = day.rounds[-1] if day.rounds else None
    wanted = within(before.wanted, low, high) if before else fresh(1)
    first = last = flown(1, wanted)

    def improbable(parameters: ParameterSet) -> float:
        return worse(by_level(parameters, first.record, before.wanted), before.usual) if before else 1.0

    alarm = first.alarms[0] if first.alarms else None
    if not alarm and improbable(model) < WORSE:
        alarm = float(first.record.time[-1] - first.record.time[0]), "predicted worse than when it was flown before"
    models, verdict = [Model("as it was", model, error(model, first.record), np.nan)], ""
    named: tuple[str, ...] = ()
    if _moved(model, first):
        models.append(_adapted(model, first))
    if alarm or len(models) > 1:
        stage("mission again")
        wanted = fresh(2)
        last = flown(2, wanted)

    def explains(adapted: ParameterSet) -> bool:
        return not _alarms(adapted, band, last.record) if first.alarms else improbable(adapted) > LEFT

    if alarm and not (len(models) > 1 and explains(models[1].parameters)):
        stage("diagnose")
        # The rig waits, and a mission is too short to learn a term of no list from.
        found = diagnose(_campaign(first.record, flights.folder, model), given=model, workers=workers, thorough=False)
        verdict = found.verdict
        # What explains a part competes, too: another mission decides here.
        best = found.final if found.final.effects else found.selection.final
        if best.effects and not found.refuted:
            named = tuple(e for e in best.effects if e not in model.model.optional)
            own = found.parameters(best)
            own = replace(own, source={**model.source, **own.source})
            models.append(Model(DIAGNOSED, own, error(own, first.record), np.nan))
    if last is not first:
        models = [replace(m, unseen=error(m.parameters, last.record)) for m in models]
    chosen = min(models, key=lambda m: m.unseen) if len(models) > 1 else models[0]
    return Modelled(
        mission=first,
        alarm=alarm,
        models=tuple(models),
        chosen=chosen,
        verdict=verdict,
        named=named,
        wanted=wanted,
        usual=by_level(chosen.parameters, last.record, wanted),
    )


def best_of(costs: Mapping[str, tuple[float, ...]]) -> str:
    """Whose gains fly next: the cheapest, or what flew, which comes first, where that may well be as cheap."""
    flew, best = next(iter(costs)), min(costs, key=lambda name: float(np.mean(costs[name])))
    return best if best == flew or ttest_ind(costs[best], costs[flew], alternative="less").pvalue < BETTER else flew


def diagnosed(done: Round) -> str:
    """What a round's diagnosis found, in words; "" where none was asked for."""
    if done.verdict in CHANGED or not done.named:
        return f"{done.verdict} {' + '.join(done.named)}".strip()
    return f"{done.verdict}: a part by {' + '.join(done.named)}"


def error(parameters: ParameterSet, record: Record) -> float:
    """N: rms of the thrust that the model predicts for a record's commands."""
    return float(predict(parameters.model, parameters.values, _measured(record)).rmse_thrust)


def by_level(parameters: ParameterSet, record: Record, profile: Record) -> np.ndarray:
    """(levels,) N^2: mean square of that error at each level of a mission's profile."""
    errors = predict(parameters.model, parameters.values, _measured(record)).thrust - record["thrust"]
    begins = np.searchsorted(record.time - record.time[0], profile.time[1:-1])
    return np.array([np.nanmean(own**2) for own in np.split(errors, begins)])


def worse(errors: np.ndarray, usual: np.ndarray) -> float:
    """How rarely a mission that was flown before is predicted so much worse by chance, (levels,) mean squares level for level
    (signed ranks of their ratios; Wilcoxon, Biometrics Bulletin 1, 1945): what lies within a model's own error everywhere
    shows in the sum."""
    ratio = np.log(errors / usual)
    ratio = ratio[np.isfinite(ratio)]  # not of a level without readings
    return float(wilcoxon(ratio, alternative="greater").pvalue) if len(ratio) else 1.0


def within(profile: Record, low: float, high: float) -> Record:
    """A mission with its levels between these [N]."""
    return Record(profile.columns | {"thrust_set": np.clip(profile["thrust_set"], low, high)}, profile.source)


def _alarms(parameters: ParameterSet, band: Band, record: Record) -> bool:
    """Whether a twin with this model would have raised an alarm in a mission."""
    twin = Twin(KernelPlant(parameters.model, parameters.values), band, rig=parameters.rig)
    rows = np.column_stack([record[name] for name in ("time", "omega_ref", "beta_ref", "thrust")]).tolist()
    twin.start(*rows[0][:3])
    return any(twin.update(*row).alarmed for row in rows)


def _measured(record: Record) -> Record:
    """A run as a campaign's record: the commands that acted, and what was read."""
    return Record({name: record[name] for name in ("time", "omega_ref", "beta_ref", "thrust", "omega")}, record.source)


def _campaign(record: Record, folder: Path, model: ParameterSet) -> Campaign:
    return Campaign(folder, None, (), _measured(record), None, None, rig=model.rig)


def _learned(flight: Flight) -> tuple[dict[str, float], dict[str, float]]:
    """(values, standard deviations) of the adapted parameters at a mission's end."""
    own = {n.removeprefix("adapted."): float(c[-1]) for n, c in flight.twin.items() if n.startswith("adapted.")}
    return own, {name: float(flight.twin[f"std.{name}"][-1]) for name in own}


def _moved(model: ParameterSet, flight: Flight) -> bool:
    """Whether the adapted model is one to look at; which one goes on is decided by another mission."""
    before, (own, std) = adaptable(model, "vpp twin").values, _learned(flight)
    return any(abs(value - before[name]) > CERTAIN * std[name] for name, value in own.items())


def _adapted(model: ParameterSet, flight: Flight) -> Model:
    """The model with what the twin had made of its parameters in the end: those that show at rest together, which it knows
    together, and each that shows on the way alone; of these the ones with which the mission is predicted best. A twin goes on
    learning a lag from moves that are none's, beside an actuator at its limit, and what it learns there holds nowhere else."""
    wider, (own, std) = adaptable(model, "vpp twin"), _learned(flight)
    at_rest = watched(wider.model, tuple(own))
    groups = [[name for name in own if name in at_rest], *([name] for name in own if name not in at_rest)]
    kept = (
        [n for group, taken in zip(groups, wanted, strict=True) if taken for n in group]
        for wanted in product((True, False), repeat=len(groups))
    )
    tried = [wider.replaced({n: own[n] for n in names}, {n: std[n] for n in names}) for names in kept if names]
    errors = [error(one, flight.record) for one in tried]
    return Model("adapted", tried[int(np.argmin(errors))], min(errors), np.nan)


class _Flights:
    """Flights of a round, each with a folder of its own in `folder`."""

    def __init__(self, rig: Rig, number: int, folder: Path):
        self._rig, self._number, self.folder, self._count = rig, number, folder, 0

    def __call__(
        self, what: str, settings: Mapping[str, float], profile: Record, twins: Twins | None = None, times: int = 1
    ) -> Flight:
        """RunEnded for one that ended early: whoever stopped it, or whatever tripped, does not want the next one to begin."""
        self._rig.word(f"round {self._number}: {what}")
        self._count += 1
        setup = self._rig.setup(self._number, self._count)
        done = fly(setup, settings, profile, self.folder / f"flight_{self._count:02d}", twins, times)
        if done.ended:
            raise RunEnded(f"round {self._number}: {what}: {done.ended}")
        return done


def _searched(
    day: Day, flights: _Flights, referee: Referee, flies: Mapping[str, float], seed: int
) -> tuple[Mapping[str, float] | None, list[float], int]:
    """(where the search's next generation has led it, None: none flew, or the model refuses that; the costs of those that flew;
    how many were refused).

    A refused one costs what the model predicts, against what flies. The cheapest of a generation would owe it to its noise."""
    if day.search is None:
        day.search = Search(flies, GAINS, seed)
    generation = day.search.asked()
    predicted = [referee.predicted(each) for each in generation]
    costs = [
        flights(f"try {k + 1} of {len(generation)}", each, day.profile).cost if allowed else np.nan
        for k, (each, (_, allowed)) in enumerate(zip(generation, predicted, strict=True))
    ]
    flew = [cost for cost in costs if np.isfinite(cost)]
    if flew:
        usual = float(np.median(flew))
        day.search.tell([usual * share if np.isnan(c) else c for c, (share, _) in zip(costs, predicted, strict=True)])
    there = day.search.favourite
    return there if flew and referee.predicted(there)[1] else None, flew, int(np.isnan(costs).sum())
