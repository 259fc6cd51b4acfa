"""Identify the parameters of a campaign, with their uncertainty."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import asdict, dataclass, replace
from math import isclose
from typing import TYPE_CHECKING

import numpy as np

from identification.assessment.model_error import ModelError, model_error
from identification.assessment.pairs import forms, slow_first
from identification.assessment.prediction import Prediction, band, predict, summaries
from identification.assessment.profile import profiled
from identification.assessment.reading_noise import ReadingNoise, reading_noise
from identification.assessment.residual_tests import ResidualTests, residual_tests
from identification.fit.coordinates import CHANNELS, slowest
from identification.fit.identifiability import weakly_identified
from identification.fit.problem import Prior
from identification.fit.refine import BASE_PARAMETERS, Refinement, refine
from identification.fit.uncertainty import Uncertainty
from identification.gate.finding import Finding
from identification.gate.fitted import of_fit
from identification.gate.gate import Passed, passed
from identification.logger import Logger
from identification.logger_fit import as_logged
from identification.static.static_map import StaticFit, static_fit
from identification.static.steady import with_steady_points
from identification.steps.response import StepSummary, fit_steps
from identification.unrefined import unrefined, with_steps
from vpp_fmu.campaign import Campaign
from vpp_fmu.errors import BadInput
from vpp_fmu.kernel.plant import AVERAGED, BASE
from vpp_fmu.kernel.types import Model
from vpp_fmu.parameters import ParameterSet
from vpp_fmu.record import Record

if TYPE_CHECKING:
    from identification.power.fit import PowerFit


@dataclass(frozen=True)
class Identification:
    """Result of an identification: parameters, statistics of the fit, and predictions of all long records by name.

    `uncertainty`: of the identifiable parameters; `not_identifiable`: the reason for each other one, by name. `refinement`,
    `tests`: None without a record to fit; the parameters are then those of steady points and steps. `fitted`: names of the
    fitted records; the other predictions are of hold-out records. `logger`: the logger for which the records are corrected.
    `bands`: standard deviation (rows,) N of a predicted reading, from parameters and noise, by record. `tests`: of the thrust
    residual of the first fitted record. `noise`: of one thrust reading, None if it cannot be estimated. `quality`: findings of
    the gate in the files and in the fit. `power`: None without torque and power.
    """

    campaign: Campaign
    parameters: ParameterSet
    start: Mapping[str, float]
    static: StaticFit | None
    steps: StepSummary | None
    refinement: Refinement | None
    uncertainty: Uncertainty
    not_identifiable: Mapping[str, str]
    fitted: tuple[str, ...]
    predictions: Mapping[str, Prediction]
    bands: Mapping[str, np.ndarray]
    tests: ResidualTests | None
    noise: ReadingNoise | None
    quality: tuple[Finding, ...]
    logger: Logger
    power: "PowerFit | None" = None

    @property
    def coverage(self) -> dict[str, float | None]:
        """Share of a record's readings within the prediction's 95 % band, by record."""
        return {name: p.within(self.bands[name]) for name, p in self.predictions.items()}

    @property
    def model_error(self) -> ModelError | None:
        """The error of the model without the noise; a repeat of the open-loop record is not counted again."""
        fitted, unseen = (
            [self.predictions[name] for name in names if name != "repeat" or "open_loop" not in names]
            for names in (self.fitted, self.unseen)
        )
        points, terms = (self.static.residual, len(self.static.coefficients)) if self.static else (None, 0)
        count = len(self.uncertainty.names)
        return model_error(fitted, unseen, self.parameters.values, count, self.noise.std if self.noise else 0.0, points, terms)

    @property
    def unseen(self) -> tuple[str, ...]:
        """Names of the hold-out records."""
        return tuple(name for name in self.predictions if name not in self.fitted)

    @property
    def at_bounds(self) -> dict[str, float]:
        """The bound at which a parameter ended, by name."""
        declared = {p.name: p for p in self.parameters.model.parameters}
        found = zip(self.uncertainty.names, self.uncertainty.values.tolist(), strict=True)
        return {n: bound for n, v in found for bound in (declared[n].minimum, declared[n].maximum) if isclose(v, bound)}

    def summary(self) -> dict:
        """The content of `identification.json`."""
        uncertainty = self.uncertainty
        static = self.static
        return {
            "format": "vpp-identification/1",
            "effects": list(self.parameters.model.optional),
            **uncertainty.summary(),
            "at_bounds": self.at_bounds,
            "not_identifiable": dict(self.not_identifiable),
            **self._search(),
            "time_constants": forms(uncertainty),
            "residual_tests": self.tests and {"share_of_lags_outside_95_percent_band": self.tests.outside},
            "prediction_band_coverage": self.coverage,
            **(self.noise.summary() if self.noise else {"noise_floor_thrust": None}),
            "model_error": (found := self.model_error) and asdict(found),
            "fitted": list(self.fitted),
            "unseen": list(self.unseen),
            **summaries(self.predictions),
            "steps": self.steps and self.steps.summary(),
            "static_map": static and static.summary(),
            **({"power": self.power.summary()} if self.power else {}),
            "missing": list(self.campaign.missing),
            "logger": self.logger.summary(),
            "quality": [finding.summary() for finding in self.quality],
        }

    def _search(self) -> dict:
        """Statistics of the search; null without a record to fit."""
        r = self.refinement
        return {
            "method": r and r.method,
            "cost_start": r and r.cost_start,
            "cost_final": r and r.cost_final,
            "iterations": r and len(r.curve) - 1,
            "evaluations": r and r.evaluations,
            "starts": r and {"tried": r.starts, "reached_the_optimum": r.reached},
            "seconds": r and r.seconds,
        }


def identify(
    campaign: Campaign,
    model: Model = BASE,
    method: str = "levenberg-marquardt",
    starts: int = 8,
    seed: int = 0,
    records: Mapping[str, Record] | None = None,
    accept: Iterable[str] = (),
    stage: Callable[[str], None] = lambda text: None,
    gate: Passed | None = None,
) -> Identification:
    """Fit the static map by least squares, the lags to step responses, then all parameters to the records, the map as prior.

    The open-loop record, its repeat and further `records`, by name, are fitted together; without any, the validation record.
    Files may be missing: without any record, the result is that of map and steps alone. Without means of steady points, these
    are computed from the raw samples. `accept`: codes of findings of the quality gate that do not count as errors. `stage` is
    called with the name of each stage. `gate`: the result of the quality gate, if it has run already. Other options as in
    `refine`. BadInput if no parameter is identifiable, and for findings of the gate.
    """
    if gate is None:
        stage("quality")
        gate = passed(campaign, records, accept)
    if gate.logger is None:
        stage("logger")
        gate = as_logged(gate)
    fitted = _fitted_records(gate.campaign, gate.further)
    campaign = replace(campaign, steps=gate.campaign.steps)
    campaign = with_steady_points(campaign)
    model = model.sized(campaign.rig.scales)
    values = model.values()
    stage("static map and steps")
    static = static_fit(campaign, values)
    steps = fit_steps(campaign.steps, values, static and dict(static.coefficients)) if campaign.steps else None
    points = campaign.static
    if fitted and static is None and steps and steps.start:
        campaign = with_steady_points(campaign, slowest(values | steps.start, steps.start))
        static = static_fit(campaign, values)
    coefficients = dict(static.coefficients) if static else {}
    measured = coefficients | (steps.start if steps else {})
    if not fitted:
        return with_power(_without_record(campaign, model, measured, static, steps, gate))
    start = slow_first(AVERAGED) | measured
    prior = static and Prior(tuple(coefficients), np.array(list(coefficients.values())), static.covariance)
    stage("refine")
    found = refine(model, list(fitted.values()), start, prior=prior, method=method, starts=starts, seed=seed)
    stage("intervals")
    found = replace(found, uncertainty=profiled(found.problem, found.solution, found.uncertainty, found.others))
    validation = gate.campaign.validation
    shown = fitted | ({"validation": validation} if validation is not None else {})
    predictions = {name: predict(model, found.values, record) for name, record in shown.items()}
    rms = float(np.sqrt(2.0 * found.cost_final)) * found.values["thrust_scale"]
    first = predictions[next(iter(fitted))]
    noise = reading_noise([predictions[name] for name in fitted], points, found.values)
    source = {**_source(campaign), "record_seconds": float(first.record.time[-1]), "logger": gate.logger.summary()}
    quality = (*gate.findings, *of_fit(found, predictions, tuple(fitted), noise, campaign.rig))
    found = replace(found, solution=found.solution.slim())  # without arrays as long as the records
    uncertainty = with_steps(found.uncertainty, found.values, steps)
    known = dict(zip(uncertainty.names, uncertainty.std.tolist(), strict=True))
    lag_values = off_bounds(model, found.values, start, steps)
    rig = campaign.rig.timed(slowest(lag_values, uncertainty.names))
    source |= {"rig": rig.summary(), "sample_period": first.record.period}
    result = Identification(
        campaign=campaign,
        parameters=ParameterSet(model.sized(rig.scales), source=source).replaced(found.values, known),
        start=start,
        static=static,
        steps=steps,
        refinement=found,
        uncertainty=uncertainty,
        not_identifiable={n: why for n, why in found.held.items() if n not in known} | weakly_identified(uncertainty),
        fitted=tuple(fitted),
        predictions=predictions,
        bands={name: band(model, found.values, found.uncertainty, record, rms) for name, record in shown.items()},
        tests=residual_tests(first.record, first.record["thrust"] - first.thrust),
        noise=noise,
        quality=quality,
        logger=gate.logger,
    )
    return with_power(result)


def with_power(found: Identification) -> Identification:
    """Add torque and power to the plant if the campaign has them: from the steady points, else from the first fitted record.
    Contradictory readings become a finding, and nothing is added. Torque and power in a record alone do not identify a motor:
    then only the map of power is added."""
    scales, static = found.parameters.values, found.campaign.static
    first = found.predictions[found.fitted[0]] if found.fitted else None
    measured = [set(columns) for columns in (static and static.further, first and first.record.columns) if columns]
    if not any(names & {"torque", "power"} or names >= {"voltage", "current"} for names in measured):
        return found
    import identification.power.fit as power  # noqa: PLC0415 most campaigns measure no power

    try:
        readings = power.steady_readings(static, scales) if static else None
        if readings is None and first:
            readings = power.moving_readings(first, scales)
        if readings is None:
            return found
        if readings.rate is not None and readings.torque is not None and readings.power is not None:
            message = "torque and power in a record only: power has its map, torque and motor have none"
            finding = Finding("no_motor", readings.source, "torque", 0.0, "1", message, "no static.csv with both")
            readings, found = replace(readings, torque=None), replace(found, quality=(*found.quality, finding))
        fit, rotor = power.fit_power(readings), found.parameters.rig.rotor
        if rotor and static and readings.torque is not None and readings.rate is None:
            merit = power.figure_of_merit(readings, static.thrust, rotor)
            if merit > 1.0:
                words = f"{merit:.3g}: the rotor takes less power than an ideal one", "at most 1: torque in N.m, diameter in m"
                raise BadInput(static.source, "figure of merit", *words)
    except BadInput as bad:
        finding = Finding("power", bad.where, bad.field, 0.0, "1", f"{bad.found}, expected {bad.allowed}", "signs or units")
        return replace(found, quality=(*found.quality, finding))
    return replace(found, power=fit, parameters=fit.added_to(found.parameters))


def _without_record(
    campaign: Campaign,
    model: Model,
    measured: Mapping[str, float],
    static: StaticFit | None,
    steps: StepSummary | None,
    gate: Passed,
) -> Identification:
    """Identify from map and steps alone (`measured`, by name); the other parameters have the model's defaults."""
    values = model.values() | slow_first(model.values() | measured)
    result = unrefined(campaign, BASE_PARAMETERS, values, static, steps)
    known = dict(zip(result.uncertainty.names, result.uncertainty.std.tolist(), strict=True))
    rig = campaign.rig.timed(slowest(values, known))
    parameters = ParameterSet(model.sized(rig.scales), source={**_source(campaign), "rig": rig.summary()})
    return Identification(
        campaign=campaign,
        parameters=parameters.replaced(values, known),
        start=values,
        static=static,
        steps=steps,
        refinement=None,
        uncertainty=result.uncertainty,
        not_identifiable={**result.not_identifiable, **weakly_identified(result.uncertainty)},
        fitted=(),
        predictions={},
        bands={},
        tests=None,
        noise=reading_noise([predict(model, values, run) for run in campaign.steps], campaign.static, values),
        quality=gate.findings,
        logger=gate.logger,
    )


def _source(campaign: Campaign) -> dict[str, str]:
    return {"made_by": "vpp identify", "campaign": campaign.folder.name}


def off_bounds(
    model: Model, values: Mapping[str, float], start: Mapping[str, float], steps: StepSummary | None = None
) -> dict[str, float]:
    """The values, with lags that ended on a bound replaced by those of `start`: at a bound, a lag compensates a missing effect.
    The other lag of the channel is replaced, too, if the step responses identify it."""
    bounds = {p.name: (p.minimum, p.maximum) for p in model.parameters if p.name.startswith("tau_")}
    stuck = {n for n, ends in bounds.items() if any(isclose(values[n], end) for end in ends)}
    pairs = [{f"tau_{u}_1", f"tau_{u}_2"} for u in CHANNELS]
    doubtful = {n for pair in pairs if pair & stuck for n in pair & set(steps.start if steps else ())}
    return {**values, **{n: start[n] for n in stuck | doubtful}}


def _fitted_records(campaign: Campaign, more: Mapping[str, Record]) -> dict[str, Record]:
    """The records to fit by name, those of the campaign first; the validation record only if there is no other."""
    own = {"open_loop": campaign.open_loop, "repeat": campaign.repeat}
    found = {name: record for name, record in own.items() if record is not None} | dict(more)
    return found or ({"validation": campaign.validation} if campaign.validation is not None else {})
