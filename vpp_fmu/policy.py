"""Policy files: a learned law as arrays, its scaling, the box that it was trained in, its limits; as JSON or .npz.

    {"format": "vpp-policy/1", "observe": [names], "history": n, "mean": [...], "scale": [...], "low": [...], "high": [...],
     "weights": [[[...]]], "biases": [[...]], "activation": "tanh" | "relu", "squash": false, "action": "absolute" | "rate",
     "precision": [[...]], "distance": d, "parameters": {"sample_time": 0.004, "omega_max": 6000, ...}}

`observe`, `weights`, `biases`, `mean`, `scale`, `low` and `high` are needed; without `precision` the box alone is checked. A
.npz has the same names, but `weights_0`, `biases_0`, ... and `parameters.sample_time`, ... Their meaning: `Law` in
vpp_fmu/kernel/effects/policy.py.
"""

import io
import os
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from vpp_fmu.errors import BadInput, ExtraMissing
from vpp_fmu.files import InFolder, OutputFolder, read_bytes
from vpp_fmu.kernel.effects.dual_pid import ALLOCATED, ALLOCATION, DUAL
from vpp_fmu.kernel.effects.policy import OBSERVABLE, Law
from vpp_fmu.kernel.policy import policy_model
from vpp_fmu.kernel.scales import PAPER, Scales
from vpp_fmu.parameters import ParameterSet
from vpp_fmu.structured import as_json, check_kinds, read_object, shown

FORMAT, FILE = "vpp-policy/1", "policy.json"

policy_file = InFolder((FILE,))

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
        fallback = {n: v for n, v in (controller or {}).items() if n not in ALLOCATION}
        if (controller or {}).get("mode", DUAL) == ALLOCATED:
            raise BadInput(
                "gains", "parameters, mode", "2 (allocated)", "0 or 1: a policy falls back on the dual PID, or on speed alone"
            )
        values = {**fallback, **self.values}
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
        return OutputFolder(folder).write(FILE, as_json(self.to_dict()))


def read_policy(path: str | os.PathLike) -> Policy:
    """The policy of a .json or .npz file, or of a folder with policy.json. BadInput."""
    path = Path(path) / FILE if os.path.isdir(path) else Path(path)
    content = _read_npz(path) if path.suffix == ".npz" else read_object(path, FORMAT, "a policy in JSON, or .npz")
    if content.get("format") != FORMAT:
        raise BadInput(path, "format", shown(content.get("format")), f'"{FORMAT}"')
    allowed = {name.rstrip("?") for name in KINDS} | {"format"}
    for name in content:
        if name not in allowed:
            raise BadInput(path, shown(name), "an unknown field", ", ".join(sorted(allowed)))
    check_kinds(path, content, KINDS)
    own = {name: content[name] for name in allowed - {"format", "weights", "biases"} if content.get(name) is not None}
    return policy_from_arrays(content["weights"], content["biases"], **own, source=path)


def policy_from_arrays(
    weights: Sequence,
    biases: Sequence,
    *,
    observe: Sequence[str],
    mean: Sequence[float],
    scale: Sequence[float],
    low: Sequence[float],
    high: Sequence[float],
    history: int = 0,
    activation: str = "tanh",
    squash: bool = False,
    action: str = "absolute",
    precision: Sequence | None = None,
    distance: float = 0.0,
    parameters: Mapping[str, float] | None = None,
    source: object = "arrays",
) -> Policy:
    """A policy from arrays: `weights` (outputs, inputs) and `biases` (outputs,) of each layer, speed and pitch last.

    `mean`, `scale`, `low`, `high` (observations,) in the observations' units; other arguments as in the file. BadInput names
    an invalid argument.
    """

    def numbers(name: str, given: object, shape: tuple[int, ...]) -> np.ndarray:
        try:
            found = np.asarray(given, float)
        except (TypeError, ValueError):
            found = np.full(1, np.nan)
        if found.shape != shape or not (np.abs(found) < 1e12).all():
            size = " x ".join(map(str, found.shape)) or "one number"
            raise BadInput(
                source, name, f"{size}, {shown(np.ravel(found)[:4].tolist())}", f"{' x '.join(map(str, shape))} numbers"
            )
        return found

    def must(name: str, good: bool, found: object, allowed: str) -> None:
        if not good:
            raise BadInput(source, name, shown(found), allowed)

    names = tuple(observe)
    must("observe", bool(names) and all(n in OBSERVABLE for n in names), names, f"names of {', '.join(OBSERVABLE)}")
    must("observe", len(set(names)) == len(names), names, "each name once")
    must("history", history in range(LONGEST_HISTORY + 1), history, f"a whole number from 0 to {LONGEST_HISTORY}")
    must("activation", activation in ("tanh", "relu"), activation, "tanh or relu")
    must("action", action in ("absolute", "rate"), action, "absolute or rate")
    must("weights", 0 < len(weights) <= DEEPEST, len(weights), f"1 to {DEEPEST} layers")
    must("biases", len(biases) == len(weights), len(biases), f"{len(weights)} layers, as weights")
    count = len(names) + history
    own = {n: numbers(n, v, (count,)) for n, v in (("mean", mean), ("scale", scale), ("low", low), ("high", high))}
    must("scale", bool((own["scale"] > 0.0).all()), own["scale"].tolist(), "numbers above 0")
    must("low", bool((own["low"] < own["high"]).all()), own["low"].tolist(), "less than high")
    layers, width = [], count
    for k, (w, b) in enumerate(zip(weights, biases, strict=True)):
        units = 2 if k + 1 == len(weights) else len(b)
        must(f"biases, layer {k}", 0 < units <= WIDEST, units, f"1 to {WIDEST} units")
        layers.append(
            (_tuples(numbers(f"weights, layer {k}", w, (units, width))), _tuples(numbers(f"biases, layer {k}", b, (units,))))
        )
        width = units
    inverse = () if precision is None else _tuples(_positive(numbers("precision", precision, (count, count)), source))
    must("distance", precision is None or 0.0 < distance < 1e6, distance, "a number above 0, with precision")
    law = Law(
        observe=names,
        layers=tuple(layers),
        activation=activation,
        history=int(history),
        rate=action == "rate",
        squash=bool(squash),
        precision=inverse,
        distance=float(distance),
        **{name: _tuples(values) for name, values in own.items()},
    )
    found = Policy(law, {n: float(v) for n, v in (parameters or {}).items()}, str(source))
    found.parameters()
    return found


def policy_from_torch(module: Any, **scaling: Any) -> Policy:
    """The policy of a PyTorch module: `Linear` layers with `Tanh` or `ReLU` between them, such as `Sequential`.

    A `Tanh` behind the last layer is `squash`. `scaling`: the other arguments of `policy_from_arrays`. BadInput names
    unsupported layers.
    """
    layers = [m for m in module.modules() if not any(True for _ in m.children())]
    found = [
        (type(m).__name__, m.weight.tolist(), m.bias.tolist()) if hasattr(m, "weight") else (type(m).__name__,) for m in layers
    ]
    return _from_layers(found, **scaling)


def policy_from_onnx(path: str | os.PathLike, **scaling: Any) -> Policy:
    """The policy of an ONNX file (extra `onnx`): a chain of Gemm, or MatMul and Add, with Tanh or Relu, as `policy_from_torch`.

    ExtraMissing without onnx; BadInput for a file that can't be read, or a graph that is no such chain.
    """
    try:
        import onnx  # noqa: PLC0415 of an extra
    except ImportError as error:
        raise ExtraMissing("onnx: found no library, expected one. Try: pip install 'vpp-fmu[onnx]'") from error
    content = read_bytes(path)
    try:
        graph = onnx.load_model_from_string(content).graph
        constants = {tensor.name: onnx.numpy_helper.to_array(tensor).astype(float) for tensor in graph.initializer}
    except Exception as error:  # its parser's errors have no common base
        raise BadInput(path, "file", f"no ONNX model ({type(error).__name__})", "an ONNX model") from error
    found: list[tuple] = []
    carried = next((i.name for i in graph.input if i.name not in constants), None)
    for node in graph.node:
        operands = [constants[name] for name in node.input if name in constants]
        if carried not in node.input or len(operands) + 1 != len(node.input):
            raise BadInput(path, "graph", node.op_type, "a chain of layers from one input")
        found = _with_node(path, found, node, operands)
        (carried,) = node.output
    return _from_layers(found, **{"source": path, **scaling})


def _with_node(path: str | os.PathLike, found: list[tuple], node: Any, operands: list[np.ndarray]) -> list[tuple]:
    """The layers with one more node of a graph, whose constant operands are given."""
    given = {a.name: a.f or a.i for a in node.attribute}
    if node.op_type in ("Tanh", "Relu"):
        return [*found, ({"Relu": "ReLU"}.get(node.op_type, node.op_type),)]
    if node.op_type == "Gemm" and not given.get("transA") and {given.get("alpha", 1.0), given.get("beta", 1.0)} == {1.0}:
        weights = operands[0] if given.get("transB") else operands[0].T
        return [*found, ("Linear", weights.tolist(), (operands[1] if len(operands) > 1 else np.zeros(len(weights))).tolist())]
    if node.op_type == "MatMul" and operands[0].ndim == 2:
        return [*found, ("Linear", operands[0].T.tolist(), [0.0] * operands[0].shape[1])]
    if node.op_type == "Add" and found and found[-1][0] == "Linear":
        kind, weights, biases = found[-1]
        return [*found[:-1], (kind, weights, (np.array(biases) + operands[0].ravel()).tolist())]
    raise BadInput(path, "graph", node.op_type, "Gemm with factors of 1, MatMul, Add, Tanh, Relu")


def _from_layers(found: Sequence[tuple], **scaling: Any) -> Policy:
    """The policy of a chain of ("Linear", weights, biases) and ("Tanh",) or ("ReLU",)."""
    source = scaling.get("source", "the network")
    kinds = [kind for kind, *_ in found if kind != "Identity"]
    linear = [entry for entry in found if entry[0] == "Linear"]
    between = set(kinds[1 : 2 * len(linear) - 2 : 2])
    expected = [kind for _ in linear for kind in ("Linear", *between)][: 2 * len(linear) - 1]
    good = bool(linear) and len(between) <= 1 and between <= {"Tanh", "ReLU"} and kinds[: len(expected)] == expected
    if not good or kinds[len(expected) :] not in ([], ["Tanh"]):
        allowed = "Linear layers with Tanh, or with ReLU, between all of them; Tanh or nothing at the end"
        raise BadInput(source, "layers", ", ".join(kinds), allowed)
    activation = "relu" if "ReLU" in between else "tanh"
    own = {"activation": activation, "squash": len(kinds) > len(expected), **scaling}
    return policy_from_arrays([w for _, w, _ in linear], [b for _, _, b in linear], **own)


def _tuples(values: np.ndarray) -> Any:
    return tuple(_tuples(row) for row in values) if values.ndim > 1 else tuple(values.tolist())


def _positive(matrix: np.ndarray, source: object) -> np.ndarray:
    if not np.allclose(matrix, matrix.T) or np.linalg.eigvalsh(matrix)[0] <= 0.0:
        raise BadInput(source, "precision", "no inverse of a covariance", "a symmetric matrix with positive eigenvalues")
    return matrix


def _read_npz(path: Path) -> dict[str, Any]:
    content: dict[str, Any] = {"weights": [], "biases": [], "parameters": {}}
    try:
        with np.load(io.BytesIO(read_bytes(path)), allow_pickle=False) as arrays:
            for name in sorted(arrays.files, key=_place):
                value, (head, _, rest) = arrays[name].tolist(), name.partition("." if "." in name else "_")
                if head == "parameters":
                    content["parameters"][rest] = value
                elif head in ("weights", "biases") and rest.isdigit():
                    content[head].append(value)
                else:
                    content[name] = value
    except (ValueError, OSError, EOFError, KeyError, zipfile.BadZipFile, NotImplementedError) as error:
        raise BadInput(path, "file", f"no arrays ({error})", "a .npz of numbers and texts, without Python objects") from error
    return content


def _place(name: str) -> tuple[str, int]:
    head, _, number = name.rpartition("_")
    return (head, int(number)) if number.isdigit() else (name, 0)
