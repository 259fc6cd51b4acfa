"""A learned law as a model, and policy files: its arrays, its scaling, the box that it was trained in, its limits.

    {"format": "vpp-policy/1", "observe": [names], "history": n, "mean": [...], "scale": [...], "low": [...], "high": [...],
     "weights": [[[...]]], "biases": [[...]], "activation": "tanh" | "relu", "squash": false, "action": "absolute" | "rate",
     "precision": [[...]], "distance": d, "parameters": {"sample_time": 0.004, "omega_max": 6000, ...}}

`observe`, `weights`, `biases`, `mean`, `scale`, `low` and `high` are needed; without `precision` the box alone is checked.
Their meaning: `Law` in vpp_fmu/kernel/effects/policy.py.
"""

import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from vpp_fmu.errors import BadInput
from vpp_fmu.files import OutputFolder
from vpp_fmu.kernel.controller import CONTROLLER
from vpp_fmu.kernel.effects.dual_pid import ALLOCATED, ALLOCATION, DUAL
from vpp_fmu.kernel.effects.policy import OBSERVABLE, Law, policy_effect
from vpp_fmu.kernel.plant import OURS
from vpp_fmu.kernel.scales import PAPER, Scales
from vpp_fmu.kernel.signals import OMEGA
from vpp_fmu.kernel.types import BOOLEAN, Model, Signal
from vpp_fmu.parameters import POLICY, ParameterSet, policy_file
from vpp_fmu.structured import as_json, check_kinds, read_object, shown

FORMAT = "vpp-policy/1"

NAME = "VppPolicy"

FALLBACK = Signal("fallback", "1", "the dual PID acts in place of the learned law", 0.0, 1.0, kind=BOOLEAN)

WIDEST, DEEPEST, LONGEST_HISTORY = 64, 4, 32
"""Largest number of units in a layer, of layers, and of earlier readings: the law becomes straight-line code."""

KINDS = {
    "observe": [str],
    "history?": int,
    **{name: [float] for name in ("mean", "scale", "low", "high")},
    "weights": [[[float]]],
    "biases": [[float]],
    "activation?": str,
    "squash?": bool,
    "action?": str,
    "precision?": [[float]],
    "distance?": float,
    "parameters?": {"*": float},
}
"""Fields of a policy file; a "?" marks those that may be missing."""


def policy_model(law: Law, scales: Scales = PAPER, outputs: int = 3) -> Model:
    """The law's model for a rig of these scales. `outputs`: 2 omits the flag for the fallback, as a controller has no
    such output."""
    return Model(
        NAME,
        "Learned law: thrust error to speed and pitch commands, with a dual PID to fall back on",
        inputs=(*CONTROLLER.inputs, *([OMEGA] if "omega" in law.observe else [])),
        outputs=(*CONTROLLER.outputs, FALLBACK)[:outputs],
        effects=(policy_effect(law),),
        sample_time="sample_time",
        **OURS,
    ).sized(scales)


@dataclass(frozen=True, eq=False)
class Policy:
    """A law, and values of its model's parameters that differ from the defaults; `source`: where it comes from."""

    law: Law
    values: Mapping[str, float] = field(default_factory=dict)
    source: str = "arrays"

    @cached_property
    def size(self) -> tuple[int, ...]:
        """Units of each layer, from the observations to the commands."""
        return (len(self.law.mean), *(len(biases) for _, biases in self.law.layers))

    def in_place_of(self, controller: ParameterSet) -> ParameterSet:
        """The law on the controller's rig, with that controller to fall back on: its limits, scales and gains, where the policy
        has none of its own. BadInput: limits beyond the controller's, other scales."""
        own, rig = controller.values, controller.rig
        found = self.parameters(own, rig.scales)
        for name, value in self.values.items():
            u, _, end = name.partition("_")
            if end in ("min", "max") and not own[f"{u}_min"] <= value <= own[f"{u}_max"]:
                allowed = f"{own[f'{u}_min']:g} to {own[f'{u}_max']:g}, the limits of the rig's controller"
                raise BadInput(self.source, f"parameters, {name}", value, allowed)
            if name in vars(rig.scales) and value != own[name]:
                raise BadInput(self.source, f"parameters, {name}", value, f"{own[name]:g}, the scale of the rig")
        return replace(found, source={**found.source, "rig": rig.summary()})

    def parameters(self, controller: Mapping[str, float] | None = None, scales: Scales = PAPER) -> ParameterSet:
        """The law's model for a rig of these scales. `controller`: values of the dual PID to fall back on, with limits; the
        policy's own come first. BadInput names an unknown parameter or a value out of its range."""
        found = ParameterSet(policy_model(self.law, scales), source={"made_by": "a learned law", "policy": self.source})
        controller = controller or {}
        if controller.get("mode", DUAL) == ALLOCATED:
            allowed = "0 or 1: a policy falls back on the dual PID, or on speed alone"
            raise BadInput("gains", "parameters, mode", "2 (allocated)", allowed)
        values = {**{n: v for n, v in controller.items() if n not in ALLOCATION}, **self.values}
        known = {p.name: p for p in found.model.parameters}
        for name, value in values.items():
            if name not in known:
                raise BadInput(self.source, f"parameters, {name}", "a name that the policy does not have", ", ".join(known))
            p = known[name]
            if not p.minimum <= value <= p.maximum:
                raise BadInput(self.source, f"parameters, {name}", value, f"{p.minimum:g} to {p.maximum:g} {p.unit}")
        return found.replaced(values)

    def to_dict(self) -> dict[str, Any]:
        """The content of a policy file."""
        law = self.law
        content = {name: getattr(law, name) for name in ("observe", "history", "mean", "scale", "low", "high")}
        content |= {"weights": [weights for weights, _ in law.layers], "biases": [biases for _, biases in law.layers]}
        content |= {"activation": law.activation, "squash": law.squash, "action": "rate" if law.rate else "absolute"}
        if law.precision:
            content |= {"precision": law.precision, "distance": law.distance}
        return {"format": FORMAT, **content, "parameters": dict(self.values)}

    def save(self, folder: str | os.PathLike[str]) -> Path:
        """Write policy.json into a folder; returns its path. BadInput."""
        return OutputFolder(folder).write(POLICY, as_json(self.to_dict()))


def read_policy(path: str | os.PathLike) -> Policy:
    """The policy of a file, or of a folder with policy.json. BadInput."""
    path = Path(policy_file(path))
    content = read_object(path, FORMAT, "a policy in JSON")
    return _checked({name: value for name, value in content.items() if name != "format"}, path)


def policy_from_arrays(weights: Sequence, biases: Sequence, source: object = "arrays", **fields: Any) -> Policy:
    """A policy from `weights` (outputs, inputs) and `biases` (outputs,) of each layer, speed and pitch last: arrays, lists, or
    tensors of PyTorch.

    `fields`: those of a policy file: `observe`, and `mean`, `scale`, `low`, `high` (observations,) in the observations' units
    are needed. BadInput names an invalid one.
    """
    text = json.dumps({"weights": weights, "biases": biases, **fields}, default=lambda each: each.tolist())
    return _checked(json.loads(text), source)


def _checked(content: Mapping[str, Any], source: object) -> Policy:
    """The policy of the fields of a file. BadInput."""

    def must(name: str, good: bool, found: object, allowed: str) -> None:
        if not good:
            raise BadInput(source, name, shown(found), allowed)

    def numbers(name: str, given: Sequence, *shape: int) -> Any:
        ragged = len({len(row) for row in given if isinstance(row, list)}) > 1
        found = np.full(1, np.nan) if ragged else np.asarray(given, float)
        words = f"{'rows of different length' if ragged else ' x '.join(map(str, found.shape))}, {shown(given)}"
        if found.shape != shape or not (np.abs(found) < 1e12).all():
            raise BadInput(source, name, words, f"{' x '.join(map(str, shape))} numbers")
        return _tuples(found)

    names = {name.rstrip("?") for name in KINDS}
    for name in content:
        must(name if name.isprintable() else shown(name), name in names, "an unknown field", ", ".join(sorted(names)))
    check_kinds(source, content, KINDS)
    given = {name: value for name, value in content.items() if value is not None}
    observe, history, weights, biases = given["observe"], given.get("history", 0), given["weights"], given["biases"]
    activation, action = given.get("activation", "tanh"), given.get("action", "absolute")
    known = bool(observe) and set(observe) <= set(OBSERVABLE) and len(set(observe)) == len(observe)
    must("observe", known, observe, f"names of {', '.join(OBSERVABLE)}, each once")
    must("history", 0 <= history <= LONGEST_HISTORY, history, f"a whole number from 0 to {LONGEST_HISTORY}")
    must("activation", activation in ("tanh", "relu"), activation, "tanh or relu")
    must("action", action in ("absolute", "rate"), action, "absolute or rate")
    must("weights", 0 < len(weights) <= DEEPEST, len(weights), f"1 to {DEEPEST} layers")
    must("biases", len(biases) == len(weights), len(biases), f"{len(weights)} layers, as weights")
    count = len(observe) + history
    box = {name: numbers(name, given[name], count) for name in ("mean", "scale", "low", "high")}
    must("scale", min(box["scale"]) > 0.0, box["scale"], "numbers above 0")
    must("low", all(low < high for low, high in zip(box["low"], box["high"], strict=True)), box["low"], "less than high")
    layers, width = [], count
    for k, (w, b) in enumerate(zip(weights, biases, strict=True)):
        units = 2 if k + 1 == len(weights) else len(b)
        must(f"biases, layer {k}", 0 < units <= WIDEST, units, f"1 to {WIDEST} units")
        layers.append((numbers(f"weights, layer {k}", w, units, width), numbers(f"biases, layer {k}", b, units)))
        width = units
    precision, distance = given.get("precision", ()), given.get("distance", 0.0)
    if precision:
        precision = numbers("precision", precision, count, count)
        good = np.allclose(precision, np.transpose(precision)) and np.linalg.eigvalsh(precision)[0] > 0.0
        must("precision", bool(good), precision, "the inverse of a covariance: symmetric, with positive eigenvalues")
        must("distance", 0.0 < distance < 1e6, distance, "a number above 0, with precision")
    law = Law(
        observe=tuple(observe),
        layers=tuple(layers),
        activation=activation,
        history=history,
        rate=action == "rate",
        squash=given.get("squash", False),
        precision=precision,
        distance=float(distance),
        **box,
    )
    found = Policy(law, {n: float(v) for n, v in given.get("parameters", {}).items()}, str(source))
    found.parameters()
    return found


def _tuples(values: np.ndarray) -> Any:
    return tuple(_tuples(row) for row in values) if values.ndim > 1 else tuple(values.tolist())
