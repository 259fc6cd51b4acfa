"""Identify the parameters of a campaign."""

from collections.abc import Callable, Iterable, Mapping
from typing import Any

from identification.fit.refine import METHODS
from identification.identify import identify as identified
from vpp_fmu.app.api.objects import PathLike, as_campaign, as_records
from vpp_fmu.app.report.pages.identification import IdentifyResult
from vpp_fmu.campaign import Campaign


def identify(
    campaign: PathLike | Campaign,
    records: Mapping[str, Any] | Iterable[PathLike] = (),
    method: str = METHODS[0],
    starts: int = 8,
    seed: int = 0,
    accept: Iterable[str] = (),
    stage: Callable[[str], None] = lambda text: None,
) -> IdentifyResult:
    """Identify the parameters: lags in s, coefficients of the map in normalised units, each with its standard deviation.

    `records`: further ones to fit: paths, or paths, Records and frames by name. `starts` of the search by `method`. `stage`
    receives the name of each stage. BadInput: data that the quality gate refuses, or no identifiable parameter.

    >>> found = vpp.identify(vpp.example_campaign(), starts=1)
    >>> found.parameters.values["tau_beta_1"] > found.parameters.values["tau_beta_2"]
    True
    >>> found.to_dict()["rmse_thrust"]["validation"] < 0.2
    True
    >>> found.save("out").name
    'out'
    """
    stage("read")
    named, whole = as_records(records), as_campaign(campaign)
    return IdentifyResult(identified(whole, method=method, starts=starts, seed=seed, records=named, accept=accept, stage=stage))
