"""The rig: its limits and the scales of its normalised quantities, declared in `rig.json` or inferred from a campaign."""

import math
import os
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np

from vpp_fmu.errors import BadInput
from vpp_fmu.files import InFolder
from vpp_fmu.kernel.scales import PAPER, Scales
from vpp_fmu.kernel.signals import BETA_REF, OMEGA_REF, THRUST
from vpp_fmu.record import Record
from vpp_fmu.sensors import KINDS, SpeedSensor
from vpp_fmu.structured import read_object, shown

MOST_MARKS = 1000
"""Maximum number of marks per revolution."""

FORMAT = "vpp-rig/1"
FILE = "rig.json"
rig_file = InFolder((FILE,))

RANGES = {"speed": OMEGA_REF, "pitch": BETA_REF, "thrust": THRUST}
SLEWS = {"speed": "rpm/s", "pitch": "deg/s"}

ROTOR = {"diameter": (0.01, 30.0), "air_density": (0.1, 10.0)}
"""Ranges of a rotor's diameter, m, and of the density of its air, kg/m3."""

ROUND = (1.0, 1.2, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 6.0, 8.0, 10.0)
"""Leading digits of a round number."""

PAPERS_SIZE = 2.0
"""Maximum ratio of a quantity to the paper's at which a rig keeps the paper's scales."""

NEUTRAL = 0.25
"""Share of the measured pitch range below the pitch whose normalised value is 0. The paper's: -5 of -10 to 10 deg."""

DECLARED, MEASURED, ASSUMED = "rig.json", "the campaign", "the model's scales"


@dataclass(frozen=True)
class Rig:
    """Limits of a rig: ranges (least, greatest) of commanded `speed` [rpm], `pitch` [deg] and of `thrust` [N]; maximum slew
    rates of commands, `speed_slew` [rpm/s] and `pitch_slew` [deg/s], infinite if steps are allowed. `sensor`: declared fields
    of a `SpeedSensor` by name. `rotor`: declared `diameter` [m], and `air_density` [kg/m3] if declared.

    A range of one value (a fixed pitch) has equal ends. `origin`: source of each entry, in words.
    """

    name: str = ""
    speed: tuple[float, float] = (PAPER.omega_scale / 3.0, PAPER.omega_scale)
    pitch: tuple[float, float] = (PAPER.absolute(0.0, "position"), PAPER.absolute(1.0, "position"))
    thrust: tuple[float, float] = (0.0, PAPER.thrust_scale)
    speed_slew: float = math.inf
    pitch_slew: float = math.inf
    scales: Scales = PAPER
    origin: Mapping[str, str] = field(default_factory=dict)
    sensor: Mapping[str, Any] = field(default_factory=dict)
    rotor: Mapping[str, float] = field(default_factory=dict)

    def summary(self) -> dict:
        """The content of a rig.json, with `origin` beside it: for parameters.json and the reports."""
        ranges = {n: {"min": getattr(self, n)[0], "max": getattr(self, n)[1], "unit": s.unit} for n, s in RANGES.items()}
        slews = {n: getattr(self, f"{n}_slew") for n in SLEWS}
        return {
            "format": FORMAT,
            **({"name": self.name} if self.name else {}),
            **ranges,
            "slew": {n: v for n, v in slews.items() if math.isfinite(v)},
            "scales": asdict(self.scales),
            **({"sensors": {"speed": dict(self.sensor)}} if self.sensor else {}),
            **({"rotor": dict(self.rotor)} if self.rotor else {}),
            "origin": dict(self.origin),
        }

    @property
    def commanded(self) -> dict:
        """The content of a rig.json that declares what the rig's commands may do, and no more."""
        content = self.summary()
        names = ("format", "name", *SLEWS, "slew", "sensors", "rotor")
        return {name: content[name] for name in names if content.get(name)}

    def lines(self) -> list[str]:
        """One text for each entry, with its source."""
        s = self.scales
        text = f"w = omega / {s.omega_scale:g} rpm, b = (beta {s.beta_offset:+g} deg) / {s.beta_scale:g} deg, "
        text += f"T = thrust / {s.thrust_scale:g} N ({self.origin.get('scales', ASSUMED)})"
        sensor = [f"speed sensor {SpeedSensor(**self.sensor).text} ({DECLARED})"] if self.sensor else []
        rotor = [f"rotor {self.rotor['diameter']:g} m ({DECLARED})"] if self.rotor else []
        return [*(self._range(name) for name in RANGES), *self._slews(), *sensor, *rotor, text]

    def command_lines(self) -> list[str]:
        """The same for commands only."""
        return [*(self._range(name) for name in SLEWS), *self._slews()]

    @property
    def unknown(self) -> tuple[str, ...]:
        """Those of speed and pitch whose range is neither measured nor declared, but only spanned by the model's scales."""
        return tuple(name for name in SLEWS if self.origin.get(name, ASSUMED) == ASSUMED)

    def _range(self, name: str) -> str:
        (low, high), unit = getattr(self, name), RANGES[name].unit
        span = f"{low:.6g} to {high:.6g} {unit}" if low < high else f"{low:.6g} {unit}, fixed"
        return f"{name} {span} ({self.origin.get(name, ASSUMED)})"

    def _slews(self) -> list[str]:
        slews = ((name, unit, getattr(self, f"{name}_slew")) for name, unit in SLEWS.items())
        return [
            f"slew of {name} {slew:.6g} {unit} ({self.origin.get(f'{name}_slew', ASSUMED)})"
            for name, unit, slew in slews
            if math.isfinite(slew)
        ]

    def timed(self, seconds: float) -> "Rig":
        """The rig with its `time_scale` [s], rounded."""
        return replace(self, scales=replace(self.scales, time_scale=rounded(seconds)))


def rounded(size: float) -> float:
    """The round number nearest to a positive size, by ratio."""
    power = 10.0 ** math.floor(math.log10(size))
    return _tidy(min((d * power for d in ROUND), key=lambda r: abs(math.log(r / size))))


def rounded_up(size: float) -> float:
    """The smallest round number that is at least a positive size."""
    power = 10.0 ** math.floor(math.log10(size))
    return _tidy(next(d * power for d in ROUND if d * power >= size * (1.0 - 1e-9)))


def _tidy(number: float) -> float:
    """Without rounding errors: 0.3 for 3 times 0.1."""
    return float(f"{number:.6g}")


def declared_rig(path: str | os.PathLike, rest: Rig | None = None) -> Rig:
    """The rig that a rig.json declares. Missing entries are those of `rest`, and so are the scales of the map, which belong to
    a model. Without `rest` the file must have all three ranges; scales that it does not have are round numbers for these.

    BadInput names the field that is wrong or missing.
    """
    entries = read_rig(path)
    scales = entries.pop("scales", {})
    if rest is not None:
        time_scale = {name: value for name, value in scales.items() if name == "time_scale"}
        origin = {**rest.origin, **dict.fromkeys(entries, DECLARED)}
        return replace(rest, **entries, scales=replace(rest.scales, **time_scale), origin=origin)
    for name, signal in RANGES.items():
        if name not in entries:
            raise BadInput(path, name, "nothing", f"its min and max in {signal.unit}")
    inferred, kind = _inferred(*(entries[name] for name in RANGES))
    origin = {**dict.fromkeys(entries, DECLARED), "scales": DECLARED if scales else kind}
    return Rig(**entries, scales=replace(inferred, **scales), origin=origin)


def rig_of(scales: Scales, source: Mapping, where: str = "parameters.json: source, rig") -> Rig:
    """The rig of a parameter file: from its `source`, else the ranges of the model's scales. BadInput, naming `where`."""
    pitch = scales.absolute(0.0, "position"), scales.absolute(1.0, "position")
    spanned = Rig("", (scales.omega_scale / 3.0, scales.omega_scale), pitch, (0.0, scales.thrust_scale), scales=scales)
    if not isinstance(own := source.get("rig"), dict) or own.get("format") != FORMAT:
        return spanned
    content = {k: v for k, v in own.items() if k not in ("origin", "scales")}
    declared, origin = _entries(where, content), own.get("origin", {})
    if not isinstance(origin, dict) or not all(isinstance(text, str) for text in origin.values()):
        raise BadInput(where, "origin", shown(origin), "an object in braces { } of texts")
    return replace(spanned, origin=dict(origin), **declared)


def read_rig(path: str | os.PathLike) -> dict:
    """The entries of a rig.json as fields of a `Rig`, those of its scales under `scales`. BadInput names the field."""
    return _entries(path, read_object(path, FORMAT, "a rig.json"))


def _entries(path: str | os.PathLike, content: Mapping) -> dict:
    known = ("format", "name", *RANGES, "slew", "scales", "sensors", "rotor")
    for name in content:
        if name not in known:
            raise BadInput(path, name, "an unknown field", ", ".join(known))
    found: dict = {}
    if "name" in content:
        found["name"] = str(content["name"])
    for name, signal in RANGES.items():
        if name in content:
            entry = _object(path, name, content[name], ("min", "max", "unit"))
            if entry.get("unit", signal.unit) != signal.unit:
                raise BadInput(path, f"{name}, unit", shown(entry["unit"]), f'"{signal.unit}"')
            ends = [_number(path, f"{name}, {end}", entry.get(end), signal.minimum, signal.maximum) for end in ("min", "max")]
            if ends[0] > ends[1]:
                raise BadInput(path, f"{name}, max", f"{ends[1]:g}", f"at least its min, {ends[0]:g} {signal.unit}")
            found[name] = tuple(ends)
    slews = _object(path, "slew", content.get("slew", {}), tuple(SLEWS))
    found |= {f"{n}_slew": _number(path, f"slew, {n}", v, 1e-6, 1e9) for n, v in slews.items()}
    scales = _object(path, "scales", content.get("scales", {}), tuple(asdict(PAPER)))
    positive = {
        n: _number(path, f"scales, {n}", v, *((-1e3, 1e3) if n == "beta_offset" else (1e-6, 1e6))) for n, v in scales.items()
    }
    sensor = _sensor(path, content.get("sensors", {}))
    rotor = _object(path, "rotor", content.get("rotor", {}), tuple(ROTOR))
    rotor = {n: _number(path, f"rotor, {n}", v, *ROTOR[n]) for n, v in rotor.items()}
    if rotor and "diameter" not in rotor:
        raise BadInput(path, "rotor, diameter", "none", f"a number from {ROTOR['diameter'][0]:g} to {ROTOR['diameter'][1]:g} m")
    named = {"scales": positive, "sensor": sensor, "rotor": rotor}
    return found | {name: entry for name, entry in named.items() if entry}


def _sensor(path: str | os.PathLike, found: object) -> dict:
    """Declared fields of the speed sensor, as those of a `SpeedSensor`."""
    entry = _object(path, "sensors", found, ("speed",)).get("speed", {})
    entry = _object(path, "sensors, speed", entry, tuple(asdict(SpeedSensor())))
    kind, marks, averaged = (entry.get(n) for n in ("kind", "marks_per_revolution", "averaged"))
    if kind is not None and kind not in tuple(KINDS):
        raise BadInput(path, "sensors, speed, kind", shown(kind), " or ".join(shown(k) for k in KINDS))
    if marks is not None and (isinstance(marks, bool) or not isinstance(marks, int) or not 1 <= marks <= MOST_MARKS):
        raise BadInput(path, "sensors, speed, marks_per_revolution", shown(marks), f"a whole number from 1 to {MOST_MARKS}")
    if not isinstance(averaged, bool | None):
        raise BadInput(path, "sensors, speed, averaged", shown(averaged), "true or false")
    times = {n: (-1.0 if n == "delay" else 0.0, 10.0) for n in ("filter", "refresh", "delay")}
    numbers = {n: _number(path, f"sensors, speed, {n}", entry[n], *times[n]) for n in times if n in entry}
    named = {"kind": kind, "marks_per_revolution": marks, "averaged": averaged}
    return {n: v for n, v in named.items() if v is not None} | numbers


def _object(path: str | os.PathLike, name: str, found: object, known: tuple[str, ...]) -> dict:
    if not isinstance(found, dict):
        raise BadInput(path, name, shown(found), "an object in braces { }")
    for key in found:
        if key not in known:
            raise BadInput(path, f"{name}, {key}", "an unknown field", ", ".join(known))
    return found


def _number(path: str | os.PathLike, name: str, found: object, low: float, high: float) -> float:
    if isinstance(found, bool) or not isinstance(found, int | float) or not low <= found <= high:
        raise BadInput(path, name, shown(found), f"a number from {low:g} to {high:g}")
    return float(found)


def infer_rig(records: Iterable[Record], grid: Mapping[str, np.ndarray] | None, declared: Mapping) -> Rig:
    """The rig that `records` and a `grid` of steady points (columns by name; None) were measured on.

    `declared`: entries of a rig.json (`read_rig`), which take precedence. At least one record or the grid is required.
    """
    records = list(records)
    columns = [r.columns for r in records] + ([grid] if grid is not None else [])
    speed, pitch = (_span(c[f"{u}_ref"] for c in columns) for u in ("omega", "beta"))
    thrust = _span((c["thrust"] for c in columns if "thrust" in c), cut=0.001)
    measured = {"speed": speed, "pitch": pitch, "thrust": thrust}
    given = {n: v for n, v in declared.items() if n != "scales"}
    scales, kind = _inferred(speed, pitch, thrust)
    own = dict(declared.get("scales", {}))
    origin = {**dict.fromkeys(measured, MEASURED), **dict.fromkeys(given, DECLARED), "scales": kind}
    if own:
        origin["scales"] = f"{', '.join(own)}: {DECLARED}" + ("" if set(asdict(PAPER)) <= {*own, "time_scale"} else f"; {kind}")
    return Rig(**{**measured, **given}, scales=replace(scales, **own), origin=origin)


def _span(columns: Iterable[np.ndarray], cut: float = 0.0) -> tuple[float, float]:
    """Minimum and maximum of the finite values, without a share `cut` at each end."""
    values = np.concatenate([np.asarray(c, float)[np.isfinite(np.asarray(c, float))] for c in columns] or [np.zeros(1)])
    low, high = np.quantile(values, [cut, 1.0 - cut]) if len(values) else (0.0, 0.0)
    return float(low), float(high)


def _inferred(speed: tuple[float, float], pitch: tuple[float, float], thrust: tuple[float, float]) -> tuple[Scales, str]:
    """(scales, their source in words)."""
    top, force = max(speed[1], 1e-3), max(abs(thrust[0]), abs(thrust[1]), 1e-6)
    low, high = ((beta + PAPER.beta_offset) / PAPER.beta_scale for beta in pitch)
    half = PAPERS_SIZE / 4.0
    fits = -half <= low <= high <= 1.0 + half
    sizes = (top / PAPER.omega_scale, force / PAPER.thrust_scale)
    if fits and all(1.0 / PAPERS_SIZE <= size <= PAPERS_SIZE for size in sizes):
        return PAPER, "the paper's, whose size it has"
    span = pitch[1] - pitch[0]
    if span > 0.0:
        beta_scale = rounded_up((1.0 - NEUTRAL) * span)
        neutral = float(round(pitch[0] + NEUTRAL * span)) if span > 4.0 else pitch[0] + NEUTRAL * span
    else:
        beta_scale = PAPER.beta_scale
        neutral = -PAPER.beta_offset if fits else float(round(pitch[0])) - 0.5 * beta_scale
    scales = Scales(rounded_up(top), beta_scale, 0.0 - neutral, rounded_up(force))
    return scales, "round numbers for what was measured"
