"""Checks of a campaign's files: units, signs, tares, and consistency between files.

Every check uses a ratio that does not depend on the size of the rotor: measured over commanded speed, one file over another,
a lag over that of the slowest rotor.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path

import numpy as np

from identification.gate.finding import Finding
from identification.gate.response import FOLLOWS, Look, Response, steady_response
from identification.gate.sensors import runs_of_equals
from identification.gate.zero import FAR, OFFSET, moved, tare
from vpp_fmu.campaign import Campaign, StaticMap
from vpp_fmu.kernel.effects.actuator import TIME_CONSTANTS
from vpp_fmu.record import Record
from vpp_fmu.rig import DECLARED, FILE, RANGES, Rig

SPEEDS = {"rad/s": 2.0 * np.pi / 60.0, "Hz": 1.0 / 60.0, "deg/s": 6.0}
"""One rpm in other units."""

POLE_PAIRS = (2, 30)
"""Range of pole pairs of motors. If measured over commanded speed is such a number, the speed is most likely electrical."""

WHOLE = 0.03
"""Relative tolerance of a whole ratio of speeds: speed controllers settle within it. From 17 pole pairs on, every ratio is this
close to a whole number, but no unit of speed has such a ratio."""

FORCES = {"gf": 101.972, "kgf": 0.101972, "lbf": 0.224809, "ozf": 3.59694, "mN": 1000.0, "kN": 0.001}
"""One newton in other units."""

TIMES = {"ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0, "h": 3600.0}
"""Units of time in s."""

AS_UNIT = 0.2
"""Logarithmic tolerance of a unit's ratio: units differ by more, and consistent files by less."""

SLOWEST = 10.0
"""s: no lag of a rotor or of blades is longer; the lag of a servo or a motor is a hundredth of it."""

USUAL = 0.3
"""s: typical lag of a rig, to choose among units of time; these differ by a factor of a thousand."""

BETTER = 2.0
"""Ratio of the residual variances of two preliminary fits above which the larger is rejected. With only fifty independent
readings chance exceeds it in one of a hundred records, and most records have thousands."""

SLOPE = 0.1
"""Minimum change of thrust with a command, as a share of a file's thrust range, to determine a sign."""

ONE_DEGREE = 1.0
"""deg: at this pitch from zero thrust blades give little of their thrust, so no rig has such a small range."""

GAIN_RANGE = (0.8, 1.25)
"""Range of settled measured over commanded speed; saturation and a sagging supply stay within it."""

AGREE = 1.25
"""Maximum ratio of two files' thrust: drift of gains and sag of supplies are smaller."""

USED = (0.25, 1.1)
"""Range of a campaign's largest thrust over the declared one, in the right unit."""

SOUND, LIFT, AIR = 340.0, 0.4, 1.225
"""m/s, largest thrust coefficient T / (rho n^2 D^4) of any static propeller, and kg/m^3: they give a rotor's minimum
diameter."""

FEWEST_MOVES, SAME_COMMAND, REPEATED = 3, 1e-3, 0.5
"""Minimum moves of a record whose commands are compared; tolerance of equal commands, as a share of their range; share of the
rows above which a record repeats another's commands. Random levels agree in no row."""

MARK = 0.025
"""Relative tolerance of the turns between a tachometer's values, from a given number, and between slow and fast rotation."""


@dataclass(frozen=True, eq=False)
class File:
    """One file of a campaign: its records (several for steps) or its steady points. `look`: preliminary fits, None with too few
    readings."""

    name: str
    where: str
    records: tuple[Record, ...] = ()
    static: StaticMap | None = None
    look: Look | None = None
    response: Response | None = None

    def column(self, name: str) -> np.ndarray:
        """All values of a column."""
        return getattr(self.static, name) if self.static is not None else np.concatenate([r[name] for r in self.records])


def files_of(campaign: Campaign, further: Mapping[str, Record]) -> list[File]:
    """The campaign's files and `further` records, each with a preliminary fit of its response."""
    named = {n: getattr(campaign, n) for n in ("open_loop", "repeat", "validation", "static_raw")} | dict(further)
    groups = {n: (r,) for n, r in named.items() if r is not None}
    if campaign.steps:
        groups["steps"] = campaign.steps
    found = [_steady(campaign.static)] if campaign.static is not None else []
    for name, records in groups.items():
        where, readings = records[0].source.partition(", run ")[0], sum(int(np.isfinite(r["thrust"]).sum()) for r in records)
        look = Look(records) if readings >= 20 and any(len(r) > 1 for r in records) else None
        found.append(File(name, where, records, None, look, look and look.response()))
    return found


def _steady(static: StaticMap) -> File:
    response = steady_response(static) if len(static.thrust) > 7 and np.ptp(static.thrust) > 0.0 else None
    return File("static", static.source, static=static, response=response)


def of_files(files: Sequence[File], rig: Rig) -> Iterator[Finding]:
    """All findings on the files, the most explanatory first."""
    units = [*_times(files), *_speeds(files), *_pitches(files), *_forces(files, rig)]
    yield from units
    yield from _copies(files)
    yield from _repeated(files)
    wrong = {f.code for f in units}
    if "time_unit" not in wrong:
        yield from _early(files)
    yield from _signs(files)
    yield from _speed_off(files, {f.where for f in units if f.code == "speed_unit"})
    yield from _not_logged(files)
    if not wrong & {"thrust_unit", "speed_unit", "pitch_unit"}:
        yield from _tares(files)
        yield from _beyond(files, rig)


def as_unit(ratio: float, units: Mapping[str, float]) -> tuple[str, bool] | None:
    """(unit, whether the numerator has it; else the denominator) if the ratio is that of a unit to the right one."""
    for name, factor in units.items():
        for forward, expected in ((True, factor), (False, 1.0 / factor)):
            if abs(np.log(ratio / expected)) < AS_UNIT:
                return name, forward
    return None


def _times(files: Sequence[File]) -> Iterator[Finding]:
    """A time column in another unit, from lags that no rotor has."""
    for file in files:
        if file.look is None or file.response.explained < FOLLOWS:
            continue
        lags, row = file.response.lags, file.response.row
        lag = max(lags.values()) * row
        slow, fast = lag > SLOWEST, 0.0 < lag < TIME_CONSTANTS[0] and max(lags.values()) > 5.0
        if slow:  # a drift may look like a lag: plausible lags must fit much worse
            slow = file.look.best(SLOWEST / row)[0] > BETTER * float(np.mean(file.response.left**2))
        if slow or fast:
            distance = {unit: abs(np.log(lag * size / USUAL)) for unit, size in TIMES.items()}
            unit = min(distance, key=distance.get)
            message = f"thrust has a lag of {lag:.3g} s, at a sampling period of {row:.3g} s"
            yield Finding("time_unit", file.where, "time", lag, "s", message, f"time in {unit}; then {lag * TIMES[unit]:.2g} s")


def _speeds(files: Sequence[File]) -> Iterator[Finding]:
    """Measured and commanded speed in different units, files in different units, and both in a wrong unit, from a mark's
    pulses."""
    for file in files:
        ratio = _ratio(file)
        # A constant command with a moving speed was not logged.
        found = speed_unit(ratio) if ratio is not None else None
        if found and (np.ptp(file.column("omega_ref")) > 0.0 or not pole_pairs(ratio)):
            message = f"measured speed is {ratio:.4g} times the commanded one"
            yield Finding("speed_unit", file.where, found[0], ratio, "1", message, found[2])
            continue
        turns = [t for r in file.records if (t := turns_a_value(r)) is not None]
        for unit in ("rad/s", "Hz"):
            if turns and abs(np.median(turns) / SPEEDS[unit] - 1.0) < MARK:
                value = float(np.median(turns))
                message = f"{value:.4f} turns from one measured value to the next; one mark gives 1"
                yield Finding("speed_unit", file.where, "omega", value, "1", message, f"omega and omega_ref both in {unit}")
    yield from _between(files, "omega_ref", SPEEDS, "speed_unit", lambda c: float(np.quantile(c, 0.95)))


def _ratio(file: File) -> float | None:
    """Measured over commanded speed of a file; None without measured speed."""
    if file.static is None and not all("omega" in r for r in file.records):
        return None
    return speed_ratio(file.column("omega"), file.column("omega_ref"))


def speed_ratio(omega: np.ndarray, command: np.ndarray) -> float | None:
    """Median of measured over commanded speed, each (n,) rpm, without commands near rest; None without any."""
    moving = np.isfinite(omega) & (command > 0.2 * command.max())
    with np.errstate(over="ignore"):  # a damaged command may be next to 0
        ratio = float(np.median(omega[moving] / command[moving])) if moving.any() else 0.0
    return ratio if 0.0 < ratio < np.inf else None


def speed_unit(ratio: float) -> tuple[str, str, str] | None:
    """(column, its unit, cause in words) if measured over commanded speed shows that one of both is no speed of the rotor in
    rpm; else None."""
    if pairs := pole_pairs(ratio):
        cause = f"electrical speed of a motor with {pairs} pole pairs"
        return "omega", f"erpm/{pairs}", f"{cause}, or deg/s" if pairs == SPEEDS["deg/s"] else cause
    if found := as_unit(ratio, SPEEDS):
        column = "omega" if found[1] else "omega_ref"
        return column, found[0], f"{column} in {found[0]}"
    return None


def pole_pairs(ratio: float) -> int | None:
    """Number of pole pairs if measured over commanded speed is that of an electrical speed; None if the ratio is no whole
    number, or is nearer to that of a unit."""
    pairs = round(ratio)
    if not POLE_PAIRS[0] <= pairs <= POLE_PAIRS[1] or abs(np.log(ratio / pairs)) > WHOLE:
        return None
    units = [size for factor in SPEEDS.values() for size in (factor, 1.0 / factor)]
    return pairs if all(abs(np.log(ratio / pairs)) <= abs(np.log(ratio / size)) for size in units) else None


def turns_a_value(record: Record) -> float | None:
    """Turns of the rotor from one new value of its speed to the next, computed from the speed; None if they differ between
    slow and fast rotation, for example if the logger renews the value instead of the mark.

    Only moving speeds count: settled ones may repeat a value.
    """
    if "omega" not in record or not (np.isfinite(record["omega"]).all() and record["omega"].min() > 0.0):
        return None
    first, _ = runs_of_equals(record["omega"])
    if len(first) < 50 or len(first) > 0.8 * len(record):
        return None
    time, shown = record.time[first], record["omega"][first]
    turned, change = np.diff(time) * shown[1:] / 60.0, np.abs(np.diff(shown))
    moving = change > np.quantile(change, 0.8)
    if not moving.any():
        return None
    moving &= turned < 1.7 * np.mean(turned[moving])  # after two turns the first had a repeated value
    quick = shown[1:] > np.median(shown[1:][moving])
    parts = [turned[moving & side] for side in (quick, ~quick)]
    if min(map(len, parts)) < 20 or np.mean(shown[1:][moving & quick]) < 1.2 * np.mean(shown[1:][moving & ~quick]):
        return None
    low, high = (float(np.mean(part)) for part in parts)
    return 0.5 * (low + high) if abs(low / high - 1.0) < 2.0 * MARK else None


def _between(
    files: Sequence[File], column: str, units: Mapping[str, float], code: str, size: Callable[[np.ndarray], float]
) -> Iterator[Finding]:
    """Files whose commands differ by the factor of a unit and have overlapping ranges after conversion: a small move in deg
    is not taken for rad."""
    for one, other in combinations(files, 2):
        sizes = [size(f.column(column)) for f in (one, other)]
        if min(sizes) <= 0.0 or not (found := as_unit(sizes[1] / sizes[0], units)):
            continue
        wrong, than = (other, one) if found[1] else (one, other)
        right = wrong.column(column) / units[found[0]]
        if right.min() > than.column(column).max() or right.max() < than.column(column).min():
            continue
        message = (
            f"{column} reaches {size(wrong.column(column)):.4g}, in {Path(than.where).name} {size(than.column(column)):.4g}"
        )
        ratio = size(wrong.column(column)) / size(than.column(column))
        yield Finding(code, wrong.where, column, ratio, "1", message, f"{column} in {found[0]}")


def _pitches(files: Sequence[File]) -> Iterator[Finding]:
    """Pitch in rad or as a share: by another file's range, or if a fraction of a degree gives all the thrust."""
    yield from _between(files, "beta_ref", {"rad": np.pi / 180.0}, "pitch_unit", lambda c: float(np.ptp(c)))
    for file in files:
        r = file.response
        if r is None or r.explained < FOLLOWS or r.rise("beta") is None:
            continue
        change, owed = r.owed_to_pitch()
        if owed < BETTER or abs(change) < SLOPE * r.size:  # a small move determines no slope
            continue
        ends = np.quantile(r.beta, [0.1, 0.9])
        away = float(np.max(np.abs(r.thrust)) * (ends[1] - ends[0]) / abs(change))
        if away < ONE_DEGREE:
            message = f"{ends[1] - ends[0]:.2g} deg change the thrust by {abs(change):.3g} N: all of it needs {away:.2g} deg"
            yield Finding("pitch_unit", file.where, "beta_ref", away, "deg", message, "pitch in rad, or a share of its travel")


def _forces(files: Sequence[File], rig: Rig) -> Iterator[Finding]:
    """Thrust in a wrong unit: compared with another file, with rig.json, and with the limit of any rotor. If all files agree
    and no range is declared, gf cannot be distinguished from N."""
    looked = [f for f in files if f.response is not None and f.response.explained > FOLLOWS]
    in_unit = set()
    for file in looked[1:]:
        if (gain := _gain(looked[0], file)) is None:
            continue
        first = Path(looked[0].where).name
        message = f"thrust is {gain:.4g} times that of {first} for the same commands"
        if found := as_unit(max(abs(gain), 1e-9), FORCES):
            in_unit.add(file.name)
            wrong = file if found[1] else looked[0]
            if wrong is not file:
                message = f"thrust is {1.0 / gain:.4g} times that of {Path(file.where).name} for the same commands"
            yield Finding("thrust_unit", wrong.where, "thrust", abs(gain), "1", message, f"thrust in {found[0]}")
        elif gain > 0.0 and abs(np.log(gain)) > np.log(AGREE):
            yield Finding("disagree", file.where, "thrust", gain, "1", message, "another calibration, propeller or supply")
    if rig.origin.get("thrust") == DECLARED:
        yield from _declared([f for f in files if f.name not in in_unit], max(map(abs, rig.thrust)))
    for file in looked:
        yield from _too_large(file, rig.rotor.get("diameter"))


def _declared(files: Sequence[File], declared: float) -> Iterator[Finding]:
    """Thrust in another unit than rig.json: far above the declared thrust, or below it by the factor of kgf.

    A campaign may use a part of the rig's range, so a unit is plausible if the share is then within USED.
    """
    for file in files:
        share = _most(file) / declared if declared > 0.0 else 0.0
        units = {unit: share / size for unit, size in FORCES.items() if USED[0] < share / size < USED[1]}
        if USED[0] < share < USED[1] or not units:
            continue
        unit = min(units, key=lambda u: abs(np.log(units[u])))
        message = f"thrust reaches {_most(file):.4g}, rig.json declares {declared:.4g} N"
        code = "thrust_unit" if share > 1.0 else "beyond_rig"  # a campaign may stay below the declared thrust
        yield Finding(code, file.where, "thrust", share, "1", message, f"thrust in {unit}")


def _gain(reference: File, file: File) -> float | None:
    """Thrust of a file over that of the reference at the same commands; None if they do not overlap, or do not determine it."""
    r = file.response
    inside = reference.response.span.holds(r.omega, r.beta)
    if inside.sum() < 10:
        return None
    expected, found = reference.response.at(r.omega[inside], r.beta[inside]), r.thrust[inside]
    if np.std(expected) < SLOPE * reference.response.size or abs(np.corrcoef(expected, found)[0, 1]) < np.sqrt(FOLLOWS):
        return None
    return float(found @ expected / (expected @ expected))


def _most(file: File) -> float:
    """Largest thrust without spikes, N."""
    thrust = file.column("thrust")
    thrust = np.abs(thrust[np.isfinite(thrust)])
    if not len(thrust):
        return 0.0
    return float(np.quantile(thrust, 0.999 if len(thrust) > 1000 else 1.0))


def least_diameter(file: File) -> tuple[float, float, float]:
    """(largest thrust [N], its speed [rpm], minimum diameter [m] of a rotor with this thrust)."""
    thrust, speed = file.column("thrust"), file.column("omega_ref")
    at = np.flatnonzero(np.abs(thrust) >= 0.98 * _most(file))
    force, rpm = _most(file), float(np.median(speed[at]))
    return force, rpm, (force / (LIFT * AIR * (rpm / 60.0) ** 2)) ** 0.25 if rpm > 0.0 else 0.0


def said_of_size(files: Sequence[File], diameter: float | None = None) -> list[str]:
    """The rotor that the files' thrust needs, and a request for its diameter unless the rig declares `diameter` [m]."""
    rotors = [least_diameter(f) for f in files if f.response is not None]
    if not rotors:
        return []
    force, rpm, least = max(rotors)
    ask = f"rig.json declares {diameter:g} m" if diameter else f'declare it: {FILE}, "rotor": {{"diameter": D}}, D in m'
    need = f"{force:.4g} N at {rpm:.4g} rpm need a rotor of {least:.2g} m or more"
    return [f"units: {need}; if yours is smaller, thrust is not in N ({ask})"]


def _too_large(file: File, diameter: float | None) -> Iterator[Finding]:
    """Thrust that needs a larger rotor than the declared one of `diameter` [m], or one with supersonic tips."""
    force, rpm, least = least_diameter(file)
    tip = np.pi * least * rpm / 60.0
    need = f"{force:.4g} N at {rpm:.4g} rpm need a rotor of {least:.2f} m"
    cause = "thrust in gf or mN, or a speed that is not in rpm"
    if diameter and least > diameter:
        yield Finding("thrust_unit", file.where, "thrust", least, "m", f"{need}, rig.json declares {diameter:g} m", cause)
    elif tip > SOUND:
        message = f"{need} with a tip speed of {tip:.0f} m/s"
        yield Finding("thrust_unit", file.where, "thrust", float(tip), "m/s", message, cause)


def _copies(files: Sequence[File]) -> Iterator[Finding]:
    """A record with the readings of another one."""
    single = [f for f in files if len(f.records) == 1]
    for one, other in combinations(single, 2):
        a, b = (f.records[0]["thrust"] for f in (one, other))
        rows = min(len(a), len(b))
        if rows > 20 and np.array_equal(a[:rows], b[:rows], equal_nan=True) and np.ptp(a[np.isfinite(a)]) > 0.0:
            message = f"all {rows} readings are those of {Path(one.where).name}"
            yield Finding("copied", other.where, "thrust", rows, "1", message, "the file was copied, not measured")


def _repeated(files: Sequence[File]) -> Iterator[Finding]:
    """A hold-out record with the commands of a fitted one. Both times count from the first move of a command."""
    unseen = next((f for f in files if f.name == "validation"), None)
    for other in files:
        if unseen is None or other is unseen or len(other.records) != 1:
            continue
        ours, theirs = unseen.records[0], other.records[0]
        starts, held = [], []
        for r in (ours, theirs):
            moves = np.flatnonzero((np.diff(r["omega_ref"]) != 0.0) | (np.diff(r["beta_ref"]) != 0.0))
            starts.append(r.time[moves[0] + 1] if len(moves) > FEWEST_MOVES else np.nan)
        at = ours.time - starts[0] + starts[1]
        both = (at >= theirs.time[0]) & (at <= theirs.time[-1])
        if not both.any():  # also if a command hardly moves
            continue
        row = np.searchsorted(theirs.time, at[both] + 0.5 * theirs.period, side="right") - 1
        for name in ("omega_ref", "beta_ref"):
            digit = SAME_COMMAND * max(np.ptp(ours[name]), 1e-9)
            held.append(np.abs(ours[name][both] - theirs[name][row]) <= digit)
        share = float(np.sum(held[0] & held[1])) / len(ours)
        if share > REPEATED:
            message = f"{share:.0%} of its commands are those of {Path(other.where).name}, row by row"
            yield Finding(
                "seen_commands", unseen.where, "omega_ref and beta_ref", share, "1", message, "a repeat, not unseen data"
            )


def _early(files: Sequence[File]) -> Iterator[Finding]:
    """Commands that are logged later than their effects."""
    for file in files:
        r = file.response
        if file.look is None or r.explained < FOLLOWS or not any(r.lags.values()):
            continue
        errors = {}
        for early in (0, *(2**k for k in range(9) if 2**k <= 2.0 * max(r.lags.values()))):
            lags = ({u: scale * lag for u, lag in r.lags.items()} for scale in (0.5, 0.7, 1.0, 1.4))
            errors[early] = min(file.look.fit(each, early)[0] for each in lags)
        rows = min(errors, key=errors.get)
        if BETTER * errors[rows] < errors[0]:
            message = f"thrust begins to move about {rows * r.row:.3g} s before its command"
            cause = "commands logged late, or columns from different clocks"
            yield Finding("early", file.where, "time", rows * r.row, "s", message, cause)


def _signs(files: Sequence[File]) -> Iterator[Finding]:
    """Wrong sign of thrust or pitch."""
    for file in files:
        r = file.response
        if r is None or r.explained < FOLLOWS:
            continue
        pitch, speed, mean = r.rise("beta"), r.rise("omega"), float(np.mean(r.thrust))
        if pitch is not None:
            change, owed = r.owed_to_pitch()
            pitch = change if owed > BETTER else 0.0
        negative = mean < -SLOPE * r.size
        if pitch is not None and pitch < -SLOPE * r.size:
            message = f"thrust changes by {pitch:+.3g} N from low to high pitch, and is {mean:.3g} N on average"
            if mean > SLOPE * r.size:
                cause = "pitch counts the other way, or the blades are mounted in reverse"
                yield Finding("pitch_sign", file.where, "beta_ref", pitch, "N", message, cause)
            else:
                cause = "thrust counts downwards" if negative else "thrust or pitch counts the other way"
                yield Finding("thrust_sign", file.where, "thrust", pitch, "N", message, cause)
        elif (pitch is None or abs(pitch) < SLOPE * r.size) and negative and speed is not None and speed < -SLOPE * r.size:
            message = f"thrust changes by {speed:+.3g} N from low to high speed, and is {mean:.3g} N on average"
            yield Finding("thrust_sign", file.where, "thrust", speed, "N", message, "thrust counts downwards")


def _speed_off(files: Sequence[File], known: set[str]) -> Iterator[Finding]:
    """A measured speed that is inconsistent with its command."""
    for file in files:
        ratio = _ratio(file)
        if ratio is None or file.where in known:
            continue
        omega, command = file.column("omega"), file.column("omega_ref")
        seen = np.isfinite(omega)
        together = np.corrcoef(omega[seen], command[seen])[0, 1] if min(np.ptp(omega[seen]), np.ptp(command)) > 0.0 else 1.0
        if not GAIN_RANGE[0] < ratio < GAIN_RANGE[1]:
            message = f"measured speed is {ratio:.4g} of the commanded one"
            cause = "a wrong number of marks or pole pairs, or a command that is no speed"
            yield Finding("speed_off", file.where, "omega", ratio, "1", message, cause)
        elif together < np.sqrt(FOLLOWS) and file.static is None and _slower(file):
            message = f"the correlation of measured and commanded speed is {together:.2f}"
            cause = "another run's column, or a speed that the motor can't hold"
            yield Finding("speed_off", file.where, "omega", float(together), "1", message, cause)


def _slower(file: File) -> bool:
    """Whether no lag of the command explains the measured speed."""
    with_speed = [r.with_columns(thrust=r["omega"], beta_ref=np.zeros(len(r))) for r in file.records]
    return Look(with_speed).response().explained < FOLLOWS


def _not_logged(files: Sequence[File]) -> Iterator[Finding]:
    """A constant command whose measured value moves."""
    for file in files:
        for channel, unit in (("omega", "rpm"), ("beta", "deg")):
            if file.static is not None or not all(channel in r for r in file.records):
                continue
            command, shown = file.column(f"{channel}_ref"), file.column(channel)
            shown = shown[np.isfinite(shown)]
            if len(shown) < 20 or np.ptp(command) > 0.0:
                continue
            low, high = np.quantile(shown, [0.02, 0.98])
            if high - low > AS_UNIT * max(abs(low), abs(high)):
                message = f"it is constant at {command[0]:.4g} {unit} while {channel} runs from {low:.4g} to {high:.4g} {unit}"
                field, moved = f"{channel}_ref", float(high - low)
                other = file.column("beta_ref" if channel == "omega" else "omega_ref")
                code = "not_logged" if np.ptp(other) > 0.0 else "no_commands"
                yield Finding(code, file.where, field, moved, unit, message, "the command was not logged")


def _tares(files: Sequence[File]) -> Iterator[Finding]:
    """An offset of the thrust reading: at rest, of the steady points extrapolated to zero speed, or between files."""
    largest = max((_most(f) for f in files), default=0.0)
    for file in files:
        for record in file.records:
            zero, move = tare(record), moved(record)
            if move is None and zero is not None and abs(zero.mean) > max(OFFSET * largest, FAR * zero.error):
                message = f"{zero.mean:+.3g} N at rest ({100 * abs(zero.mean) / largest:.2g} % of the largest thrust)"
                yield Finding("tare", record.source, "thrust", zero.mean, "N", message, "the sensor was not tared")
            if move is not None:
                by, ends = move.last.mean - move.first.mean, f"{move.first.text}, {move.last.text}"
                code, how = (
                    ("zero_drift", "gradually") if move.jump is None else ("zero_jump", f"at {record.time[move.jump]:.2f} s")
                )
                cause = "a cold amplifier, or warm air" if move.jump is None else "a knock, or a loose cell"
                message = f"the reading at rest moves by {by:+.3g} N, {how} ({ends})"
                yield Finding(code, record.source, "thrust", by, "N", message, cause)
    steady = next((f for f in files if f.static is not None and f.response is not None), None)
    if steady is not None:
        offset, std = _at_no_speed(steady)
        if abs(offset) > max(OFFSET * largest, FAR * std):
            message = f"thrust is {offset:+.3g} ± {std:.1g} N, extrapolated to zero speed"
            yield Finding("tare", steady.where, "thrust", offset, "N", message, "the sensor was not tared")
    by_name = {f.name: f for f in files}
    if {"open_loop", "repeat"} <= set(by_name):
        yield from _shifted(by_name["open_loop"], by_name["repeat"], largest)


def _at_no_speed(file: File) -> tuple[float, float]:
    """(thrust [N] at zero speed, its standard deviation) from all terms of the map and one in w, unweighted."""
    static, r = file.static, file.response
    a = np.column_stack([r.span.columns(static.omega, static.beta_ref), static.omega / r.span.speed[1]])
    if len(a) < a.shape[1] + 5 or np.linalg.matrix_rank(a, tol=1e-6 * np.linalg.norm(a, 2)) < a.shape[1]:
        return 0.0, np.inf
    found = np.linalg.lstsq(a, static.thrust, rcond=None)[0]
    residual = static.thrust - a @ found
    variance = np.linalg.inv(a.T @ a)[0, 0] * float(residual @ residual) / (len(a) - a.shape[1])
    return float(found[0]), float(np.sqrt(variance))


def _shifted(first: File, again: File, largest: float) -> Iterator[Finding]:
    """An offset between two records of the same commands."""
    a, b = first.records[0]["thrust"], again.records[0]["thrust"]
    rows = min(len(a), len(b))
    difference = (b[:rows] - a[:rows])[np.isfinite(a[:rows]) & np.isfinite(b[:rows])]
    if len(difference) < 200:
        return
    means = np.array([part.mean() for part in np.array_split(difference, 20)])
    shift, std = float(means.mean()), float(means.std(ddof=1) / np.sqrt(20))
    if abs(shift) > max(OFFSET * largest, FAR * std):
        message = f"thrust differs by {shift:+.3g} ± {std:.1g} N from that of {Path(first.where).name} for the same commands"
        yield Finding("tare", again.where, "thrust", shift, "N", message, "a tare that changed, or a sensor that drifts")


def _beyond(files: Sequence[File], rig: Rig) -> Iterator[Finding]:
    """Commands and readings outside the ranges of rig.json."""
    for name, signal in RANGES.items():
        if rig.origin.get(name) != DECLARED:
            continue
        (low, high), column, unit = getattr(rig, name), signal.name, signal.unit
        reach = (0.1 if name == "thrust" else 0.01) * max(high - low, 1e-6 * max(abs(low), abs(high)))
        for file in files:
            values = file.column(column)
            ends = np.quantile(values[np.isfinite(values)], [0.001, 0.999] if name == "thrust" else [0.0, 1.0])
            if ends[0] < low - reach or ends[1] > high + reach:
                worst = float(ends[1] if ends[1] - high > low - ends[0] else ends[0])
                message = f"{column} runs from {ends[0]:.4g} to {ends[1]:.4g} {unit}, rig.json declares {low:.4g} to {high:.4g}"
                cause = "another rig's file, or a rig.json that is out of date"
                yield Finding("beyond_rig", file.where, column, worst, unit, message, cause)
