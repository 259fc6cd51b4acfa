"""The controllers of a rig: limits, sampling period, and initial gains of a search.

Gains are normalised by thrust, speed and pitch, so published ones apply to any rig after time scaling. A loop with parts that
are all r times as slow has the same response, r times as slow, with

    kp,   ki / r,   kd r,   t_filter r

r of a channel is the ratio of its sum of lags to that of the paper's rig. Rigs about as fast as the paper's keep the published
gains.
"""

from collections.abc import Mapping
from dataclasses import dataclass

from vpp_fmu.errors import BadInput
from vpp_fmu.kernel.controller import CONTROLLER, DUAL, SPEED_ONLY, speed_alone
from vpp_fmu.kernel.effects.dual_pid import ALLOCATED, PAIRS
from vpp_fmu.kernel.plant import FINE_TUNED
from vpp_fmu.kernel.scales import PAPER
from vpp_fmu.parameters import ParameterSet
from vpp_fmu.rig import ASSUMED, PAPERS_SIZE, Rig, rounded

CHANNELS = {"omega": "speed", "beta": "pitch"}
"""The rig's quantity that each channel commands."""

POWERS = {"kp_": 0.0, "ki_": -1.0, "kd_": 1.0}
"""Power of r in each gain."""

DESIGNED = {
    "omega": FINE_TUNED["tau_omega_1"] + FINE_TUNED["tau_omega_2"],
    "beta": FINE_TUNED["tau_beta_1"] + 0.05,
}
"""Sums of lags, s, for which the published gains were designed; for pitch, with the faster actuator of the paper."""

FEWEST, MOST = 10.0, 200.0
"""Samples per sum of lags of the faster channel, least and most. A rise time should have 4 to 10 (Astrom and Wittenmark,
Computer-Controlled Systems), and a well-tuned loop is about as fast as its plant. More than the most only cost time."""


@dataclass(frozen=True)
class Controllers:
    """`settings`: all values of each possible controller, "dual" and "speed_only"; `left_out`: reasons against the others.

    `reference`: name of the initial gains; `scaled`: whether these are the published ones, scaled in time.
    """

    settings: Mapping[str, Mapping[str, float]]
    left_out: Mapping[str, str]
    reference: str
    scaled: bool


def controllers(
    parameters: ParameterSet,
    given: ParameterSet | None = None,
    sample_time: float | None = None,
    source: str = "given gains",
    rig: Rig | None = None,
) -> Controllers:
    """The controllers for the rig and the plant of `parameters`.

    `given`: a controller's own values instead, within the rig's range; scales are always the plant's. `sample_time` s: None for
    the given one, else the campaign's row period, or what the plant needs. `rig`: other ranges than those of the parameters'
    rig. BadInput names `source` if given limits exceed the rig's.
    """
    rig, plant = rig or parameters.rig, parameters.values
    moved = {u: low < high for u, (low, high) in zip(CHANNELS, (rig.speed, rig.pitch), strict=True)}
    if not any(moved.values()):
        text = f"speed fixed at {rig.speed[0]:g} rpm and pitch at {rig.pitch[0]:g} deg"
        raise BadInput("the rig", "speed, pitch", text, "a range of one of them, which a controller can use")
    lags = {u: plant[f"tau_{u}_1"] + plant[f"tau_{u}_2"] for u in CHANNELS if moved[u]}
    slower = {u: lag / DESIGNED[u] for u, lag in lags.items()}
    if all(1.0 / PAPERS_SIZE <= r <= PAPERS_SIZE for r in slower.values()):
        slower = {}
    own = _of_the_rig(rig, slower, min(lags.values()), parameters.sample_period)
    own |= {name: value for name, value in plant.items() if name in own}  # the scales
    imposed = {name: value for name, value in _given(given, rig, source).items() if name not in plant} if given else {}
    imposed |= {} if sample_time is None else {"sample_time": sample_time}
    settings, left_out = {}, {}
    if moved["beta"]:
        settings["dual"] = {**own, **_scaled(_gains(DUAL), slower), **imposed, "speed_only": 0.0}
    else:
        left_out["dual"] = f"the rig's pitch is fixed at {rig.pitch[0]:g} deg"
    if moved["omega"]:
        gains = _gains(SPEED_ONLY)
        # Gains for two actuators do not apply to speed alone, which keeps the published ones.
        kept = imposed if imposed.get("speed_only") else {name: value for name, value in imposed.items() if name not in gains}
        settings["speed_only"] = {**own, **_scaled(gains, slower), **kept, "speed_only": 1.0}
    else:
        left_out["speed_only"] = f"the rig's speed is fixed at {rig.speed[0]:g} rpm"
    scaled = bool(slower) and given is None
    return Controllers(settings, left_out, "given" if given else "scaled" if scaled else "published", scaled)


def rig_controller(
    parameters: ParameterSet,
    given: ParameterSet | None = None,
    source: str = "given gains",
    rig: Rig | None = None,
    sample_time: float | None = None,
) -> ParameterSet:
    """The controller for the rig of `parameters`, with all its values: the given one, else the dual, else the only one that is
    possible on the rig. Arguments and BadInput as of `controllers`. If no rig is known, it is the paper's controller with the
    published gains."""
    papers = ParameterSet(CONTROLLER, source={"made_by": "the published gains"})
    published = given is None and "rig" not in parameters.source and parameters.rig.scales == PAPER
    if published and rig is None:
        return papers
    kept = papers.replaced({**DUAL, "t_filter": papers.values["t_filter"]}) if published else given
    own = controllers(parameters, kept, sample_time, source, rig)
    alone = given is not None and speed_alone(given.values)
    name = "speed_only" if alone else "dual"
    if name not in own.settings:
        if given is not None:
            allowed = f"a controller that the rig can have: {own.left_out[name]}"
            raise BadInput(source, "parameters, speed_only", "1" if alone else "0", allowed)
        (name,) = own.settings
    rig = rig or parameters.rig
    model = CONTROLLER if parameters.rig.scales == PAPER else CONTROLLER.sized(parameters.rig.scales)
    made = "the published gains" + (" at the rig's pace" if own.scaled else "")
    came = given.source if given is not None else {"made_by": made}
    return ParameterSet(model, source={**came, "rig": rig.summary()}).replaced(own.settings[name])


def said_of(controller: ParameterSet, gains: str | None = None) -> str:
    """Describe a controller and the sources of its values in one line. `gains`: the file that its gains come from."""
    v, rig = controller.values, controller.rig
    spans = ((v["omega_min"], v["omega_max"], "rpm"), (v["beta_min"], v["beta_max"], "deg"))
    limits = ", ".join(f"{low:.6g} to {high:.6g} {unit}" if low < high else f"{low:.6g} {unit}" for low, high, unit in spans)
    default = f"{'the paper' if rig.scales == PAPER else 'the model'}'s by default: no rig is known"
    where = ", ".join(dict.fromkeys(rig.origin.get(name, default) for name in ("speed", "pitch")))
    made = f"gains of {gains}" if gains else str(controller.source["made_by"])
    both = "best pairs of speed and pitch" if v.get("mode") == ALLOCATED else "speed and pitch"
    which = "speed alone" if speed_alone(v) else both
    return f"controller: {which} within {limits} ({where}), sampled every {1e3 * v['sample_time']:.4g} ms; {made}"


def _of_the_rig(rig: Rig, slower: Mapping[str, float], lag: float, period: float | None) -> dict[str, float]:
    """All values of a controller except its gains: limits, sampling and filter for a plant whose faster channel has the sum of
    lags `lag` [s], on a rig that was sampled every `period` [s]."""
    own = CONTROLLER.sized(rig.scales).values()
    own |= {f"omega_{end}": value for end, value in zip(("min", "max"), rig.speed, strict=True)}
    own |= {f"beta_{end}": value for end, value in zip(("min", "max"), rig.pitch, strict=True)}
    # A default table without a power model: the greatest pitch, and speed by the square law of thrust, within the limits.
    for k in range(PAIRS):
        own[f"pair_omega_{k}"] = max(rig.speed[0], rig.speed[1] * (k / (PAIRS - 1)) ** 0.5)
        own[f"pair_beta_{k}"] = rig.pitch[1]
    filter_time = own["t_filter"] * min(slower.values(), default=1.0)
    return own | {
        "beta_fixed": rig.pitch[1],
        "sample_time": sampling(lag, period or own["sample_time"]),
        "t_filter": filter_time,
    }


def sampling(lag: float, usual: float) -> float:
    """Sampling period [s] for a plant whose faster channel has the sum of lags `lag` [s]: the `usual` one, or the nearest round
    number with FEWEST to MOST samples per lag."""
    shortest, longest = lag / MOST, lag / FEWEST
    return usual if shortest <= usual <= longest else rounded(shortest if usual < shortest else longest)


def _gains(named: Mapping[str, float]) -> dict[str, float]:
    return {name: value for name, value in named.items() if name[:3] in POWERS}


def _scaled(gains: Mapping[str, float], slower: Mapping[str, float]) -> dict[str, float]:
    """Scale gains by the factors `slower` of their channels; a channel without a factor is unchanged."""
    return {name: gain * slower.get(name[3:], 1.0) ** POWERS[name[:3]] for name, gain in gains.items()}


def _given(given: ParameterSet, rig: Rig, source: str) -> dict[str, float]:
    """The values of a controller's file; BadInput if its limits exceed the rig's range."""
    found = {name: estimate.value for name, estimate in given.estimates.items()}
    units = {p.name: p.unit for p in given.model.parameters}
    for channel, range_of in CHANNELS.items():
        low, high = getattr(rig, range_of)
        pairs = (f"pair_{channel}_{k}" for k in range(PAIRS))
        for name in (f"{channel}_min", f"{channel}_max", f"{channel}_fixed", *pairs):
            if name in found and not low <= found[name] <= high:
                allowed = f"{low:g} to {high:g} {units[name]} ({rig.origin.get(range_of, ASSUMED)})"
                raise BadInput(source, f"parameters, {name}", f"{found[name]:g} {units[name]}", allowed)
    return found
