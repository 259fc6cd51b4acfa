"""A campaign becomes parameters, and a measure of how far to trust them."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from identification.coordinates import CHANNELS
from identification.problem import Prior
from identification.quality import fit_percent, noise_floor, rmse
from identification.refine import Refinement, refine
from identification.sections import sections
from identification.static_map import StaticFit, fit_static_map
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
    """What a campaign gave: parameters, how they were found, and predictions of every long record by name."""

    campaign: Campaign
    parameters: ParameterSet
    start: Mapping[str, float]
    static: StaticFit | None
    refinement: Refinement
    predictions: Mapping[str, Prediction]
    noise_floor: float | None

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
            "starts": {"tried": r.starts, "reached_the_optimum": r.reached},
            "seconds": r.seconds,
            "noise_floor_thrust": self.noise_floor,
            "records": {name: p.summary() for name, p in self.predictions.items()},
            "static_map": static
            and {
                "coefficients": dict(static.coefficients),
                "std": static.std,
                "r2_adjusted": static.r2_adjusted,
                "rmse": static.rmse,
                "points": int(static.used.sum()),
            },
            "missing": list(self.campaign.missing),
        }


def predict(model: Model, values: Mapping[str, float], record: Record) -> Prediction:
    """The model's open-loop response to a record's commands."""
    outputs = Simulator(model).simulate(values, record.columns, record.steps)
    return Prediction(record, *outputs.T)


def identify(
    campaign: Campaign, model: Model = BASE, method: str = "levenberg-marquardt", starts: int = 8, seed: int = 0
) -> Identification:
    """Static map by least squares where there is one, then all parameters on the open-loop record, the map as prior.

    BadInput where the campaign has no `open_loop.csv`. Options as in `refine`.
    """
    if campaign.open_loop is None:
        raise BadInput(campaign.folder, "open_loop.csv", "no such file", "a record with time, omega_ref, beta_ref, thrust")
    static = fit_static_map(campaign.static, model.values()) if campaign.static is not None else None
    start = _slow_first(AVERAGED) | (dict(static.coefficients) if static else {})
    prior = static and Prior(tuple(static.coefficients), np.array(list(static.coefficients.values())), static.covariance)
    found = refine(model, [campaign.open_loop], start, prior=prior, method=method, starts=starts, seed=seed)
    source = {"made_by": "vpp identify", "campaign": campaign.folder.name, "record_seconds": float(campaign.open_loop.time[-1])}
    parameters = ParameterSet(model, source=source).replaced(found.values, found.std)
    records = {name: getattr(campaign, name) for name in ("open_loop", "validation") if getattr(campaign, name) is not None}
    floor = noise_floor(campaign.open_loop, campaign.repeat) if campaign.repeat is not None else None
    predictions = {name: predict(model, found.values, record) for name, record in records.items()}
    return Identification(campaign, parameters, start, static, found, predictions, floor)


def _slow_first(values: Mapping[str, float]) -> dict[str, float]:
    """Each channel's time constants sorted, the slower first: the response tells no order, so one is agreed on."""
    values = dict(values)
    for channel in CHANNELS:
        pair = f"tau_{channel}_1", f"tau_{channel}_2"
        values.update(zip(pair, sorted((values[n] for n in pair), reverse=True), strict=True))
    return values
