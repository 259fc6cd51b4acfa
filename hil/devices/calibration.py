"""The rig's calibration: converts counts and pulses to newtons and degrees and back. Its hash is in every record."""

import hashlib
import json
import os
from bisect import bisect_right
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise

from hil.devices.ads1115 import FULL_SCALES, INPUTS, LARGEST, SMALLEST
from hil.devices.entries import Entries, NumberEntry
from hil.devices.supply import NAMES, Input
from vpp_fmu.errors import BadInput
from vpp_fmu.files import InFolder
from vpp_fmu.structured import as_json, read_json, shown

FORMAT = "vpp-calibration/1"

calibration_file = InFolder(("calibration.json",))

ADDRESSES = (0x49, 0x4A, 0x4B)
"""Addresses of the second ADC: ADDR pin on VDD, SDA or SCL. The first one's is on ground."""
SINGLE = tuple(channel for channel in INPUTS if "-" not in channel)

RATES = (475, 860)
"""Conversion rates at which a loop of 250 Hz reads no conversion twice, also with the ADC's clock 10 % slow."""


@dataclass(frozen=True)
class Calibration:
    """The rig's calibration. `zero`: counts without load at the calibration; the tare before each run is near it.

    `pulses` [s], increasing, and `pitches` [deg], falling or rising, are the table of blade pitch against the LAC's pulse,
    interpolated linearly. `rest_pitch` [deg]: pitch at idle. `supply`: which of voltage, current, temperature and torque are
    wired to a second ADC at `supply_address`. `source`: who, when, how.
    """

    newton_per_count: float
    zero: float
    channel: str
    full_scale: float
    rate: int
    esc_period: float
    esc_idle: float
    esc_max: float
    lac_period: float
    pulses: tuple[float, ...]
    pitches: tuple[float, ...]
    pitch_min: float
    pitch_max: float
    rest_pitch: float
    supply: Mapping[str, Input] = field(default_factory=dict)
    supply_address: int = 0x49
    source: Mapping = field(default_factory=dict, compare=False)

    @property
    def lac_idle(self) -> float:
        """The LAC's pulse [s] at rest."""
        return self.lac_pulse(self.rest_pitch)

    @property
    def sha256(self) -> str:
        """Hash of the numbers, independent of their format in the file; without `source`."""
        canonical = json.dumps(_content(self), sort_keys=True, separators=(",", ":"), allow_nan=False)
        return hashlib.sha256(canonical.encode()).hexdigest()

    def thrust(self, counts: float, zero: float) -> float:
        """Thrust [N] at a reading of `counts`, with the tare's `zero` [counts]."""
        return self.newton_per_count * (counts - zero)

    def esc_pulse(self, throttle: float) -> float:
        """The ESC's pulse [s] at a throttle of 0 (idle) to 1. ValueError outside."""
        if not 0.0 <= throttle <= 1.0:
            raise ValueError(f"throttle {throttle} is not within 0 to 1")
        return self.esc_idle + throttle * (self.esc_max - self.esc_idle)

    def throttle(self, pulse: float) -> float:
        """The throttle at an ESC's pulse [s], the inverse of `esc_pulse`; an ESC limits it to 0 to 1."""
        return min(max((pulse - self.esc_idle) / (self.esc_max - self.esc_idle), 0.0), 1.0)

    def lac_pulse(self, beta: float) -> float:
        """The LAC's pulse [s] for a blade pitch [deg]. ValueError outside `pitch_min` to `pitch_max`."""
        if not self.pitch_min <= beta <= self.pitch_max:
            raise ValueError(f"pitch {beta} deg is not within {self.pitch_min:g} to {self.pitch_max:g} deg")
        return _between(self.pitches, self.pulses, beta)

    def pitch(self, pulse: float) -> float:
        """The blade pitch [deg] at a LAC's pulse [s], inverse of `lac_pulse`; beyond the table's ends it is constant."""
        return _between(self.pulses, self.pitches, min(max(pulse, self.pulses[0]), self.pulses[-1]))


def _between(x: Sequence[float], y: Sequence[float], at: float) -> float:
    """Linear interpolation of the points (x, y) at `at`; x is monotonic and spans `at`."""
    if x[0] > x[-1]:
        x, y = x[::-1], y[::-1]
    k = min(max(bisect_right(x, at), 1), len(x) - 1)
    share = (at - x[k - 1]) / (x[k] - x[k - 1])
    return (1.0 - share) * y[k - 1] + share * y[k]  # exact at both points


_PERIOD, _PULSE, _PITCH = NumberEntry("s", 1e-4, 0.025), NumberEntry("s", 0.0, 0.025), NumberEntry("deg", -45.0, 45.0)
_NUMBERS = {
    "load_cell": {
        "force_per_count": ("newton_per_count", NumberEntry("N", -1.0, 1.0)),
        "zero": ("zero", NumberEntry("counts", SMALLEST + 1, LARGEST - 1)),
    },
    "esc": {
        "period": ("esc_period", _PERIOD),
        "idle_pulse": ("esc_idle", _PULSE),
        "max_pulse": ("esc_max", _PULSE),
    },
    "pitch": {
        "period": ("lac_period", _PERIOD),
        "minimum": ("pitch_min", _PITCH),
        "maximum": ("pitch_max", _PITCH),
        "rest": ("rest_pitch", _PITCH),
    },
}
"""By section and name in the file: the attribute, and its unit and range."""
_CHOICES = {"channel": tuple(INPUTS), "full_scale": tuple(FULL_SCALES), "rate": RATES}
_TABLE = {"pulse": ("pulses", _PULSE), "pitch": ("pitches", _PITCH)}


def read_calibration(path: str | os.PathLike) -> Calibration:
    """Read a calibration file; `hil/emulator/calibration.json` is one. BadInput names file, field, found and allowed."""
    content = read_json(path)
    if content == {}:
        hint = "vpp hil calibrate, which writes one; without --calibration the emulated rig has its own"
        raise BadInput(path, "file", "an empty object", "a calibration: load cell, ESC and pitch", hint)
    file = Entries(path, content, ("format", *_NUMBERS), optional=("source", "supply"))
    file.choice("format", (FORMAT,))
    extra = {"load_cell": tuple(_CHOICES), "pitch": ("table",)}
    sections = {name: file.entries(name, (*numbers, *extra.get(name, ()))) for name, numbers in _NUMBERS.items()}
    values = {name: sections["load_cell"].choice(name, allowed) for name, allowed in _CHOICES.items()}
    for section, numbers in _NUMBERS.items():
        for name, (attribute, number) in numbers.items():
            values[attribute] = sections[section].number(name, number)
    table = sections["pitch"].entries("table", _TABLE)
    for name, (attribute, number) in _TABLE.items():
        values[attribute] = table.numbers(name, number)
    address, supply = _supply(path, file.free("supply"))
    calibration = Calibration(**values, supply=supply, supply_address=address, source=file.free("source"))
    check(path, calibration)
    return calibration


def _supply(path: str | os.PathLike, given: Mapping) -> tuple[int, dict[str, Input]]:
    """(the second ADC's address, how its inputs are wired)."""
    if not given:
        return Calibration.supply_address, {}
    entries, inputs = Entries(path, given, ("address",), tuple(NAMES), "supply"), {}
    for name, unit in NAMES.items():
        if name in given:
            wired = entries.entries(name, ("channel", "zero", "per_volt"))
            zero, slope = (wired.number(key, NumberEntry(unit, -1e4, 1e4)) for key in ("zero", "per_volt"))
            if slope == 0.0:
                raise wired.wrong("per_volt", slope, f"a number of {unit} but 0")
            inputs[name] = Input(wired.choice("channel", SINGLE), zero, slope)
    channels = [wired.channel for wired in inputs.values()]
    if not inputs or len(set(channels)) < len(channels):
        found = f"{', '.join(channels)}" if inputs else "no quantity"
        raise BadInput(path, "supply", found, f"{', '.join(NAMES)}, any of them, each with a channel of its own")
    return entries.choice("address", ADDRESSES), inputs


SECTIONS = ("load_cell", "esc", "pitch")
"""Sections that must be measured."""


def never_measured(calibration: Calibration) -> list[str]:
    """SECTIONS for which `source` has no person and date, neither for the section nor for the whole file."""

    def has_source(entry: object) -> bool:
        return isinstance(entry, Mapping) and bool(entry.get("who")) and bool(entry.get("when"))

    source = calibration.source
    return [] if has_source(source) else [section for section in SECTIONS if not has_source(source.get(section))]


def to_json(calibration: Calibration) -> str:
    """The calibration as a file's text, exact to the bit when read back."""
    content = {"format": FORMAT, **_content(calibration), "source": dict(calibration.source)}
    return as_json(content)


def _content(c: Calibration) -> dict:
    content: dict[str, dict] = {}
    for section, numbers in _NUMBERS.items():
        content[section] = {k: {"value": float(getattr(c, name)), "unit": n.unit} for k, (name, n) in numbers.items()}
    content["load_cell"].update((name, getattr(c, name)) for name in _CHOICES)
    table = {key: {"values": list(getattr(c, name)), "unit": n.unit} for key, (name, n) in _TABLE.items()}
    content["pitch"]["table"] = table
    if c.supply:
        content["supply"] = {"address": c.supply_address} | {
            name: {"channel": wired.channel}
            | {k: {"value": getattr(wired, k), "unit": NAMES[name]} for k in ("zero", "per_volt")}
            for name, wired in c.supply.items()
        }
    return content


def _check_table(path: str | os.PathLike, pulses: Sequence[float], pitches: Sequence[float]) -> None:
    where = "pitch, table, "
    if len(pulses) < 2:
        raise BadInput(path, f"{where}pulse", f"{len(pulses)} values", "2 or more")
    if len(pitches) != len(pulses):
        raise BadInput(path, f"{where}pitch", f"{len(pitches)} values", f"{len(pulses)}, as many as pulse has")
    if not _increasing(pulses):
        raise BadInput(path, f"{where}pulse", shown(list(pulses)), "values that rise")
    if not _increasing(pitches) and not _increasing(pitches[::-1]):
        raise BadInput(path, f"{where}pitch", shown(list(pitches)), "values that only rise or only fall")


def _increasing(values: Sequence[float]) -> bool:
    return all(a < b for a, b in pairwise(values))


def check(path: str | os.PathLike, c: Calibration) -> None:
    """Check relations between fields. BadInput names the first that is violated."""
    _check_table(path, c.pulses, c.pitches)
    low, high, longest = min(c.pitches), max(c.pitches), c.pulses[-1]
    rules = (
        (abs(c.newton_per_count) >= 1e-6, "load_cell, force_per_count", c.newton_per_count, "1e-06 N or more, of either sign"),
        (
            c.esc_idle > 0.0,
            "esc, idle_pulse",
            c.esc_idle,
            "more than 0 s: an ESC without pulses is not at idle but without a signal",
        ),
        (c.esc_idle < c.esc_max, "esc, max_pulse", c.esc_max, f"more than idle_pulse, {c.esc_idle:g} s"),
        (c.esc_max < c.esc_period, "esc, period", c.esc_period, f"more than max_pulse, {c.esc_max:g} s"),
        (longest <= c.lac_period, "pitch, period", c.lac_period, f"the table's longest pulse, {longest:g} s, or more"),
        (low <= c.pitch_min, "pitch, minimum", c.pitch_min, f"the table's lowest pitch, {low:g} deg, or more"),
        (c.pitch_max <= high, "pitch, maximum", c.pitch_max, f"the table's highest pitch, {high:g} deg, or less"),
        (c.pitch_min < c.pitch_max, "pitch, maximum", c.pitch_max, f"more than minimum, {c.pitch_min:g} deg"),
        (c.pitch_min <= c.rest_pitch <= c.pitch_max, "pitch, rest", c.rest_pitch, "a pitch from minimum to maximum"),
    )
    for kept, name, found, allowed in rules:
        if not kept:
            raise BadInput(path, name, found, allowed)
