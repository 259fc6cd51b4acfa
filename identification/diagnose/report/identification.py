"""The identification.json of a model that a diagnosis fitted, with the same content as that of `vpp identify`."""

from identification.assessment.model_error import model_error
from identification.diagnose.diagnose import Diagnosis
from identification.diagnose.search.fits import Fit
from identification.fit.uncertainty import NORMAL_95


def identification_of(found: Diagnosis, fit: Fit) -> dict:
    """Values and names are those of `found.parameters(fit)`.

    If the campaign was identified first, the results of the static map and the steps are included.
    """
    uncertainty = fit.uncertainty.renamed(found.renamed(fit))
    first = found.identification.summary() if found.identification is not None else {}
    condition, weakest, spread = uncertainty.directions()
    records = {one.name: one.record for one in found.fitted}
    records |= {found.unseen.name: found.unseen.record} if found.unseen is not None else {}
    shown = {name: found.prediction(fit, record) for name, record in records.items()}
    unseen = [shown[found.unseen.name]] if found.unseen is not None else []
    fitted = [shown[one.name] for one in found.fitted if one.name != "repeat"]
    values = found.parameters(fit).values
    error = model_error(fitted, unseen, values, len(uncertainty.names), found.noise.floor)
    rows = zip(
        uncertainty.names, uncertainty.values.tolist(), uncertainty.std.tolist(), uncertainty.intervals.tolist(), strict=True
    )
    parameters = {
        name: {"value": value, "std": std, "interval": interval, "interval_from": uncertainty.kind(name)}
        for name, value, std, interval in rows
        if name not in uncertainty.left_open
    }
    for name, (low, high) in fit.thresholds.items():
        entry = {"value": fit.values[name], "std": (high - low) / (2.0 * NORMAL_95), "interval": [low, high]}
        parameters[name] = entry | {"interval_from": "scan"}
    return {
        "made_by": "vpp diagnose",
        "effects": list(found.parameters(fit).model.optional),
        "parameters": parameters,
        "correlation": {"names": list(uncertainty.names), "matrix": uncertainty.correlation.tolist()},
        "condition_number": condition,
        "weakest_direction": dict(zip(uncertainty.names, weakest.tolist(), strict=True)) | {"relative_std": spread},
        "inflation_by_coloured_residuals": dict(zip(uncertainty.names, uncertainty.inflation.tolist(), strict=True)),
        "not_identifiable": dict.fromkeys(uncertainty.left_open, "not identifiable from the records"),
        **found.reading_noise.summary(),
        "model_error": error and error.summary(),
        "fitted": [one.name for one in found.fitted],
        "records": {name: p.summary() for name, p in shown.items()},
        "rmse_thrust": {name: p.rmse_thrust for name, p in shown.items()},
        "rmse_omega": {name: p.rmse_omega for name, p in shown.items()},
        "fit_thrust": {name: p.fit_thrust for name, p in shown.items()},
        "missing": list(found.campaign.missing),
        **{name: first[name] for name in ("static_map", "steps") if name in first},
    }
