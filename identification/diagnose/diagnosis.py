"""The result of a diagnosis: the models before and after, and what decided between them."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

from identification.assessment.pairs import agreed_order, exchangeable
from identification.assessment.prediction import Prediction, predict
from identification.assessment.reading_noise import ReadingNoise
from identification.diagnose.crossval import HeldOut
from identification.diagnose.distinguish import Distinguishability
from identification.diagnose.guess import Guess
from identification.diagnose.initial_model import exportable
from identification.diagnose.lack_of_fit import LackOfFit
from identification.diagnose.learned.learn import Attempt, Learned
from identification.diagnose.search.fits import Fit
from identification.diagnose.selection import Selection
from identification.diagnose.validation import CHANGED
from identification.fit.coordinates import CHANNELS
from identification.fit.noise import Noise
from identification.gate.finding import Finding
from identification.identify import Identification
from identification.logger import Logger
from identification.roles import Fitted, Unseen
from vpp_fmu.campaign import Campaign
from vpp_fmu.parameters import ParameterSet
from vpp_fmu.record import Record
from vpp_fmu.rig import Rig

if TYPE_CHECKING:
    from identification.power.diagnose import PowerDiagnosis


@dataclass(frozen=True)
class Diagnosis:
    """Result of a diagnosis.

    `quality`: findings of the gate in the files, and in the fit of the identification. `logger`: the logger for which the
    records are corrected. `base`: the identified model, without further effects. `final`: the exported model. `given`: the
    given model before any fit; None if the campaign was identified first. `before`, `after`: lack of fit of the base and of the
    selected set. `held_out_before`, `held_out_after`: cross-validation of base and final model. `unseen`: the validation
    record, used only after the model is final. `refuted`: why validation refutes the selected set, else "". `attempt`: the
    search for a learned term, if no effect explains the lack of fit. `best_guess`: the best candidate if the lack of fit is not
    explained; None otherwise, or without candidates. `not_tried`: steps for which the time budget did not suffice. `channels`:
    verdict and names of effects of the speed and of the thrust. `missed`: why something is missing that the fitted records do
    not show as lack of fit, else "". `power`: diagnosis of the electrical power, None without.
    """

    campaign: Campaign
    quality: tuple[Finding, ...]
    logger: Logger
    identification: Identification | None
    given: ParameterSet | None
    rig: Rig
    fitted: tuple[Fitted, ...]
    base: Fit
    noise: Noise
    reading_noise: ReadingNoise
    selection: Selection
    verdict: str
    before: LackOfFit
    after: LackOfFit
    distinguishability: Distinguishability
    location: Mapping
    experiment: Record
    final: Fit
    held_out_before: HeldOut
    held_out_after: HeldOut
    unseen: Unseen | None
    refuted: str
    attempt: Attempt
    best_guess: Guess | None
    not_tried: tuple[str, ...]
    channels: Mapping[str, Mapping]
    missed: str
    power: "PowerDiagnosis | None" = None

    @property
    def learned(self) -> Learned | None:
        """The learned term of the final model."""
        return self.attempt.learned

    @property
    def left_out(self) -> tuple[str, ...]:
        """Accepted effects that are not in the final model, because their start value is specific to a record."""
        if self.verdict not in CHANGED or self.refuted or self.learned:
            return ()
        return tuple(name for name in self.selection.final.effects if name not in self.final.effects)

    @property
    def fits(self) -> dict[str, Fit]:
        """The models to show: before and after if effects are added, else the only one."""
        return {"before": self.base, "after": self.final} if self.final.effects else {"model": self.base}

    @property
    def shown(self) -> Record:
        """The record to show: the unseen one, else the first fitted one."""
        return self.unseen.record if self.unseen is not None else self.fitted[0].record

    @property
    def shown_name(self) -> str:
        """Name of the record to show."""
        return self.unseen.name if self.unseen is not None else self.fitted[0].name

    def parameters(self, fit: Fit) -> ParameterSet:
        """A fit's parameters as a set for export; exchangeable lags of a channel have the slower one first."""
        source = {"made_by": "vpp diagnose", "campaign": self.campaign.folder.name, "verdict": self.verdict}
        first = self.fitted[0].record
        source |= {"record_seconds": float(first.time[-1]), "sample_period": first.period, "rig": self.rig.summary()}
        source["logger"] = self.logger.summary()
        renamed = self.renamed(fit)
        values, std = ({renamed.get(n, n): v for n, v in each.items()} for each in (fit.values, fit.std()))
        found = ParameterSet(exportable(fit.problem.model), source=source).replaced(values, std)
        start = self.given or (self.identification and self.identification.parameters)
        return found.with_power_of(start) if start else found

    def renamed(self, fit: Fit) -> dict[str, str]:
        """Names under which a fit's lags are written, if they differ from its own."""
        return agreed_order(fit.problem.model, fit.values, self.fitted[0].record)

    @property
    def std(self) -> dict[str, float | None]:
        """Standard errors of the parameters of the final model, by the names under which they are written."""
        renamed = self.renamed(self.final)
        return {renamed.get(n, n): std for n, std in self.final.std().items()}

    @property
    def lag_order(self) -> dict[str, str]:
        """By channel, in words: how the order of its two lags in the final model is determined."""
        fit, record = self.final, self.fitted[0].record
        free = {u: exchangeable(fit.problem.model, fit.values, record, u) for u in CHANNELS}
        return {u: "exchangeable, the slower first" if same else "identified from the data" for u, same in free.items()}

    def prediction(self, fit: Fit, record: Record) -> Prediction:
        """Open-loop response of a fit to a record."""
        return predict(fit.problem.model, fit.values, record)

    def errors(self, fit: Fit) -> tuple[float, float | None]:
        """(thrust [N], speed [rpm]) rms on the unseen record, else cross-validated, of the base or the final model."""
        if self.unseen is not None:
            shown = self.prediction(fit, self.unseen.record)
            return shown.rmse_thrust, shown.rmse_omega
        held_out = self.held_out_before if fit is self.base else self.held_out_after
        return held_out.rmse_thrust, held_out.rmse_omega

    @property
    def explained(self) -> float | None:
        """Share of the mean square thrust error beyond the noise that the final model removes; None if there is none."""
        before, after = (self.errors(fit)[0] ** 2 for fit in (self.base, self.final))
        beyond = before - self.noise.floor**2
        return (before - after) / beyond if self.final.effects and beyond > 0.0 else None
