"""A campaign becomes parameters, and a measure of how far to trust them."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from identification.bootstrap import Bootstrap, bootstrap
from identification.coordinates import CHANNELS
from identification.problem import Prior
from identification.quality import fit_percent, noise_floor, rmse
from identification.refine import Refinement, refine
from identification.residual_tests import NORMAL_95, ResidualTests, residual_tests
from identification.screening import screen
from identification.sections import sections
from identification.static_map import StaticFit, fit_static_map
from identification.step_response import StepSummary, fit_steps
from identification.uncertainty import Uncertainty
from vpp_fmu.campaign import Campaign
from vpp_fmu.errors import BadInput
from vpp_fmu.kernel.plant import AVERAGED, BASE
from vpp_fmu.kernel.types import Model
from vpp_fmu.native import Simulator
from vpp_fmu.parameters import ParameterSet
from vpp_fmu.record import Record


@dataclass(frozen=True)
class Prediction:
    """A record beside the model's open-loop response to its commands; `thrust` N, `omega` rpm, `beta` deg, each (rows,)."""

    record: Record
    thrust: np.ndarray
    omega: np.ndarray
    beta: np.ndarray

    @property
    def rmse_thrust(self) -> float:
        """N."""
        return rmse(self.thrust - self.record["thrust"])

    @property
    def rmse_omega(self) -> float | None:
        """rpm; None where no speed was measured."""
        return rmse(self.omega - self.record["omega"]) if "omega" in self.record else None

    def summary(self) -> dict:
        """The figures of CONTRACT.md's `identification.json` for this record, whole and by section."""
        measured = self.record["thrust"]
        by_section = {
            name: {
                "rmse_thrust": rmse((self.thrust - measured)[mask]),
                "fit_thrust": fit_percent(measured[mask], self.thrust[mask]),
            }
            for name, mask in sections(self.record).items()
        }
        return {
            "rmse_thrust": self.rmse_thrust,
            "rmse_omega": self.rmse_omega,
            "fit_thrust": fit_percent(measured, self.thrust),
            "sections": by_section,
        }


@dataclass(frozen=True)
class Identification:
    """What a campaign gave: parameters, how they were found, and predictions of every long record by name.

    `bands`: standard deviation of a predicted reading (rows,) N by record, of parameters and noise together. `tests`: of the
    thrust residual of the fitted record. `left_out`: in words, rows of it that were not trusted.
    `bootstrap` where it was asked for.
    """

    campaign: Campaign
    parameters: ParameterSet
    start: Mapping[str, float]
    static: StaticFit | None
    steps: StepSummary | None
    refinement: Refinement
    predictions: Mapping[str, Prediction]
    bands: Mapping[str, np.ndarray]
    tests: ResidualTests
    noise_floor: float | None
    left_out: tuple[str, ...]
    bootstrap: Bootstrap | None = None

    @property
    def coverage(self) -> dict[str, float]:
        """Share of a record's readings within the prediction's 95 % band, by record."""
        shares = {}
        for name, p in self.predictions.items():
            error = p.thrust - p.record["thrust"]
            seen = np.isfinite(error)
            shares[name] = float(np.mean(np.abs(error[seen]) <= NORMAL_95 * self.bands[name][seen]))
        return shares

    def summary(self) -> dict:
        """The content of `identification.json`."""
        r, doubt = self.refinement, self.refinement.uncertainty
        condition, weakest, spread = doubt.directions()
        fitted = {
            name: {"value": value, "std": std, "interval": interval}
            for name, value, std, interval in zip(
                doubt.names, doubt.values.tolist(), doubt.std.tolist(), doubt.intervals.tolist(), strict=True
            )
        }
        static = self.static
        return {
            "parameters": fitted,
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
            "time_constants": _forms(doubt),
            "bootstrap": self.bootstrap
            and {
                "samples": len(self.bootstrap.samples),
                "std": dict(zip(doubt.names, self.bootstrap.std.tolist(), strict=True)),
                "interval": dict(zip(doubt.names, self.bootstrap.intervals.tolist(), strict=True)),
            },
            "residual_tests": {"share_of_lags_outside_95_percent_band": self.tests.outside},
            "prediction_band_coverage": self.coverage,
            "starts": {"tried": r.starts, "reached_the_optimum": r.reached},
            "seconds": r.seconds,
            "noise_floor_thrust": self.noise_floor,
            "records": {name: p.summary() for name, p in self.predictions.items()},
            "rmse_thrust": {name: p.rmse_thrust for name, p in self.predictions.items()},
            "rmse_omega": {name: p.rmse_omega for name, p in self.predictions.items()},
            "fit_thrust": {name: p.summary()["fit_thrust"] for name, p in self.predictions.items()},
            "steps": self.steps and self.steps.summary(),
            "static_map": static
            and {
                "coefficients": dict(static.coefficients),
                "std": static.std,
                "r2_adjusted": static.r2_adjusted,
                "rmse": static.rmse,
                "points": int(static.used.sum()),
            },
            "missing": list(self.campaign.missing),
            "left_out": list(self.left_out),
        }


def predict(model: Model, values: Mapping[str, float], record: Record) -> Prediction:
    """The model's open-loop response to a record's commands."""
    outputs = Simulator(model).simulate(values, record.columns, record.steps)
    return Prediction(record, *outputs.T)


def identify(
    campaign: Campaign,
    model: Model = BASE,
    method: str = "levenberg-marquardt",
    starts: int = 8,
    seed: int = 0,
    resamples: int = 0,
    workers: int = 1,
    scheduler: str | None = None,
) -> Identification:
    """Static map by least squares, lags by step responses, then all parameters on the open-loop record, the map as prior.

    What is missing of the campaign is left out, down to the open-loop record: BadInput without that. `resamples`: of the
    block bootstrap, on `workers` processes or a Dask `scheduler`. Other options as in `refine`.
    """
    if campaign.open_loop is None:
        raise BadInput(campaign.folder, "open_loop.csv", "no such file", "a record with time, omega_ref, beta_ref, thrust")
    screened = screen(campaign.open_loop)
    values = model.values()
    static = fit_static_map(campaign.static, values) if campaign.static is not None else None
    coefficients = dict(static.coefficients) if static else {}
    steps = fit_steps(campaign.steps, values, coefficients or None) if campaign.steps else None
    start = _slow_first(AVERAGED) | coefficients | (dict(steps.start) if steps else {})
    prior = static and Prior(tuple(coefficients), np.array(list(coefficients.values())), static.covariance)
    found = refine(model, [screened.record], start, prior=prior, method=method, starts=starts, seed=seed)
    records = {name: getattr(campaign, name) for name in ("open_loop", "validation") if getattr(campaign, name) is not None}
    predictions = {name: predict(model, found.values, record) for name, record in records.items()}
    fitted = predictions["open_loop"]
    source = {"made_by": "vpp identify", "campaign": campaign.folder.name, "record_seconds": float(campaign.open_loop.time[-1])}
    return Identification(
        campaign=campaign,
        parameters=ParameterSet(model, source=source).replaced(found.values, found.std),
        start=start,
        static=static,
        steps=steps,
        refinement=found,
        predictions=predictions,
        bands={name: _band(model, found, record, fitted.rmse_thrust) for name, record in records.items()},
        tests=residual_tests(campaign.open_loop, campaign.open_loop["thrust"] - fitted.thrust),
        noise_floor=noise_floor(campaign.open_loop, campaign.repeat) if campaign.repeat is not None else None,
        left_out=screened.notes,
        bootstrap=bootstrap(found, resamples, seed, workers, scheduler) if resamples else None,
    )


def _band(model: Model, found: Refinement, record: Record, noise: float) -> np.ndarray:
    """Standard deviation (rows,) N of a predicted reading: what the parameters leave open, and what the fit left."""
    doubt = found.uncertainty
    _, tangents = Simulator(model, doubt.names).sensitivities(found.values, record.columns, record.steps)
    return np.sqrt(np.einsum("ij,jk,ik->i", tangents[:, 0], doubt.covariance, tangents[:, 0]) + noise**2)


def _forms(doubt: Uncertainty) -> dict:
    """Each channel's time constants in the forms that the data tell best: sorted, their sum, their product."""
    forms = {}
    for channel in CHANNELS:
        pair = [f"tau_{channel}_1", f"tau_{channel}_2"]
        if not set(pair) <= set(doubt.names):
            continue
        at = [doubt.names.index(n) for n in pair]
        a, b = doubt.values[at]
        gradients = {"sum": (a + b, (1.0, 1.0)), "product": (a * b, (b, a))}
        forms[channel] = {"sorted": sorted((float(a), float(b)), reverse=True)}
        for form, (value, slopes) in gradients.items():
            gradient = np.zeros(len(doubt.names))
            gradient[at] = slopes
            forms[channel][form] = {"value": float(value), "std": doubt.of(gradient)}
    return forms


def _slow_first(values: Mapping[str, float]) -> dict[str, float]:
    """Each channel's time constants sorted, the slower first: the response tells no order, so one is agreed on."""
    values = dict(values)
    for channel in CHANNELS:
        pair = f"tau_{channel}_1", f"tau_{channel}_2"
        values.update(zip(pair, sorted((values[n] for n in pair), reverse=True), strict=True))
    return values
