"""The mapping of a log's columns to quantities: given by a user, read from an earlier import, or proposed from the header."""

import json
import os
import re
from collections import Counter
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field

import numpy as np

from identification.logs.clock import CALENDAR, guessed_unit, is_calendar
from identification.logs.raw_table import RawTable, plain, split_unit
from identification.logs.units import QUANTITIES, contradicts, factor_of, is_rate, scale_of
from vpp_fmu.errors import BadInput, near
from vpp_fmu.files import shown
from vpp_fmu.structured import check_kinds, read_toml

FORMAT = "vpp-mapping/1"
FILE = "import.toml"

_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?")

ROWS = "row"
"""In place of a column: the row number is the time of a log without one, time=row:4ms."""

SURE, LIKELY, NAMED, GUESS = "sure", "likely", "by its name", "guess"
"""Confidence of a proposal: the log has name and unit; only one unit is possible; the name ends with a possible unit (thrust_g,
but thrust_t need not be in tons); none of these."""

LEAVE_OUT = "-"
"""In place of a column: the quantity is not imported, NAME=-."""

STEEP = 90.0
"""deg, above the pitch of any blade; larger numbers are a servo's pulses or counts."""

COUNTS_FROM = 1000.0
"""Numbers above it in a column that calls itself raw are counts."""

FAST = 3000.0
"""rad/s, above any rotor's speed: larger numbers named omega are rpm."""

_ATTITUDE = re.compile(r"pi?tch|roll|yaw")

MOVES = 2.0
"""deg: an angle that moves by more is not one of the stand."""

_TELLING = {
    "omega": ("rpm", "RPM", "1/min", "U/min", "rev/min", "r/min", "rev/s", "r/s", "rps", "krpm", "tr/min", "giri/min", "UPM"),
    "beta": ("deg", "°", "rad"),
    "thrust": ("N", "mN", "kN", "kgf", "gf", "lbf", "ozf"),
    "torque": ("Nm", "N.m", "N·m", "N*m", "mNm", "Ncm"),
}
"""Units that determine a column's quantity if its name does not; an angle, only if the name is that of a command."""

_PLAIN = frozenset(["N", "mN", "kN", "gf", "kgf", "lbf", "deg", "rad", "rpm", "Hz", "ms", "us"])
"""Endings of a name that can only be units, such as thrust_N."""

SMALL_ANGLE = 0.6
"""Largest number of a pitch without a unit that is taken as rad: no rotor's pitch moves by less than a degree in all."""

_WORDS = {
    "time": "time t timestamp zeit uhrzeit datetime clock elapsed seconds epoch utc sec millis micros stamp x "
    "temps tiempo tempo",
    "thrust": "thrust fz force schub schubkraft kraft load loadcell lift f poussee poussée empuje spinta newton",
    "omega": "omega rpm speed n drehzahl rotor rot motorspeed optical rev erpm tach tacho tachometer velocity w vitesse giri",
    "beta": "beta pitch blade collective anstellwinkel blattwinkel bladeangle bladepitch angle servo theta alpha aoa "
    "winkel paso passo pas",
    "signal": "esc throttle pwm dshot gas",
    "voltage": "voltage volt volts u vbat vbatt spannung v vin battery",
    "current": "current curr amp amps ampere i ibat strom ibatt",
    "torque": "torque drehmoment mz",
    "power": "",
    "run": "run step stepnumber lauf test",
    "thrust_std": "",
    "samples": "samples",
}
"""Words of a header by quantity, the most specific first. _ELECTRIC recognises power: a log may have that of the shaft, too."""


_MEANT_BY = {
    "beta": ("pitch", "collective", "servo", "beta", "anstellwinkel", "blattwinkel"),
    "thrust": ("thrust", "force", "schub", "kraft", "loadcell"),
}
"""The words that mean pitch or thrust only; an angle may be the stand's, a load the motor's."""


def _words(text: str) -> frozenset[str]:
    return frozenset(text.split())


_COMMAND = _words(
    "cmd command commanded ref reference set setpoint sp target tgt soll des desired demand demanded wanted "
    "consigne deseado deseada comando"
)
_NOISE = _words("motor prop propeller signal measured meas medida medido ist actual value raw rotor sensor channel ch filtered")
_MEASURED = _words("measured meas ist actual feedback fb pos position medida")
_ELECTRIC = _words("electrical electric elec el dc in input battery supply esc")
_SERVO = _words("servo servos")
SIDES = _words("left right front rear upper lower a b x y z")
_COUNTS = _words("adc counts count digits lsb ticks")
_NOT = _words("mx my power watt efficiency acc accx accy accz vibration temperature temp esc2 cell moment")


@dataclass(frozen=True)
class Column:
    """A column of the log and its unit; `sure`: confidence of a proposal, "" if given by a user."""

    name: str
    unit: str
    sure: str = ""

    def __str__(self) -> str:
        return f"{self.name}:{self.unit}" if self.unit else self.name


@dataclass(frozen=True)
class Plan:
    """A log's columns by quantity, and `fixed` values in the record's unit. `read`: options that read the file."""

    columns: Mapping[str, Column]
    fixed: Mapping[str, float] = field(default_factory=dict)
    read: Mapping[str, str] = field(default_factory=dict)

    def section(self, log: str) -> dict:
        """As a section of import.toml."""
        fixed = {name: f"{value!r}:{QUANTITIES[name].unit}" for name, value in self.fixed.items()}
        return {"log": log, "columns": {q: str(c) for q, c in self.columns.items()}, "fixed": fixed, "read": dict(self.read)}

    def words(self) -> str:
        """As options of the command line."""
        pairs = [f"{quantity}={column}" for quantity, column in self.columns.items()]
        fixed = [f"--fixed {name}={value:.9g}:{QUANTITIES[name].unit}" for name, value in self.fixed.items()]
        return " ".join(["--map", *(f"'{p}'" if re.search(r"[^\w=:./%-]", p) else p for p in pairs), *fixed])


def parse_pairs(pairs: Iterable[str], table: RawTable, force: bool = False) -> dict[str, Column | None]:
    """The columns of NAME=COLUMN:UNIT, named as in the table; without :UNIT the unit is the header's; None for NAME=-.

    `force`: accept a unit that contradicts the header. BadInput.
    """
    found: dict[str, Column | None] = {}
    for pair in pairs:
        quantity, equals, rest = pair.partition("=")
        if not equals or quantity not in QUANTITIES or not rest.strip():
            allowed = f"NAME=COLUMN:UNIT with NAME one of {', '.join(QUANTITIES)}{near(quantity, QUANTITIES)}"
            raise BadInput("command line", "--map", shown(pair), allowed)
        if quantity in found:
            raise BadInput("command line", f"--map {quantity}", f"{quantity} twice", "each quantity once")
        left_out = rest.strip() == LEAVE_OUT and LEAVE_OUT not in table.columns
        found[quantity] = None if left_out else _pair(quantity, rest.strip(), table, force)
    return found


def parse_fixed(pairs: Iterable[str]) -> dict[str, float]:
    """Values of NAME=VALUE:UNIT in a record's units. BadInput."""
    found = {}
    for pair in pairs:
        name, _, rest = pair.partition("=")
        value, _, unit = rest.partition(":")
        quantity = QUANTITIES.get(name) if name in ("omega_ref", "beta_ref", "voltage") else None
        factor = factor_of(quantity, unit or quantity.unit) if quantity else None
        try:
            found[name] = float(value) * (factor if factor is not None else float("nan"))
        except ValueError:
            found[name] = float("nan")
        if not np.isfinite(found[name]):
            allowed = "NAME=VALUE:UNIT with NAME omega_ref, beta_ref or voltage, such as beta_ref=8:deg"
            raise BadInput("command line", "--fixed", shown(pair), allowed)
    return found


def _pair(quantity: str, text: str, table: RawTable, force: bool) -> Column:
    """COLUMN or COLUMN:UNIT; a column's own name may contain a colon."""
    name, colon, unit = text.rpartition(":")
    if not colon or text in table.columns:
        name, unit = text, None
    unit = None if unit is None else unit.strip()
    counts_rows = quantity == "time" and name == ROWS and ROWS not in table.columns
    name = ROWS if counts_rows else table.find(name)
    if unit is None:
        unit = CALENDAR if quantity == "time" and is_calendar(table.columns[name]) else table.unit(name)
        if unit is None and not QUANTITIES[quantity].unit:
            unit = ""
    if unit is None or (not _fits(quantity, unit)):
        found = "no unit, in the log or behind the column" if unit is None else f"the unit {shown(unit)}"
        raise BadInput(table.source, f"{quantity}={name}", found, *_unit_of(quantity))
    header = None if counts_rows or unit == CALENDAR else table.unit(name)
    if header and not force and contradicts(QUANTITIES[quantity], unit, header):
        found = f"the unit {shown(unit)} for a column whose header says {shown(header)}"
        hint = f"{quantity}={name}:{header}, or --force if the header is wrong"
        raise BadInput(table.source, f"{quantity}={name}", found, "the unit of the header", hint)
    return Column(name, unit)


def _fits(quantity: str, unit: str) -> bool:
    return (quantity == "time" and unit == CALENDAR) or scale_of(QUANTITIES[quantity], unit) is not None


def _unit_of(quantity: str) -> tuple[str, str]:
    """(the expected unit in words, how to state it)."""
    unit = QUANTITIES[quantity].unit
    if quantity == "signal":
        return "us, % or 1, or no unit for the numbers of DShot", "signal=COLUMN:us"
    if QUANTITIES[quantity].turning:
        return "a unit of speed", f"{quantity}=COLUMN:rpm, or {quantity}=COLUMN:erpm/7 for electrical speed of 7 pole pairs"
    if quantity in ("beta", "beta_ref"):
        return "a unit of angle", f"{quantity}=COLUMN:deg, or two points of a calibration, {quantity}=COLUMN:us@1000=-5,2000=10"
    if quantity == "time":
        return f"a unit of time, or {CALENDAR} for dates and times of day", "time=COLUMN:s"
    return (f"a unit like {unit}", f"{quantity}=COLUMN:{unit}") if unit else ("no unit", f"{quantity}=COLUMN")


def propose(table: RawTable, without: Collection[str] = ()) -> dict[str, Column]:
    """Propose a column for each quantity from the header; of equal candidates, the first. `without`: columns of another rotor,
    or already in use."""
    best: dict[str, tuple[tuple, Column]] = {}
    for place, name in enumerate(table.columns):
        if name not in without and (found := proposed(table, name)):
            quantity, score, column = found
            seen = _seen(table, name) if table.columns[name].dtype.kind == "f" else None
            moving = seen is None or bool(len(seen) and np.ptp(seen))  # of two speed sensors, that which is connected
            if (column.sure == GUESS and not moving) or (quantity == "time" and seen is not None and not len(seen)):
                continue
            key = (moving, score, -place)
            if quantity not in best or key > best[quantity][0]:
                best[quantity] = key, column
    found = {quantity: best[quantity][1] for quantity in QUANTITIES if quantity in best}
    return {q: c for q, c in found.items() if q != "signal" or "omega_ref" not in found}


_INSTEAD = {"signal": "omega_ref", "omega_ref": "signal"}
"""Quantities of which one is enough."""

_DECIDE = ("time", "omega_ref", "beta_ref", "thrust", "signal")
"""Quantities whose unit must be certain; others are left out if their unit is a guess."""


def completed(
    table: RawTable, own: Mapping[str, Column | None], fixed: Mapping[str, float], without: Collection[str], accept: bool
) -> tuple[dict[str, Column], list[str]]:
    """(a user's columns, completed by the proposal; messages). `accept`: also guessed units. BadInput if a quantity of _DECIDE
    has a guessed unit that is not accepted."""
    taken = {column.name for column in own.values() if column}
    given = {*own, *fixed}
    columns = {q: c for q, c in propose(table, {*without, *taken}).items() if q not in given}
    columns = {q: c for q, c in columns.items() if _INSTEAD.get(q) not in given}
    doubtful = {} if accept else {q: c for q, c in columns.items() if c.sure in (NAMED, GUESS)}
    deciding = [q for q in doubtful if not own or q in _DECIDE]
    mapped = {q: c for q, c in own.items() if c}
    if deciding:
        found = ", ".join(f"{c.name} as {q}{f' in {c.unit}' if c.unit else ''}" for q, c in doubtful.items())
        plan = Plan({q: c for q, c in (columns | mapped).items() if q not in fixed}, fixed)
        field, hint = f"unit of {', '.join(doubtful)}", f"--yes to take these units, or your own with {plan.words()}"
        raise BadInput(table.source, field, f"only guesses: {found}", "units in the header or in --map", hint)
    said = [f"{c.name}: not taken as {q}, its unit is a guess; --yes takes it in {c.unit}" for q, c in doubtful.items()]
    columns = {q: c for q, c in columns.items() if q not in doubtful} | mapped
    return {q: columns[q] for q in QUANTITIES if q in columns}, said


def moving_angle(table: RawTable, taken: Collection[str]) -> tuple[str, str, float, float] | None:
    """(column, unit, smallest and largest number) of a column that is an angle by its unit, moves as a pitch may, and is not
    taken; None if there is none."""
    for name in table.columns:
        tail = re.split(r"[\W_]+", name)[-1]
        unit = table.unit(name) or (tail if tail in _PLAIN else "")
        if name in taken or not unit or not _fits("beta", unit) or not _numeric(table, name) or _attitude(table, name):
            continue
        seen = _seen(table, name)
        if len(seen) and np.ptp(seen) * factor_of(QUANTITIES["beta"], unit) > MOVES:
            return name, unit, float(seen.min()), float(seen.max())
    return None


def in_other_unit(table: RawTable, quantity: str, taken: Collection[str]) -> tuple[str, str, float, float] | None:
    """(column, unit, smallest and largest number) of a column that is `beta` or `thrust` by its name but in another unit: a
    servo's pulse, a stroke, counts, mV. None if there is none, or if it is empty or always 0."""
    for name in table.columns:
        meant, _, tokens, _ = _meant(table, name)
        unit = table.unit(name) or _ending(name) or None
        plainly = any(_is(token, word) for token in tokens for word in _MEANT_BY[quantity])
        if name in taken or meant not in (quantity, f"{quantity}_ref") or not plainly or not _numeric(table, name):
            continue
        if unit is not None and (_fits(quantity, unit) or is_rate(unit)):
            continue
        if (seen := _seen(table, name)).any() and (unit is not None or _unscaled(meant, tokens, seen)):
            return name, unit or "", float(seen.min()), float(seen.max())
    return None


def _unscaled(quantity: str, tokens: Collection[str], seen: np.ndarray) -> bool:
    """Whether numbers without a unit are no angle or no force: a servo's command, counts, large numbers."""
    if quantity == "thrust":
        return bool(_COUNTS & set(tokens)) or ("raw" in tokens and bool(np.abs(seen).max(initial=0.0) > COUNTS_FROM))
    return quantity in ("beta", "beta_ref") and (bool(_SERVO & set(tokens)) or bool(np.abs(seen).max(initial=0.0) > STEEP))


def _seen(table: RawTable, name: str) -> np.ndarray:
    """The finite numbers of a column; empty if a cell is not a number, which is an error only when the column is read."""
    try:
        values = table.numbers(name)
    except BadInput:
        return np.zeros(0)
    return values[np.isfinite(values)]


def _ending(name: str) -> str:
    """A unit at the end of a name that abbreviates no word: %, or us (of a pulse); "" if there is none."""
    found = re.search(r"(?i)(%|(?<=[\W_])(?:us|pwm))$", name.strip())
    return "" if found is None else "%" if found[0] == "%" else "us"


def _meant(table: RawTable, name: str) -> tuple[str, float, list[str], str]:
    """(quantity, score, words, last word as written) of a header's name; quantity "" if the name suggests none."""
    base, _ = split_unit(name)
    text = re.sub(r"(?i)load[ _]cell", "loadcell", re.sub(r"(?<=[a-zäöü])(?=[A-Z])", " ", base))
    tokens = [t for t in re.split(r"[\W_]+|(?<=[a-zA-Z])(?=\d)", text.casefold()) if t and not t.isdigit()]
    tail = re.split(r"[\W_]+", base)[-1] if len(tokens) > 1 else ""  # case as written: N is newton, n is no unit
    if tail == "N":
        tokens.pop()
    exact = base.casefold().replace(" ", "_")
    if exact in QUANTITIES:
        return exact, 3.0, tokens, tail
    if {"power", "p"} & set(tokens) and _ELECTRIC & set(tokens) and _fits("power", table.unit(name) or tail):
        return "power", 1.0, tokens, tail
    if set(tokens) & _NOT or _attitude(table, name):
        return "", 0.0, tokens, tail
    command = any(_commands(t) for t in tokens) or (bool(_SERVO & set(tokens)) and not set(tokens) & _MEASURED)
    scores = {q: _score([t for t in tokens if t not in _COMMAND], words.split(), q) for q, words in _WORDS.items()}
    of_esc = not any(_is(t, word) for t in tokens if t != "esc" for word in _WORDS["signal"].split())
    if scores["beta"] > 0.0 or (of_esc and not {*tokens} <= {"esc", "us"} | SIDES | _NOISE | _COMMAND):
        scores["signal"] = 0.0  # "servo pwm" is no motor's, and "esc rpm" and "esc err" are readings
    quantity = max(scores, key=scores.get)
    unit = table.unit(name) or ""
    if scores[quantity] <= 0.0 or (unit and quantity not in ("omega", "beta") and not _fits(quantity, unit)):
        stated = next((q for q, units in _TELLING.items() if unit in units and (q != "beta" or command)), "")
        quantity, scores = (stated, {stated: 0.5}) if stated else (quantity, scores)  # "target (rpm)", "T [N]"
    score = scores[quantity]
    if score <= 0.0:
        return "", 0.0, tokens, tail
    return f"{quantity}_ref" if command and quantity in ("omega", "beta") else quantity, score, tokens, tail


def proposed(table: RawTable, name: str) -> tuple[str, float, Column] | None:
    """(quantity, score, column) of a header's name; None if the name suggests no quantity."""
    quantity, score, tokens, tail = _meant(table, name)
    if not quantity and is_calendar(table.columns[name]) and ":" in str(table.columns[name][0]):
        return "time", 0.1, Column(name, CALENDAR, SURE)  # the index of a table, which has no name
    if not quantity:
        return None
    unit, sure = table.unit(name), SURE
    if quantity == "omega" and unit and unit.casefold() == "erpm":
        unit = "rpm"  # until the command determines the pole pairs
    if quantity == "time" and is_calendar(table.columns[name]):
        return quantity, score, Column(name, CALENDAR, SURE)
    if not _numeric(table, name):
        return None
    if unit is None and quantity in QUANTITIES and {"omega_ref", "beta_ref"} <= set(table.columns):
        own = split_unit(name)[0].casefold().replace(" ", "_") == quantity
        unit = QUANTITIES[quantity].unit if own else None  # a record in this project's own names, which has its own units
    if unit is None and quantity in ("omega", "omega_ref") and {"rpm", "erpm"} & {*tokens}:
        unit = "rpm"
    if quantity in ("signal", "beta", "beta_ref"):
        tail = _ending(name) or tail
    if unit is None and tail and (tail == _ending(name) or (QUANTITIES[quantity].unit and _fits(quantity, tail))):
        unit, sure = tail, LIKELY if tail in _PLAIN or _assumed(table, name, quantity) == (tail, LIKELY) else NAMED
    if unit is not None and not _fits(quantity, unit):  # "motor cmd (us)" is no speed
        is_signal = quantity in ("omega", "omega_ref") and unit and factor_of(QUANTITIES["signal"], unit) is not None
        return ("signal", 0.5, Column(name, unit, LIKELY)) if is_signal else None
    if unit is None:
        unit, sure = _assumed(table, name, quantity)
    if sure == GUESS and _unscaled(quantity, tokens, _seen(table, name)):
        return None
    return None if unit is None else (quantity, score, Column(name, unit, sure))


def _attitude(table: RawTable, name: str) -> bool:
    """Whether a pitch, roll or yaw is an angle of the whole stand: a column of the same name has another of the three."""
    stems = Counter(_ATTITUDE.sub("#", n) for n in {n.casefold() for n in table.columns} if _ATTITUDE.search(n))
    return stems[_ATTITUDE.sub("#", name.casefold())] > 1


def _score(tokens: list[str], words: list[str], quantity: str) -> float:
    """Score of a name's words for a quantity: 2 if all match, 1 if some do, less for words late in the list."""
    supply = quantity in ("voltage", "current")  # "current in" is the supply's, "motor current" may be of a phase
    noise = (_NOISE | _ELECTRIC) - {"motor"} if supply else _NOISE
    places = [next((k for k, word in enumerate(words) if _is(t, word)), None) for t in tokens]
    known = [place for place in places if place is not None]
    if not known:
        return 0.0
    rest = [t for t, place in zip(tokens, places, strict=True) if place is None and t not in noise]
    return (2.0 if not rest else 1.0) - 0.01 * min(known)


def _is(token: str, word: str) -> bool:
    """Whether a word of a header is a listed word; a listed word of four letters or more may be part of a compound."""
    return token == word or (len(word) >= 4 and (token.startswith(word) or token.endswith(word)))


def _commands(token: str) -> bool:
    return token in _COMMAND or any(len(word) >= 4 and token.startswith(word) for word in _COMMAND) or token.endswith("cmd")


def _assumed(table: RawTable, name: str, quantity: str) -> tuple[str | None, str]:
    """(unit, confidence) of a column without a unit."""
    if quantity == "time":
        unit = guessed_unit(table.numbers(name))
        return unit or "s", LIKELY if unit else GUESS
    if quantity == "signal":
        values = table.numbers(name)
        seen = values[np.isfinite(values)]
        if not len(seen):
            return None, GUESS
        high, low = float(seen.max()), float(seen.min())
        if 700.0 <= low <= high <= 2300.0:
            return "us", LIKELY
        return ("1" if high <= 1.0 else "%" if high <= 100.0 else ""), LIKELY if high > 100.0 else GUESS
    unit = QUANTITIES[quantity].unit
    if not unit:
        return "", SURE
    if quantity in ("beta", "beta_ref") and 0.0 < np.abs(_seen(table, name)).max(initial=0.0) < SMALL_ANGLE:
        return "rad", GUESS
    tokens = re.split(r"[\W\d_]+", name.casefold())
    of_si = QUANTITIES[quantity].turning and {"omega", "w", "velocity"} & {*tokens}
    if of_si and _seen(table, name).max(initial=0.0) < FAST:
        return "rad/s", GUESS
    return unit, LIKELY if quantity in ("voltage", "current") and len(name) > 1 else GUESS


def _numeric(table: RawTable, name: str) -> bool:
    """Whether most cells are numbers; the others are reported when the column is read."""
    if table.columns[name].dtype.kind != "O":
        return table.columns[name].dtype.kind == "f"
    texts = [plain(cell, table.decimal) for cell in table.columns[name].tolist()[:1000]]
    filled = [text for text in texts if text]
    return 2 * sum(bool(_NUMBER.fullmatch(text)) for text in filled) > len(filled)


def to_toml(sections: Mapping[str, Mapping]) -> str:
    """Content of import.toml: sections by kind, each as from `Plan.section`. `read_sections` and `--map` read it."""
    lines = [f"format = {json.dumps(FORMAT)}"]
    for kind, section in sections.items():
        lines += ["", f"[{kind}]", f"log = {_quoted(str(section.get('log', '')))}"]
        for part in ("columns", "fixed", "read"):
            if section.get(part):
                lines += ["", f"[{kind}.{part}]", *(f"{name} = {_quoted(text)}" for name, text in section[part].items())]
    return "\n".join(lines) + "\n"


def _quoted(text: str) -> str:
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")


def read_sections(path: str | os.PathLike) -> dict[str, dict]:
    """The sections of an import.toml by kind, each `log`, `columns`, `fixed`, `read` as text. BadInput names the field."""
    content = read_toml(path, "an import.toml that vpp import wrote")
    if content.get("format") != FORMAT:
        raise BadInput(path, "format", shown(str(content.get("format", ""))), FORMAT)
    sections = {kind: section for kind, section in content.items() if kind != "format"}
    texts = {"*": str}
    check_kinds(path, sections, {"*": {"columns": texts, "fixed?": texts, "read?": texts}})
    if not sections:
        raise BadInput(path, "file", "no section", "a section per file of the campaign, such as [open_loop]")
    return sections


def section_of(path: str | os.PathLike, kind: str) -> dict:
    """The section of a kind; if there is none, the first one, provided that all sections have the same columns. BadInput."""
    sections = read_sections(path)
    if kind in sections:
        return sections[kind]
    first, *others = sections.values()
    if any(other["columns"] != first["columns"] for other in others):
        raise BadInput(path, kind, f"sections {', '.join(sections)}, which differ", f"a section [{kind}]")
    return first
