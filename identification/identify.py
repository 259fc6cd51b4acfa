"""A campaign becomes parameters, and a measure of how far to trust them."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from identification.fit.coordinates import CHANNELS
from identification.fit.problem import Prior
from identification.fit.refine import Refinement, refine
from identification.gate.finding import Finding
from identification.gate.fitted import of_fit
from identification.gate.gate import passed
from identification.static.static_map import StaticFit, static_fit
from identification.static.steady import steady_points
from identification.steps.response import StepSummary, fit_steps
from identification.worth.bootstrap import Bootstrap, bootstrap
from identification.worth.pairs import forms, slow_first
from identification.worth.prediction import Prediction, band, predict
from identification.worth.profile import profiled
from identification.worth.quality import noise_floor
from identification.worth.residual_tests import ResidualTests, residual_tests
from vpp_fmu.campaign import Campaign
from vpp_fmu.errors import BadInput
from vpp_fmu.kernel.plant import AVERAGED, BASE
from vpp_fmu.kernel.types import Model
from vpp_fmu.parameters import ParameterSet
from vpp_fmu.record import Record


@dataclass(frozen=True)
class Identification:
    """What a campaign gave: parameters, how they were found, and predictions of every long record by name.

    `fitted`: names of the records that the parameters were fitted to; the other predictions are of records that no fit has
    seen. `bands`: standard deviation of a predicted reading (rows,) N by record, of parameters and noise together. `tests`: of
    the thrust residual of the first fitted record. `quality`: what the gate found in the files and in the fit. `bootstrap`
    where it was asked for.
    """

    campaign: Campaign
    parameters: ParameterSet
    start: Mapping[str, float]
    static: StaticFit | None
    steps: StepSummary | None
    refinement: Refinement
    fitted: tuple[str, ...]
    predictions: Mapping[str, Prediction]
    bands: Mapping[str, np.ndarray]
    tests: ResidualTests
    noise_floor: float | None
    quality: tuple[Finding, ...]
    bootstrap: Bootstrap | None = None

    @property
    def coverage(self) -> dict[str, float]:
        """Share of a record's readings within the prediction's 95 % band, by record."""
        return {name: p.within(self.bands[name]) for name, p in self.predictions.items()}

    def summary(self) -> dict:
        """The content of `identification.json`."""
        r, doubt = self.refinement, self.refinement.uncertainty
        condition, weakest, spread = doubt.directions()
        entries = zip(doubt.names, doubt.values.tolist(), doubt.std.tolist(), doubt.intervals.tolist(), strict=True)
        static = self.static
        return {
            "effects": list(self.parameters.model.optional),
            "parameters": {
                name: {"value": value, "std": std, "interval": interval, "interval_from": doubt.kind(name)}
                for name, value, std, interval in entries
            },
            "correlation": {"names": list(doubt.names), "matrix": doubt.correlation.tolist()},
            "condition_number": condition,
            "weakest_direction": dict(zip(doubt.names, weakest.tolist(), strict=True)) | {"relative_std": spread},
            "inflation_by_coloured_residuals": dict(zip(doubt.names, doubt.inflation.tolist(), strict=True)),
            "not_identifiable": dict(r.held),
            "method": r.method,
            "cost_start": r.cost_start,
            "cost_final": r.cost_final,
            "iterations": len(r.curve) - 1,
            "evaluations": r.evaluations,
            "time_constants": forms(doubt),
            "bootstrap": self.bootstrap and self.bootstrap.summary(),
            "residual_tests": {"share_of_lags_outside_95_percent_band": self.tests.outside},
            "prediction_band_coverage": self.coverage,
            "starts": {"tried": r.starts, "reached_the_optimum": r.reached},
            "seconds": r.seconds,
            "noise_floor_thrust": self.noise_floor,
            "fitted": list(self.fitted),
            "records": {name: p.summary() for name, p in self.predictions.items()},
            "rmse_thrust": {name: p.rmse_thrust for name, p in self.predictions.items()},
            "rmse_omega": {name: p.rmse_omega for name, p in self.predictions.items()},
            "fit_thrust": {name: p.fit_thrust for name, p in self.predictions.items()},
            "steps": self.steps and self.steps.summary(),
            "static_map": static and static.summary(),
            "missing": list(self.campaign.missing),
            "quality": [finding.summary() for finding in self.quality],
        }


def identify(
    campaign: Campaign,
    model: Model = BASE,
    method: str = "levenberg-marquardt",
    starts: int = 8,
    seed: int = 0,
    resamples: int = 0,
    workers: int = 1,
    scheduler: str | None = None,
    records: Mapping[str, Record] | None = None,
    accept: Iterable[str] = (),
    stage: Callable[[str], None] = lambda text: None,
) -> Identification:
    """Static map by least squares, lags by step responses, then all parameters on the fitted records, the map as prior.

    Fitted are the campaign's open-loop record, its repeat, and further `records` by name, all together. What is missing of the
    campaign is left out, down to one record to fit: BadInput without any. Without means of steady points these are taken from
    their raw samples. `resamples`: of the block bootstrap, on `workers` processes or a Dask `scheduler`. What the quality gate
    finds wrong is BadInput, too, but for the codes that `accept` names. `stage` is told what begins. Other options as in
    `refine`.
    """
    stage("quality")
    shown = _to_fit(campaign, records or {})
    gate = passed(campaign, records, accept)
    fitted = _to_fit(gate.campaign, gate.further)
    if campaign.static is None and campaign.static_raw is not None:
        campaign = replace(campaign, static=steady_points(campaign.static_raw))
    model = model.sized(campaign.rig.scales)
    values = model.values()
    stage("static map and steps")
    static = static_fit(campaign, values)
    coefficients = dict(static.coefficients) if static else {}
    steps = fit_steps(campaign.steps, values, coefficients or None) if campaign.steps else None
    start = slow_first(AVERAGED) | coefficients | (dict(steps.start) if steps else {})
    prior = static and Prior(tuple(coefficients), np.array(list(coefficients.values())), static.covariance)
    stage("refine")
    found = refine(model, list(fitted.values()), start, prior=prior, method=method, starts=starts, seed=seed)
    stage("intervals")
    found = replace(found, uncertainty=profiled(found.problem, found.solution, found.uncertainty))
    shown |= {"validation": campaign.validation} if campaign.validation is not None else {}
    predictions = {name: predict(model, found.values, record) for name, record in shown.items()}
    left = float(np.sqrt(2.0 * found.cost_final)) * found.values["thrust_scale"]
    first = predictions[next(iter(fitted))]
    noise = noise_floor(campaign.open_loop, campaign.repeat) if {"open_loop", "repeat"} <= set(fitted) else None
    rig = campaign.rig.timed(slowest(found.values, found.names))
    source = {"made_by": "vpp identify", "campaign": campaign.folder.name, "record_seconds": float(first.record.time[-1])}
    source |= {"rig": rig.summary(), "sample_period": first.record.period}
    return Identification(
        campaign=campaign,
        parameters=ParameterSet(model.sized(rig.scales), source=source).replaced(found.values, found.std),
        start=start,
        static=static,
        steps=steps,
        refinement=found,
        fitted=tuple(fitted),
        predictions=predictions,
        bands={name: band(model, found.values, found.uncertainty, record, left) for name, record in shown.items()},
        tests=residual_tests(first.record, first.record["thrust"] - first.thrust),
        noise_floor=noise,
        quality=(*gate.findings, *of_fit(found, predictions, tuple(fitted), noise or _steady_noise(campaign), campaign.rig)),
        bootstrap=bootstrap(found, resamples, seed, workers, scheduler) if resamples else None,
    )


def slowest(values: Mapping[str, float], known: Iterable[str]) -> float:
    """s: the sum of the lags of the channel that takes longest, of those whose lags are `known`; of both where none is."""
    sums = {u: values[f"tau_{u}_1"] + values[f"tau_{u}_2"] for u in CHANNELS}
    told = [total for u, total in sums.items() if f"tau_{u}_1" in set(known)]
    return max(told or sums.values())


def _steady_noise(campaign: Campaign) -> float | None:
    """N: the usual spread of single readings at the steady points."""
    return None if campaign.static is None else float(np.median(campaign.static.thrust_std))


def _to_fit(campaign: Campaign, more: Mapping[str, Record]) -> dict[str, Record]:
    """The records to fit by name, those of the campaign first."""
    own = {"open_loop": campaign.open_loop, "repeat": campaign.repeat}
    found = {name: record for name, record in own.items() if record is not None} | dict(more)
    if not found:
        raise BadInput(campaign.folder, "open_loop.csv", "no such file", "a record with time, omega_ref, beta_ref, thrust")
    return found
