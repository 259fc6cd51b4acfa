"""The rounds of a day. A flight is a run of the rig under a control law; a mission is a flight over random thrust levels.

Each round flies a mission beside the twin. The twin may raise an alarm, or the model may predict a repeated mission worse than
before. If the adapted model does not explain that, the mission's record is diagnosed with the twin's model as the reference.
New laws are gains retuned on the model, gains searched on the rig, and a network learned on plants of the model's uncertainty,
as far as the policy has them. The law with the lowest measured cost is used next, if it is better than the present one
(Reinforcement Twinning: Schena, Marques, Poletti, Ahizi, Van den Berghe, Mendez, 2024).
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
from identification.tune.learn import learn
from identification.tune.profile import common_reach, rig_profile
from vpp_fmu.app.day.flight import GAINS, Flight, Law, Twins, fly, mission
from vpp_fmu.app.day.policy import GainSearch, Referee, retuned, task
from vpp_fmu.campaign import Campaign
from vpp_fmu.kernel.scales import PAPER
from vpp_fmu.kernel.twin import watched
from vpp_fmu.parameters import ParameterSet
from vpp_fmu.plants import KernelPlant
from vpp_fmu.record import Record

POLICIES = ("fixed", "model-based", "model-free", "both", "learned", "all")
FIXED, MODEL_BASED, MODEL_FREE, BOTH, LEARNED, ALL = POLICIES

DIAGNOSED = "diagnosed"
"""Name of the model from the diagnosis of a mission."""

TIMES = 4
"""Repetitions of the profile per finalist. The cost scatters by 2 % between them; the best and fair gains differ by as much.
Each takes as long as a trial of the search."""

BETTER = 0.1
"""Level of the t test that new gains are better than the present ones. A lower level would reject more of the better gains,
which may return in the next round."""

WORSE = 0.01
"""Level of the test that a repeated mission is predicted worse: one false alarm in a hundred rounds."""

LEFT = 0.1
"""The same for the adapted model: a needless diagnosis costs a minute, a missed effect remains as a changed parameter."""

UNITS, GENERATIONS, JUDGED = 6, 300, 40
"""Hidden units of a learned law, generations of its search (some 20 s), and held-out plants of its comparison."""


@dataclass(frozen=True, eq=False)
class CandidateModel:
    """A candidate model of the rig: `name`, `parameters`, and its rms thrust error [N] in the mission of its fit (`fitted`) and
    in the next one, a hold-out (`unseen`)."""

    name: str
    parameters: ParameterSet
    fitted: float
    unseen: float

    @property
    def error(self) -> float:
        """The rms error on the hold-out mission [N]; on the mission of the fit if there was no other."""
        return self.fitted if np.isnan(self.unseen) else self.unseen


@dataclass(frozen=True, eq=False, kw_only=True)
class Modelled:
    """The choice of a round's model. `mission`: the first flight; `alarm`: (s, its cause), or None; `models`: candidates, of
    which `chosen` has the least error on a hold-out mission; `verdict` of the diagnosis, "" without one, and the effects that
    it `named`. `wanted`: profile of the last mission, which the next round repeats; `usual`: mean square error of the chosen
    model at each of its levels, (levels,) N^2.
    """

    mission: Flight
    alarm: tuple[float, str] | None
    models: tuple[CandidateModel, ...]
    chosen: CandidateModel
    verdict: str
    named: tuple[str, ...]
    wanted: Record
    usual: np.ndarray


@dataclass(frozen=True, eq=False, kw_only=True)
class Round(Modelled):
    """A round, its `number` from 1, with the effects `hidden` in the rig.

    `costs`: by branch, measured costs of the finalist's repetitions; `tries`: costs of the search's flights, `refused`: number
    of gains that the model rejected. `winner`: the branch of the next `law`.
    """

    number: int
    hidden: tuple[str, ...]
    costs: Mapping[str, tuple[float, ...]]
    tries: tuple[float, ...]
    refused: int
    winner: str
    law: Law

    @property
    def settings(self) -> Mapping[str, float]:
        """Settings of the next controller, or of the fallback of the next learned law."""
        return self.law.settings

    @property
    def cost(self) -> float:
        """Mean measured cost of the next law."""
        return float(np.mean(self.costs[self.winner]))


@dataclass(eq=False)
class Day:
    """A day's rounds, and its initial model and gains. `search`: that on the rig, continued while the gains stay."""

    begun: ParameterSet
    settings: Mapping[str, float]
    profile: Record
    rounds: list[Round] = field(default_factory=list)
    search: GainSearch | None = None

    @property
    def parameters(self) -> ParameterSet:
        """The present model."""
        return self.rounds[-1].chosen.parameters if self.rounds else self.begun

    @property
    def flies(self) -> Law:
        """The present law."""
        return self.rounds[-1].law if self.rounds else Law(self.settings)


@dataclass(frozen=True, eq=False)
class RigAccess:
    """Access to the rig: `setup(round, flight)` returns it, `word(what)` waits for the operator's consent to `what`,
    `hidden(round)` returns the names of its hidden effects."""

    setup: Callable[[int, int], Setup]
    word: Callable[[str], None]
    hidden: Callable[[int], tuple[str, ...]]


def new_day(parameters: ParameterSet, settings: Mapping[str, float]) -> Day:
    """A day that begins with this model and this controller."""
    return Day(parameters, dict(settings), rig_profile(parameters, {"dual": settings}))


def next_round(
    day: Day, rig: RigAccess, band: Band, policy: str, folder: Path, seed: int, workers: int, stage: Callable[[str], None]
) -> Round:
    """Fly one round; its logs go to `folder`. BadInput; RunEnded for a flight that ended early."""
    number, flights = len(day.rounds) + 1, _Flights(rig, len(day.rounds) + 1, folder)
    law, flies = day.flies, day.flies.settings
    modelled = _modelled(day, flights, band, seed, workers, stage)
    chosen, as_it_was = modelled.chosen, modelled.models[0]
    tuning = task(chosen.parameters, day.profile, band.noise, flies["sample_time"], seed)
    finalists = {"what flew": law}
    tries: list[float] = []
    refused = 0

    def flies_already(branch: str) -> bool:
        return bool(day.rounds) and day.rounds[-1].winner == branch and chosen is as_it_was

    if policy in (MODEL_BASED, BOTH, ALL) and not flies_already(MODEL_BASED):
        stage("retune on the model")
        finalists[MODEL_BASED] = Law(retuned(tuning, flies))
    if policy in (MODEL_FREE, BOTH, ALL):
        stage("search on the rig")
        best, tries, refused = _searched(day, flights, Referee(tuning, flies), flies, 1000 * seed + number)
        if best is not None:
            finalists[MODEL_FREE] = Law(best)
    if policy in (LEARNED, ALL) and not flies_already(LEARNED):
        stage("learn on plants of the model")
        found = learn(replace(tuning, seed=1000 * seed + number), flies, UNITS, GENERATIONS, JUDGED)
        if found.passes:
            finalists[LEARNED] = Law(flies, found.policy)
    stage("compare on the rig")
    costs = {name: flights(name, each, day.profile, times=TIMES).costs for name, each in finalists.items()}
    winner = best_of(costs)
    if winner == MODEL_BASED:
        day.search = None  # it searched about other gains
    return Round(
        **vars(modelled),
        number=number,
        hidden=rig.hidden(number),
        costs=costs,
        tries=tuple(tries),
        refused=refused,
        winner=winner,
        law=finalists[winner],
    )


def _modelled(day: Day, flights: "_Flights", band: Band, seed: int, workers: int, stage: Callable[[str], None]) -> Modelled:
    """Fly the round's missions, and choose the next model."""
    number, model, flies = len(day.rounds) + 1, day.parameters, day.flies
    low, high = common_reach(model, {"dual": flies.settings})
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
    models, verdict = [CandidateModel("as it was", model, error(model, first.record), np.nan)], ""
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
        # The rig waits, and a mission is too short to learn a term of unknown form.
        found = diagnose(_campaign(first.record, flights.folder, model), given=model, workers=workers, thorough=False)
        verdict = found.verdict
        # A model that explains a part is a candidate, too, because another mission decides.
        best = found.final if found.final.effects else found.selection.final
        if best.effects and not found.refuted:
            named = tuple(e for e in best.effects if e not in model.model.optional)
            own = found.parameters(best)
            own = replace(own, source={**model.source, **own.source})
            models.append(CandidateModel(DIAGNOSED, own, error(own, first.record), np.nan))
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
    """The branch with the lowest mean cost; the first, the present law, if the test does not find the other better."""
    flew, best = next(iter(costs)), min(costs, key=lambda name: float(np.mean(costs[name])))
    return best if best == flew or ttest_ind(costs[best], costs[flew], alternative="less").pvalue < BETTER else flew


def diagnosed(done: Round) -> str:
    """A round's diagnosis in words; "" without one."""
    if done.verdict in CHANGED or not done.named:
        return f"{done.verdict} {' + '.join(done.named)}".strip()
    return f"{done.verdict}: a part by {' + '.join(done.named)}"


def error(parameters: ParameterSet, record: Record) -> float:
    """rms error of the model's thrust for a record's commands, N."""
    return float(predict(parameters.model, parameters.values, _measured(record)).rmse_thrust)


def by_level(parameters: ParameterSet, record: Record, profile: Record) -> np.ndarray:
    """(levels,) N^2: mean square error of the model's thrust at each level of a mission's profile."""
    errors = predict(parameters.model, parameters.values, _measured(record)).thrust - record["thrust"]
    begins = np.searchsorted(record.time - record.time[0], profile.time[1:-1])
    return np.array([np.nanmean(own**2) for own in np.split(errors, begins)])


def worse(errors: np.ndarray, usual: np.ndarray) -> float:
    """p-value of the hypothesis that a repeated mission is predicted as well as before, from (levels,) mean squares (signed
    ranks of their ratios; Wilcoxon, Biometrics Bulletin 1, 1945). The test detects small errors at many levels."""
    ratio = np.log(errors / usual)
    ratio = ratio[np.isfinite(ratio)]  # without levels that have no readings
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
    """A run as a campaign's record: the commands that acted, and the readings."""
    return Record({name: record[name] for name in ("time", "omega_ref", "beta_ref", "thrust", "omega")}, record.source)


def _campaign(record: Record, folder: Path, model: ParameterSet) -> Campaign:
    return Campaign(folder, None, (), _measured(record), None, None, rig=model.rig)


def _learned(flight: Flight) -> tuple[dict[str, float], dict[str, float]]:
    """(values, standard deviations) of the adapted parameters at a mission's end."""
    own = {n.removeprefix("adapted."): float(c[-1]) for n, c in flight.twin.items() if n.startswith("adapted.")}
    return own, {name: float(flight.twin[f"std.{name}"][-1]) for name in own}


def _moved(model: ParameterSet, flight: Flight) -> bool:
    """Whether a parameter was adapted by more than CERTAIN standard deviations: the adapted model is then a candidate."""
    before, (own, std) = adaptable(model, "vpp twin").values, _learned(flight)
    return any(abs(value - before[name]) > CERTAIN * std[name] for name, value in own.items())


def _adapted(model: ParameterSet, flight: Flight) -> CandidateModel:
    """The model with those adapted parameters that predict the mission best. Statically visible ones are taken together, as
    they are correlated, each dynamic one separately: a lag that was adapted at an actuator's limit is wrong elsewhere."""
    wider, (own, std) = adaptable(model, "vpp twin"), _learned(flight)
    at_rest = watched(wider.model, tuple(own))
    groups = [[name for name in own if name in at_rest], *([name] for name in own if name not in at_rest)]
    kept = (
        [n for group, taken in zip(groups, wanted, strict=True) if taken for n in group]
        for wanted in product((True, False), repeat=len(groups))
    )
    tried = [wider.replaced({n: own[n] for n in names}, {n: std[n] for n in names}) for names in kept if names]
    errors = [error(one, flight.record) for one in tried]
    return CandidateModel("adapted", tried[int(np.argmin(errors))], min(errors), np.nan)


class _Flights:
    """Flights of a round, each with a folder of its own in `folder`."""

    def __init__(self, rig: RigAccess, number: int, folder: Path):
        self._rig, self._number, self.folder, self._count = rig, number, folder, 0

    def __call__(self, what: str, law: Law, profile: Record, twins: Twins | None = None, times: int = 1) -> Flight:
        """RunEnded for a flight that ended early, so that the next one does not begin."""
        self._rig.word(f"round {self._number}: {what}")
        self._count += 1
        setup = self._rig.setup(self._number, self._count)
        done = fly(setup, law, profile, self.folder / f"flight_{self._count:02d}", twins, times)
        if done.ended:
            raise RunEnded(f"round {self._number}: {what}: {done.ended}")
        return done


def _searched(
    day: Day, flights: _Flights, referee: Referee, flies: Mapping[str, float], seed: int
) -> tuple[Mapping[str, float] | None, list[float], int]:
    """(mean of the search after its next generation, None if no gains were flown or the model rejects it; costs of the flown
    gains; number of rejected gains).

    Rejected gains get the cost that the model predicts, relative to the present gains. The mean is used, because the cheapest
    of a generation is so by noise."""
    if day.search is None:
        day.search = GainSearch(flies, GAINS, seed)
    generation = day.search.asked()
    predicted = [referee.predicted(each) for each in generation]
    costs = [
        flights(f"try {k + 1} of {len(generation)}", Law(each), day.profile).cost if allowed else np.nan
        for k, (each, (_, allowed)) in enumerate(zip(generation, predicted, strict=True))
    ]
    flew = [cost for cost in costs if np.isfinite(cost)]
    if flew:
        usual = float(np.median(flew))
        day.search.tell([usual * share if np.isnan(c) else c for c, (share, _) in zip(costs, predicted, strict=True)])
    there = day.search.favourite
    return there if flew and referee.predicted(there)[1] else None, flew, int(np.isnan(costs).sum())
