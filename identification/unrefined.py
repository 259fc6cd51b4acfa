"""Estimates of a campaign without a record to fit: the map from steady points, the lags from step responses.

The two are estimated independently: the joint covariance is block diagonal.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from identification.fit.coordinates import CHANNELS
from identification.fit.uncertainty import NORMAL_95, Uncertainty
from identification.static.static_map import TERMS, StaticFit
from identification.steps.response import StepSummary, pair
from vpp_fmu.campaign import Campaign
from vpp_fmu.digits import with_uncertainty
from vpp_fmu.errors import BadInput

WORDS = {"omega": "speed", "beta": "pitch"}


@dataclass(frozen=True)
class Unrefined:
    """`uncertainty` of the identifiable parameters; `not_identifiable`: the reason for each other one, by name."""

    uncertainty: Uncertainty
    not_identifiable: Mapping[str, str]


def unrefined(
    campaign: Campaign, names: Sequence[str], values: Mapping[str, float], static: StaticFit | None, steps: StepSummary | None
) -> Unrefined:
    """Uncertainty of the parameters `names` at their `values`. BadInput if the campaign identifies none of them."""
    why = _unidentified_lags(steps) | _unidentified_coefficients(static)
    identified = tuple(name for name in names if name not in why)
    if not identified:
        reasons = "; ".join(dict.fromkeys(why.values()))
        raise BadInput(campaign.folder, "campaign", f"no identifiable parameter ({reasons})", _SUFFICIENT)
    covariance = np.zeros((len(identified), len(identified)))
    parts = [(pair(u), np.array(a.covariance)) for u, a in (steps.lags if steps else {}).items()]
    parts += [] if static is None else [(tuple(static.coefficients), static.covariance)]
    for own, known in parts:
        kept = [k for k, name in enumerate(own) if name in identified]
        at = [identified.index(own[k]) for k in kept]
        covariance[np.ix_(at, at)] = known[np.ix_(kept, kept)]
    found = Uncertainty(identified, np.array([values[n] for n in identified]), covariance, np.ones(len(identified)))
    return Unrefined(found, {n: why[n] for n in names if n in why})


def with_steps(fitted: Uncertainty, values: Mapping[str, float], steps: StepSummary | None) -> Uncertainty:
    """A fit's uncertainty, extended by the lags of step responses whose command no record moves."""
    unidentified = _unidentified_lags(steps)
    added = {pair(u): a for u, a in (steps.lags if steps else {}).items() if not {*fitted.names, *unidentified} & {*pair(u)}}
    for own, average in added.items():
        names, kept = (*fitted.names, *own), len(fitted.names)
        covariance = np.zeros((len(names), len(names)))
        covariance[:kept, :kept], covariance[kept:, kept:] = fitted.covariance, np.array(average.covariance)
        reach = NORMAL_95 * np.sqrt(np.diag(covariance)[kept:])
        fitted = replace(
            fitted,
            names=names,
            values=np.append(fitted.values, [values[n] for n in own]),
            covariance=covariance,
            inflation=np.append(fitted.inflation, np.ones(len(own))),
            reach=None if fitted.reach is None else np.vstack([fitted.reach, np.column_stack([reach, reach])]),
        )
    return fitted


_SUFFICIENT = "a record with time, omega_ref, beta_ref, thrust; or steady points; or steps"


def _unidentified_lags(steps: StepSummary | None) -> dict[str, str]:
    why = {}
    for channel in CHANNELS:
        average = steps.lags.get(channel) if steps else None
        if average is None:
            why |= dict.fromkeys(pair(channel), _no_lag(steps, channel))
        elif not average.apart:
            total = with_uncertainty(average.slow + average.fast, NORMAL_95 * average.std["sum"], "s")
            why |= dict.fromkeys(pair(channel), f"the steps identify only the sum of both lags, {total}")
    return why


def _no_lag(steps: StepSummary | None, channel: str) -> str:
    word = WORDS[channel]
    runs = [run for run in steps.runs if run.channel == channel] if steps else []
    if runs:
        return f"no record to fit, and none of {len(runs)} steps of the {word} is usable ({runs[0].reason})"
    if steps and not steps.runs and steps.unreadable:
        return f"no record to fit, and no usable step response ({next(iter(steps.unreadable.values()))})"
    return f"no record to fit, and no step of the {word}"


def _unidentified_coefficients(static: StaticFit | None) -> dict[str, str]:
    if static is None:
        return dict.fromkeys(TERMS, "no record to fit, and no steady points")
    return dict.fromkeys(
        static.not_identifiable, f"the {static.used.sum()} steady points identify only its combinations with others"
    )
