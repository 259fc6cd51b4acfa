"""Close the loop: residual, missing effect, augmented model, error before and after."""

from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from threadpoolctl import threadpool_limits

from identification.diagnose.distinguish import Distinguishability, distinguishability
from identification.diagnose.evidence.noise import Noise, noise_at_rest, noise_from_residual, noise_of
from identification.diagnose.evidence.whitened import Experiment
from identification.diagnose.experiment import discriminating_experiment
from identification.diagnose.following import Following, following
from identification.diagnose.locate import locate
from identification.diagnose.search.candidates import candidates
from identification.diagnose.search.explainable import Explained, Left, Remainder
from identification.diagnose.search.fits import UNTOLD, Fit, Searcher
from identification.diagnose.search.further import gains_further, much
from identification.diagnose.search.judge import Seen, seen
from identification.diagnose.search.stepwise import Selection, select
from identification.diagnose.starting import Starting, exportable, from_given, from_identification
from identification.diagnose.verdict import rivals, verdict
from identification.fit.uncertainty import NORMAL_95
from identification.identify import Identification
from identification.worth.prediction import Prediction, predict
from vpp_fmu.campaign import Campaign
from vpp_fmu.errors import BadInput
from vpp_fmu.kernel.plant import LIBRARY, plant
from vpp_fmu.kernel.types import Effect
from vpp_fmu.parameters import ParameterSet
from vpp_fmu.record import Record
from vpp_fmu.rig import Rig

CHANGED = ("attributed", "family", "partly")
"""Verdicts that put effects into the model."""

HELD_SHARE = 1.0 / 3.0
"""Of the open-loop record, its end, kept from the fits where a campaign has no validation record."""


@dataclass(frozen=True)
class Diagnosis:
    """What a campaign's residual was traced to. `explained`: share of the explainable error removed on unseen data.

    `following`: whether what the search's final set leaves follows the commands still.
    `base`: the model without any further effect, as identified; whitened and bent towards what is missing, the search's own
    base does worse on unseen data and would flatter what is found. `given`: the model that was brought, as it was brought; None
    where the campaign was identified first.
    """

    campaign: Campaign
    identification: Identification | None
    given: ParameterSet | None
    rig: Rig
    base: Fit
    noise: Noise
    selection: Selection
    verdict: str
    explained: Explained | None
    left: Left
    before_left: Left
    following: Following
    family: Mapping[str, list[str]]
    doubt: Mapping[str, float | None]
    apart: Distinguishability
    location: Mapping
    experiment: Record
    held: tuple[Record, ...]
    held_before: Seen
    held_after: Seen

    @property
    def final(self) -> Fit:
        """The model with the effects that stand; what removes too little to be worth a name is not in it."""
        return self.selection.final if self.verdict in CHANGED else self.base

    @property
    def fits(self) -> dict[str, Fit]:
        """The models to show: before and after where effects stand, else the only one."""
        return {"before": self.base, "after": self.final} if self.final.effects else {"model": self.base}

    def parameters(self, fit: Fit) -> ParameterSet:
        """A fit's parameters as a set that exports."""
        source = {"made_by": "vpp diagnose", "campaign": self.campaign.folder.name, "verdict": self.verdict}
        source |= {"record_seconds": float(self.campaign.open_loop.time[-1]), "rig": self.rig.summary()}
        doubt = {n: s for n, s in self.doubt.items() if n in fit.values} if fit is self.final else {}
        return ParameterSet(exportable(fit.evidence.model), source=source).replaced(fit.values, doubt)

    def prediction(self, fit: Fit, record: Record) -> Prediction:
        """A fit's open-loop response to a record."""
        return predict(fit.evidence.model, fit.values, record)


def diagnose(
    campaign: Campaign,
    library: Iterable[Effect] = LIBRARY,
    workers: int = 2,
    seed: int = 0,
    stage: Callable[[str], None] = lambda text: None,
    given: ParameterSet | None = None,
) -> Diagnosis:
    """Trace a campaign's residual to what the model lacks. `stage` is told what begins.

    The model is identified from the campaign first, or it is `given`, its effects part of the base. BadInput where the campaign
    has no open-loop record.
    """
    with threadpool_limits(1):  # the fits run side by side: threads inside each would only fight
        stage("identify")
        campaign = campaign.leading()
        fitted, held = _split(campaign)
        at = from_given(campaign, given, library, fitted) if given else from_identification(campaign, library, seed)
        library, noise = at.library, _noise(campaign, at)
        experiments = [Experiment(fitted, noise)]
        unseen = [Experiment([record], noise) for record in held]
        searcher = Searcher(experiments, at.names, at.knowledge, at.first, library)
        base = searcher.fit((), {}, (), at.values)
        options = candidates(library, (*fitted, *held))
        stage("what can be told apart")
        remainder, before = Remainder(campaign, unseen, noise), searcher.standing(at.values)
        with ThreadPoolExecutor(workers) as pool:
            apart = distinguishability(base, options, library, pool.map)
            selection = select(searcher, base, options, unseen, remainder.left, pool, stage)
            stage("judge")
            family = rivals(searcher, selection, unseen)
            rest = following(selection.final)

            def further(fit: Fit) -> bool:
                follows = rest.significant and rest.gain > much(base, fit)
                return follows or gains_further(searcher, base, fit, options, pool)

            word, explained, left = verdict(selection, before, remainder, family, further)
        final = selection.final if word in CHANGED else before
        shown = predict(final.evidence.model, final.values, campaign.open_loop)
        return Diagnosis(
            campaign=campaign,
            identification=at.identification,
            given=given,
            rig=at.rig,
            base=before,
            noise=noise,
            selection=selection,
            verdict=word,
            explained=explained,
            left=left,
            before_left=remainder.left(before),
            following=rest,
            family=family,
            doubt=_doubt(final),
            apart=apart,
            location=locate(campaign, shown.thrust, shown.omega, shown.beta),
            experiment=discriminating_experiment(seed, at.rig.speed, at.rig.pitch),
            held=tuple(held),
            held_before=seen(before, unseen),
            held_after=seen(final, unseen),
        )


def _split(campaign: Campaign) -> tuple[list[Record], list[Record]]:
    """(records of the fitted experiment, unseen records)."""
    if campaign.open_loop is None:
        raise BadInput(campaign.folder, "open_loop.csv", "no such file", "a record with time, omega_ref, beta_ref, thrust")
    fitted = [r for r in (campaign.open_loop, campaign.repeat) if r is not None]
    if campaign.validation is not None:
        return fitted, [campaign.validation]
    cut = round(len(campaign.open_loop) * (1.0 - HELD_SHARE))
    end = campaign.open_loop.part(slice(cut, None))
    end = end.with_columns(time=end.time - end.time[0])
    return [r.part(slice(None, cut)) for r in fitted], [end]


def _noise(campaign: Campaign, at: Starting) -> Noise:
    if campaign.repeat is not None:
        return noise_of(campaign.open_loop, campaign.repeat)
    if (noise := noise_at_rest(campaign.open_loop)) is not None:
        return noise
    shown = predict(plant((), at.library), at.values, campaign.open_loop)
    return noise_from_residual(campaign.open_loop, shown.thrust - campaign.open_loop["thrust"])


def _doubt(fit: Fit) -> dict[str, float | None]:
    """Standard deviations of all fitted parameters, for whitened residuals; a threshold's from its interval; None where the
    records leave open where a parameter is."""
    free = np.flatnonzero(~fit.solution.active)
    columns = fit.solution.jacobian[:, free]
    size = np.linalg.norm(columns, axis=0)
    columns, size = columns / np.where(size > 0.0, size, 1.0), np.where(size > 0.0, size, 1.0)
    told, axes = np.linalg.eigh(columns.T @ columns)
    known = told > UNTOLD * told[-1]
    to_values = fit.evidence.coordinates.jacobian(fit.solution.value)[:, free] / size
    std = np.linalg.norm(to_values @ (axes[:, known] / np.sqrt(told[known])), axis=1)
    left_open = np.linalg.norm(to_values @ axes[:, ~known], axis=1) > np.sqrt(UNTOLD) * np.linalg.norm(to_values, axis=1)
    found = {
        name: None if untold else float(s)
        for name, s, untold in zip(fit.evidence.coordinates.names, std, left_open, strict=True)
    }
    return found | {n: (high - low) / (2 * NORMAL_95) for n, (low, high) in fit.thresholds.items()}
