"""The controllers of a rig: its limits, a sampling that it needs, and the gains that a search starts from.

Gains are normalised, so published ones stand for a rig of any thrust, speed and pitch; only time remains. A loop that is r
times as slow in all its parts behaves the same, r times as slow, with

    kp,   ki / r,   kd r,   t_filter r

and r is taken for each channel from the sum of its lags. Rigs about as fast as the paper's keep the published gains.
"""

from collections.abc import Mapping
from dataclasses import dataclass

from vpp_fmu.errors import BadInput
from vpp_fmu.kernel.controller import CONTROLLER, DUAL, SPEED_ONLY
from vpp_fmu.kernel.plant import FINE_TUNED
from vpp_fmu.parameters import ParameterSet
from vpp_fmu.rig import PAPERS_SIZE, rounded

CHANNELS = {"omega": "speed", "beta": "pitch"}
"""What each channel moves."""

DESIGNED = {
    "omega": FINE_TUNED["tau_omega_1"] + FINE_TUNED["tau_omega_2"],
    "beta": FINE_TUNED["tau_beta_1"] + 0.05,
}
"""s: the sums of lags that the published gains were designed for; of pitch with the faster actuator that the paper assumes."""

FEWEST, MOST = 10.0, 200.0
"""Samples in the faster channel's lags. Textbooks want 4 to 10 in a rise time (Astrom and Wittenmark, Computer-Controlled
Systems), and a well tuned loop rises about as fast as its plant; more than the second number only cost time."""


@dataclass(frozen=True)
class Controllers:
    """`settings`: all values of each controller that the rig can have, "dual" and "speed_only"; `left_out`: why not the others.

    `reference`: what the gains that they start from are called.
    """

    settings: Mapping[str, Mapping[str, float]]
    left_out: Mapping[str, str]
    reference: str


def controllers(
    parameters: ParameterSet, given: ParameterSet | None = None, sample_time: float | None = None, source: str = "given gains"
) -> Controllers:
    """The controllers for the rig and the plant of `parameters`.

    `given`: a controller's own values instead, within the rig's range (BadInput); scales are always the plant's.
    `sample_time` s: None for the given one, else what the rig needs. `source`: where the given ones are from, for the error.
    """
    rig, plant = parameters.rig, parameters.values
    moved = {u: low < high for u, (low, high) in zip(CHANNELS, (rig.speed, rig.pitch), strict=True)}
    if not any(moved.values()):
        text = f"speed fixed at {rig.speed[0]:g} rpm and pitch at {rig.pitch[0]:g} deg"
        raise BadInput("the rig", "speed, pitch", text, "a range of one of them, for a controller to move in")
    lags = {u: plant[f"tau_{u}_1"] + plant[f"tau_{u}_2"] for u in CHANNELS if moved[u]}
    slower = {u: lag / DESIGNED[u] for u, lag in lags.items()}
    ours = all(1.0 / PAPERS_SIZE <= r <= PAPERS_SIZE for r in slower.values())
    base = CONTROLLER.sized(rig.scales).values()
    own = {"sample_time": sampling(min(lags.values()), base["sample_time"])}
    own |= {f"omega_{end}": value for end, value in zip(("min", "max"), rig.speed, strict=True)}
    own |= {f"beta_{end}": value for end, value in zip(("min", "max"), rig.pitch, strict=True)}
    own |= {"beta_fixed": rig.pitch[1], "t_filter": base["t_filter"] * (1.0 if ours else min(slower.values()))}
    told = _given(given, parameters, source) if given else {}
    if sample_time is not None:
        told["sample_time"] = sample_time
    scales = {name: value for name, value in plant.items() if name in base}
    settings = {}
    for name, published in (("dual", DUAL), ("speed_only", SPEED_ONLY)):
        gains = {k: v for k, v in published.items() if k[:2] in ("kp", "ki", "kd")}
        own_gains = gains if ours else _scaled(gains, slower)
        alone = name == "speed_only"
        kept = told if not alone or told.get("speed_only", 0.0) > 0.5 else {k: v for k, v in told.items() if k not in gains}
        settings[name] = {**base, **own, **own_gains, **kept, **scales, "speed_only": float(alone)}
    left_out = {}
    if not moved["beta"]:
        left_out["dual"] = f"the rig's pitch is fixed at {rig.pitch[0]:g} deg"
    if not moved["omega"]:
        left_out["speed_only"] = f"the rig's speed is fixed at {rig.speed[0]:g} rpm"
    reference = "given" if given else "published" if ours else "scaled"
    return Controllers({n: s for n, s in settings.items() if n not in left_out}, left_out, reference)


def sampling(lag: float, usual: float) -> float:
    """Sampling period [s] for a plant whose faster channel has the sum of lags `lag` [s]: the `usual` one, or the round number
    that is nearest to it with neither too few nor too many samples in the lag."""
    shortest, longest = lag / MOST, lag / FEWEST
    return usual if shortest <= usual <= longest else rounded(shortest if usual < shortest else longest)


def _scaled(gains: Mapping[str, float], slower: Mapping[str, float]) -> dict[str, float]:
    power = {"kp": 0.0, "ki": -1.0, "kd": 1.0}
    return {k: v * slower.get(k[3:], 1.0) ** power[k[:2]] for k, v in gains.items()}


def _given(given: ParameterSet, parameters: ParameterSet, source: str) -> dict[str, float]:
    """What a controller's file names; BadInput where its limits leave the rig's range."""
    found = {name: estimate.value for name, estimate in given.estimates.items()}
    rig = parameters.rig
    for channel, (low, high) in zip(CHANNELS, (rig.speed, rig.pitch), strict=True):
        unit = "rpm" if channel == "omega" else "deg"
        for name in (f"{channel}_min", f"{channel}_max", f"{channel}_fixed"):
            if name in found and not low <= found[name] <= high:
                origin = rig.origin.get(CHANNELS[channel], "the model's scales")
                raise BadInput(
                    source, f"parameters, {name}", f"{found[name]:g} {unit}", f"{low:g} to {high:g} {unit} ({origin})"
                )
    return found
