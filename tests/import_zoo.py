"""Logs in the forms of other people, written by code that shares nothing with the importer, and what becomes of each.

A form is imported by its words, or refused in one line; the words of the refusal then import it.
"""

import csv
import datetime
import gzip
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

ROWS, STEP = 400, 0.01
"""Rows of the data, and s between them."""

G, TURN = 9.80665, np.pi / 30.0
"""m/s^2; rad/s in a rpm."""

START = datetime.datetime(2024, 5, 31, 23, 59, 58, 250000)
"""Date of time 0: a month ends two seconds later."""

Log = Mapping[str, np.ndarray]


def truth() -> dict[str, np.ndarray]:
    """A log in a record's units, each (ROWS,): held commands, noisy readings, a voltage that sags."""
    rng = np.random.default_rng(16)
    time = np.round(STEP * np.arange(ROWS), 6)
    omega_ref = np.repeat(rng.integers(2000, 6000, 8).astype(float), 50)
    beta_ref = np.repeat(np.round(rng.uniform(-4.0, 9.0, 16), 2), 25)
    omega = np.round(omega_ref + rng.normal(0.0, 5.0, ROWS), 3)
    thrust = np.round(12.0 * (omega / 6000.0) ** 2 + 0.3 * beta_ref + rng.normal(0.0, 0.05, ROWS), 5)
    voltage = np.round(23.1 - 0.2 * time, 4)
    return {"time": time, "omega_ref": omega_ref, "beta_ref": beta_ref, "omega": omega, "thrust": thrust, "voltage": voltage}


T = truth()
UNITS = dict(zip(T, ("s", "rpm", "deg", "rpm", "N", "V"), strict=True))
PLAIN = {name: name for name in T}
OWN = ("--map", *(f"{name}={name}:{unit}" for name, unit in UNITS.items()))
BARE = dict(zip(T, ("t", "speed cmd", "pitch cmd", "speed", "Fz", "Vbat"), strict=True))
HEADERS = {name: f"{text} [{UNITS[name]}]" for name, text in BARE.items()}


def named(*names, **more):
    """Columns of the data under headers with their units; `more`: further columns, or others in their place."""
    return {HEADERS[name]: T[name] for name in names} | more


def table(path, columns, delimiter=","):
    """Columns as text, by the csv module; NaN is an empty cell."""
    with open(path, "w", newline="") as file:
        writer = csv.writer(file, delimiter=delimiter)
        writer.writerow(columns)
        for row in zip(*(np.asarray(c).tolist() for c in columns.values()), strict=True):
            writer.writerow("" if str(v) == "nan" else v for v in row)
    return path


def lagged(commands, step, lag):
    """(n,) a held command behind one lag, exactly: a row is measured before its command acts."""
    kept, out = np.exp(-step / lag), np.empty(len(commands))
    out[0] = commands[0]
    for k in range(1, len(commands)):
        out[k] = commands[k - 1] + kept * (out[k - 1] - commands[k - 1])
    return out


def stand(rows=6000, step=0.01, hold=1.5, lag=0.12, seed=5):
    """A thrust stand of fixed pitch: signal [us], speed [rpm] from a parabola and one lag, thrust [gf]."""
    rng = np.random.default_rng(seed)
    time = np.round(step * np.arange(rows), 6)
    signal = np.repeat(rng.integers(1150, 1900, rows), round(hold / step))[:rows].astype(float)
    speed = lagged(200.0 + 9.5 * (signal - 1000.0) - 0.0025 * (signal - 1000.0) ** 2, step, lag)
    thrust = 8.0 * (speed / 6000.0) ** 2 / 9.80665e-3 + rng.normal(0.0, 5.0, rows)
    return {"Time (s)": time, "ESC (us)": signal, "RPM": np.round(speed), "Thrust (gf)": np.round(thrust, 1)}


@dataclass(frozen=True)
class Form:
    """A way to write the data: `write(path)`, or columns. `refused`: parts of the refusal of the import by `words`. `by`: the
    columns that a record must have, by the words that import it (default: the data, by no words). `said`: words of the output.
    `time`, `rest`: tolerances of time [s] and of other columns (relative to their largest value), from the digits written."""

    write: Callable[[Path], object] | Mapping
    by: Mapping[Sequence[str], Log] = field(default_factory=dict)
    refused: Sequence[str] = ()
    words: Sequence[str] = ()
    said: Sequence[str] = ()
    file: str = "log.csv"
    time: float = 1e-9
    rest: float = 1e-8

    @property
    def imports(self) -> Mapping[Sequence[str], Log]:
        """Columns that a record must have, by the words that import it."""
        return self.by if self.by or self.refused else {(): T}

    def written(self, folder: Path) -> Path:
        """The log, in a folder."""
        path = folder / self.file
        table(path, self.write) if isinstance(self.write, Mapping) else self.write(path)
        return path

    def check(self, record: Mapping[str, np.ndarray], expected: Log) -> None:
        """The record has these columns, and no others if they are those of the data."""
        assert expected is not T or set(record) == set(T)
        for name, values in expected.items():
            atol = self.time if name == "time" else self.rest * np.nanmax(np.abs(values))
            np.testing.assert_allclose(record[name], values, rtol=1e-15, atol=atol, err_msg=name)


def text(
    names=HEADERS,
    delimiter=",",
    decimal=".",
    head=(),
    under=(),
    end="\n",
    encoding="utf-8",
    mark=b"",
    factors=None,
    digits=".10g",
    cells=None,
    lines=lambda rows: rows,
    **changed,
):
    """A writer of text. `factors`: from a record's unit to the file's; `cells`: how quantities are written, else as numbers;
    `changed`: columns in place of the data's."""
    factors, cells = factors or {}, cells or {}

    def cell(name, value):
        if name in cells:
            return cells[name](value)
        return "" if np.isnan(value) else f"{value * factors.get(name, 1.0):{digits}}".replace(".", decimal)

    def write(path):
        columns = [(T | changed).get(name, T["time"]) for name in names]
        rows = [delimiter.join(map(cell, names, row)) for row in zip(*columns, strict=True)]
        titles = [delimiter.join(names.values())] if any(names.values()) else []
        content = end.join([*head, *titles, *map(delimiter.join, under), *lines(rows)]) + end
        path.write_bytes(mark + content.encode(encoding))

    return write


def raw(data: bytes):
    """A writer of bytes."""
    return lambda path: path.write_bytes(data)


def stamped(form: str, cut: int = 6) -> Callable[[float], str]:
    """A time of a calendar, to so many digits of a second."""

    def cell(seconds: float) -> str:
        moment = START + datetime.timedelta(microseconds=round(1e6 * seconds))
        return moment.strftime(form).replace("%f", f"{moment.microsecond:06d}"[:cut])

    return cell


def grouped(digits: int, group: str, decimal: str, *names, factor=1.0) -> dict[str, Callable[[float], str]]:
    """Cells with a separator of thousands."""
    marks = str.maketrans(",.", group + decimal)
    return dict.fromkeys(names, lambda v: f"{factor * v:,.{digits}f}".translate(marks))


def also(place: int, row: str):
    """Rows with one more."""
    return lambda rows: [*rows[:place], row, *rows[place:]]


def own(**columns: str) -> Sequence[str]:
    """OWN with other columns."""
    return ("--map", *(f"{n}={columns.get(n, f'{n}:{unit}')}" for n, unit in UNITS.items()))


def _texts() -> dict[str, Form]:
    units, comma, words = [*UNITS.values()], {"delimiter": ";", "decimal": ","}, ()
    german = ("Zeit [s]", "Solldrehzahl [U/min]", "Soll-Pitch [°]", "Istdrehzahl [U/min]", "Schub [N]", "Spannung [V]")
    cells = {n: lambda v, n=n: f'"{n}": {v:.10g}' for n in T}
    paired = {n: lambda v, n=n: f"{n}: {v:.10g} {UNITS[n]}" for n in T}
    nameless, holes = dict.fromkeys(T, ""), np.where(np.arange(ROWS) % 7, T["thrust"], np.nan)
    whole = grouped(0, ".", ",", "time", "thrust", "voltage", factor=1e3) | grouped(0, ".", ",", "omega_ref")
    labview = ["LabVIEW Measurement", "Separator\tTab", "***End_of_Header***", "Samples" + 6 * "\t400"]
    labview += ["\t".join(["Y_Unit_Label", *units[1:], ""]), "X_Dimension\tTime"]
    timeless = {n: h for n, h in HEADERS.items() if n != "time"}
    monitor = {"lines": lambda rows: [f"{stamped('%T.%%f', 3)(STEP * k)} -> {row}" for k, row in enumerate(rows, -1)]}
    radians = {"omega": TURN, "omega_ref": TURN, "thrust": 1e3 / G, "beta_ref": np.pi / 180}
    return {
        "own names": Form(text(PLAIN), {OWN: T}),
        "units in the names": Form(text()),
        "semicolon, decimal comma": Form(text(**comma), said=["decimal comma"]),
        "tab, decimal comma": Form(text(delimiter="\t", decimal=",")),
        "spaces": Form(text(PLAIN, delimiter="   "), {OWN: T}),
        "spaces, units torn from names": Form(text({n: f"{n} [{u}]" for n, u in UNITS.items()}, " ")),
        "quoted": Form(text({n: f'"{h}"' for n, h in HEADERS.items()}, cells={n: lambda v: f'"{v:.10g}"' for n in T})),
        "Excel's sep=": Form(text(head=["sep=;"], **comma)),
        "units in brackets, decimal comma": Form(text(BARE, under=[[f"[{u}]" for u in units]], **comma)),
        "an empty column, - for its unit": Form(
            text(BARE | {"note": "note"}, under=[[*units, "-"]], cells={"note": lambda v: ""})
        ),
        "numpy's savetxt": Form(text({**PLAIN, "time": "# time"}, " ", digits=".18e"), {OWN: T}),
        "comments": Form(text(head=["# stand 3", "% by hand", "// no wind"], lines=also(50, "# knock"))),
        "a preamble": Form(text(head=["Logger,V2.1", "Serial: 17", "", "Operator,Smith, J."])),
        "no names": Form(text(nameless), {own(**{n: f"{k}:{UNITS[n]}" for k, n in enumerate(T, 1)}): T}),
        "names once more": Form(text(lines=also(200, ",".join(HEADERS.values()))), said=["names once more 1"]),
        "a name before each value, units behind it": Form(
            text(nameless, " ", head=["Booting...", "ready: 1"], cells=paired), said=["lines without these values 2"]
        ),
        "JSON lines": Form(text(nameless, ", ", cells=cells, lines=lambda rows: [f"{{{row}}}" for row in rows]), {OWN: T}),
        "LabVIEW, counts and units above the names": Form(
            text(BARE | {"note": "Comment"}, "\t", head=labview, cells={"note": lambda v: ""}), file="log.lvm"
        ),
        "a serial monitor's time before each row": Form(
            text(dict.fromkeys(timeless, ""), head=[",".join(timeless.values())], **monitor), said=["midnight"]
        ),
        "cut off in the last row": Form(text(lines=also(ROWS, "4.0,3000,2")), said=["cut off at the end 1"]),
        "R's write.table": Form(
            text(
                {n: f'"{h}"' for n, h in HEADERS.items()}, " ", lines=lambda rows: [f'"{k}" {r}' for k, r in enumerate(rows, 1)]
            )
        ),
        "a comma at each end": Form(text({**HEADERS, "voltage": "Vbat [V],"}, cells={"voltage": lambda v: f"{v:.10g},"})),
        "an index of dates without a name": Form(text({**HEADERS, "time": ""}, cells={"time": stamped("%F %T.%%f")})),
        "durations": Form(text({**HEADERS, "time": "t"}, cells={"time": lambda s: f"0 days 00:00:{s:09.6f}"})),
        "UTF-8 with mark, CRLF": Form(text(mark=b"\xef\xbb\xbf", end="\r\n")),
        "UTF-16 LE": Form(text(mark=b"\xff\xfe", encoding="utf-16-le", delimiter="\t", end="\r\n")),
        "UTF-16 LE without a mark": Form(text(encoding="utf-16-le")),
        "Latin-1, umlauts and degrees": Form(text(dict(zip(T, german, strict=True)), encoding="latin-1", **comma)),
        "lines ended by CR": Form(text(end="\r")),
        "1.234,56": Form(text(cells=grouped(6, ".", ",", "omega", "omega_ref", "thrust"), **comma), rest=1e-6),
        "thousands with a point, in most cells": Form(
            text(PLAIN | {"time": "time_ms", "thrust": "thrust_mN", "voltage": "voltage_mV"}, cells=whole, **comma),
            {("--yes",): T},
            said=("decimal comma",),
            rest=1e-4,
        ),
        "Fortran's exponents": Form(text(cells={n: lambda v: f"{v:.9E}".replace("E", "D") for n in T})),
        "a row too long": Form(text(lines=also(100, "1,2,3,4,5,6,7,8")), said=("damaged (line 102)",)),
        "a bad byte in a number": Form(
            text(lines=also(100, "0.99,29\xb20,1,2900,3,22"), encoding="cp1252"), said=("damaged (line 102)",)
        ),
        "power-up garbage before the names": Form(
            text(mark=b"\xf8\xff\0\x9612.5,3.1\n3,4100.0\n"), said=("lines before the table 2", "text in utf-8")
        ),
        "NA for no value": Form(
            text(thrust=holes, cells={"thrust": lambda v: "NA" if np.isnan(v) else f"{v:.10g}"}), {words: T | {"thrust": holes}}
        ),
        "rad/s, gf, rad": Form(
            text(PLAIN, factors=radians),
            {own(omega="omega:rad/s", omega_ref="omega_ref:rad/s", thrust="thrust:gf", beta_ref="beta_ref:rad"): T},
        ),
        "thrust downwards": Form(
            text(factors={"thrust": -1e3 / G}, names={**HEADERS, "thrust": "Fz (gf)"}),
            {own(**{n: f"{k}:{UNITS[n] if n != 'thrust' else '-1 gf'}" for k, n in enumerate(T, 1)}): T},
        ),
    }


def epoch(seconds: float) -> int:
    """Microseconds since 1970."""
    return round(1e6 * START.replace(tzinfo=datetime.timezone.utc).timestamp()) + round(1e6 * seconds)


def _clocks() -> dict[str, Form]:
    def timed(cell, unit="", said=(), time=1e-9, **options):
        written = text({**PLAIN, "time": "stamp"}, cells={"time": cell}, **options)
        return Form(written, {own(time=f"stamp{unit}"): T}, said=said, time=time)

    back = T["time"].copy()
    back[[80, 180, 280]] = back[[79, 179, 279]] - 0.004
    timeless = {n: n for n in T if n != "time"}
    return {
        "minutes, first one not 0": timed(lambda s: f"{(s + 754.3) / 60.0:.10f}", ":min", time=1e-7),
        "since 1970, ns": timed(lambda s: f"{epoch(s)}000", ":ns", time=1e-6),
        "ISO, Z": timed(stamped("%Y-%m-%dT%H:%M:%S.%%fZ")),
        "ISO, offset, blank": timed(stamped("%Y-%m-%d %H:%M:%S.%%f+02:00", 3), ":iso"),
        "31.05.2024 23:59:58,250": timed(stamped("%d.%m.%Y %H:%M:%S,%%f", 3), delimiter=";", decimal=","),
        "05/31/2024 11:59:58.250 PM": timed(stamped("%m/%d/%Y %I:%M:%S.%%f %p", 3)),
        "time of day over midnight": timed(stamped("%H:%M:%S.%%f", 3), said=["midnight"]),
        "minutes over an hour": timed(
            lambda s: f"{(3598.5 + s) // 60 % 60:02.0f}:{(3598.5 + s) % 60:06.3f}",
            said=["each after 3600 s (an hour): unwrapped"],
        ),
        "whole seconds for 100 rows": timed(stamped("%Y-%m-%d %H:%M:%S"), said=["spread evenly"], time=0.011),
        "a 32-bit counter of us, begun anew": timed(
            lambda s: str((2**32 - 1_500_000 + round(1e6 * s)) % 2**32), ":us", ["unwrapped"]
        ),
        "no time: rows 10 ms apart": Form(text(timeless), {own(time="row:10ms"): T}),
        "goes back by 4 ms in 3 rows": Form(text(time=back), said=["goes back in 3 of 400 rows, by 4 ms"], time=0.0101),
        "each tenth row twice": Form(
            text(lines=lambda r: [x for k, row in enumerate(r) for x in [row] * (1 + (k % 10 == 5))]),
            said=["40 rows at the time of the next one"],
        ),
    }


def _containers() -> dict[str, Form]:
    def parquet(path, stamp=False):
        import pyarrow as pa
        import pyarrow.parquet as pq

        if stamp:
            time = np.datetime64(START, "us") + np.round(1e6 * T["time"]).astype("timedelta64[us]")
            return pq.write_table(pa.table(T | {"time": time}), path)
        told = UNITS | {"omega_ref": "rad/s", "omega": "rad/s", "thrust": "kgf"}
        schema = pa.schema([pa.field(n, pa.float64(), metadata={"unit": u}) for n, u in told.items()])
        other = {"omega_ref": T["omega_ref"] * TURN, "omega": T["omega"] * TURN, "thrust": T["thrust"] / G}
        return pq.write_table(pa.table(T | other, schema=schema), path)

    def mat(path):
        from scipy.io import savemat

        savemat(path, {"log": {name: column[:, None] for name, column in T.items()}, "fs": 100.0, "note": "stand 3"})

    def mat73(path):
        """As MATLAB lays it out: a head of 512 bytes, then HDF5."""
        import h5py

        with h5py.File(path, "w", userblock_size=512) as file:
            for name, column in T.items():
                file.create_dataset(f"run/{name}", data=column[None, :]).attrs["MATLAB_class"] = np.bytes_("double")
            note = file.create_dataset("note", data=np.frombuffer("stand".encode("utf-16-le"), np.uint16)[:, None])
            note.attrs["MATLAB_class"] = np.bytes_("char")
        with open(path, "r+b") as file:
            file.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\x00\x02IM")

    def hdf5(path, form):
        import h5py

        with h5py.File(path, "w") as file:
            if form == "vectors":
                for name, column in T.items():
                    scale, unit = {"time": (1e3, "ms"), "thrust": (1e3 / G, "gf")}.get(name, (1.0, UNITS[name]))
                    file.create_dataset(name, data=column * scale).attrs["units"] = unit
            elif form == "matrix":
                table = file.create_dataset("table", data=np.column_stack([*T.values()]))
                table.attrs["columns"] = [name.encode() for name in T]
            else:
                file.create_dataset("log", data=np.array([*zip(*T.values(), strict=True)], [(name, float) for name in T]))

    return {
        "Parquet, timestamps": Form(lambda path: parquet(path, True), {own(time="time:iso"): T}),
        "Parquet, units in its schema": Form(parquet),
        "MAT v5, a struct": Form(mat, {OWN: T}),
        "HDF5 as MAT v7.3": Form(mat73, {OWN: T}),
        "HDF5, vectors with units": Form(lambda path: hdf5(path, "vectors")),
        "HDF5, a matrix": Form(lambda path: hdf5(path, "matrix"), {OWN: T}),
        "HDF5, a compound": Form(lambda path: hdf5(path, "compound"), {OWN: T}),
        "half a Parquet file": Form(raw(b"PAR1" + bytes(100)), refused=["Parquet that its library does not read"]),
        "half a MAT file": Form(raw(b"MATLAB 5.0 MAT-file, Platform: GLNXA64".ljust(128) + bytes(64)), refused=["MAT"]),
        "half an HDF5 file": Form(raw(b"\x89HDF\r\n\x1a\n" + bytes(64)), refused=["HDF5"]),
    }


def _unreadable() -> dict[str, Form]:
    ambiguous = grouped(0, ".", ",", "omega", "omega_ref")
    ambiguous |= {n: lambda v: f"{1.5 + v % 8:.3f}".replace(".", ",") for n in ("time", "beta_ref", "thrust", "voltage")}
    two_units = text(cells={"thrust": lambda v: f"{v:.3f} N" if round(1e3 * v) % 2 else f"{1e3 * v:.0f} mN"})
    forms = {
        "a workbook": (raw(b"PK\x03\x04" + bytes(200)), "a workbook or another ZIP archive", "one table of it saved as CSV"),
        "bytes": (raw(bytes(range(256)) * 20), "no text"),
        "empty": (raw(b""), "0 lines of comments"),
        "prose": (raw(b"On the first day the rotor broke.\nOn the second day too.\n"), "2 lines without numbers"),
        "one row": (raw(b"t,n\n1,2\n"), "1 row of numbers"),
        "comma for both": (text(decimal=","), "a comma can't separate cells and mark decimals"),
        "two marks that may separate thousands": (text(PLAIN, ";", cells=ambiguous), "--decimal comma, or --decimal point"),
        "two units in one column": (two_units, "no column of it"),
        "many rows too long": (text(lines=lambda rows: [*rows, *["1,2,3,4,5,6,7,8"] * 6]), "at most 1 % damaged"),
        "the names again in another order": (
            text(PLAIN, lines=also(100, ",".join(reversed(PLAIN)))),
            "line 102: found the names again",
        ),
        "a bell in a name": (text({**HEADERS, "omega": "speed\a"}), "line 1, column 4", "a name of printable characters"),
        "back by a second": (
            text(time=np.where(np.arange(ROWS) < 200, T["time"], T["time"] - 1.0)),
            "line 202: found 1.0 after 1.99, back by 0.99",
        ),
        "no thrust": (named("time", "omega_ref"), "thrust: found no column"),
        "no time": (named("omega_ref", "thrust"), "time: found no column", "time=row:4ms"),
        "no command": (named("time", "omega", "thrust"), "command of speed"),
    }
    return {name: Form(write, refused=parts) for name, (write, *parts) in forms.items()}


S, SPEED = stand(), np.array([200.0, 9.5, -0.0025])
"""A log with a signal and no command, and the speed of its motor by powers of (signal - 1000 us)."""

PULSES = np.round(1000.0 + (T["beta_ref"] + 5.0) / 0.015)
"""us: -5 deg at 1000, 10 deg at 2000."""

COUNTS = np.round(84213.0 - T["thrust"] / 0.0021)
SWAPPED = np.r_[0:200, 204:208, 200:204, 208:400]
TWO = {"rpm_cmd": "omega_ref", "pitch_cmd": "beta_ref", "thrust": "thrust", "rpm": "omega"}
YES, FIXED, TWO_DEG = ("--yes",), ("--fixed", "beta_ref=2:deg"), {"beta_ref": np.full(ROWS, 2.0)}
COMMON = ("time", "omega_ref", "beta_ref")


def of(*names, gain=1.0):
    """Columns that the record must have."""
    return {name: gain * T[name] for name in names}


def by_map(column: str) -> Sequence[str]:
    return ("--map", column)


def _doubtful() -> dict[str, Form]:
    """Columns, parts of the refusal, and records by the words that import them."""
    pulses = {"beta_ref": 0.015 * PULSES - 20.0}
    messages = {HEADERS[n]: np.repeat(T[n], 2) for n in (*COMMON, "omega", "thrust")}
    messages["t [s]"][1::2] += 0.005
    messages["Fz [N]"][1::2] = messages["speed [rpm]"][::2] = np.nan
    rotors = {"time (s)": T["time"]} | {f"{h}_{k}": g * T[n] for k, g in (("left", 1.0), ("b", 0.9)) for h, n in TWO.items()}
    rotors = {h.replace("_b", "_right"): c for h, c in rotors.items()}
    quiet = {"step": np.arange(ROWS) // 25, "temp [degC]": np.arange(ROWS) % 3, "RPM set": T["omega_ref"]}
    throttle = {"time_ms": 1e3 * S["Time (s)"], "throttle_%": S["ESC (us)"] / 10.0 - 100.0, "thrust_g": S["Thrust (gf)"]}
    electrical = {n: c for n, c in S.items() if n != "RPM"} | {"Motor speed (erpm)": 7.0 * S["RPM"]}
    measured = tuple(word.replace("beta_ref", "beta") for word in OWN)
    cases = {
        "units are guessed": (
            {"t": T["time"], "speed_cmd": T["omega_ref"], "pitch_cmd": T["beta_ref"], "force_n": T["thrust"]},
            ("force_n as thrust in N", "Try: --yes to take these units"),
            {YES: of(*COMMON, "thrust")},
        ),
        "omega in rad/s": (
            named("time", "thrust", omega_cmd=T["omega_ref"] * TURN),
            ("omega_cmd as omega_ref in rad/s",),
            {YES: of("omega_ref")},
        ),
        "omega faster than a rotor": (
            named("time", "thrust", omega_cmd=T["omega_ref"]),
            ("omega_cmd as omega_ref in rpm",),
            {},
        ),
        "a pitch below a degree": (
            named("time", "omega_ref", "thrust", pitch_cmd=np.radians(T["beta_ref"])),
            ("pitch_cmd as beta_ref in rad",),
            {YES: of("beta_ref")},
        ),
        "a throttle in per cent": (
            throttle | {"rpm": S["RPM"]},
            ("throttle_% as signal in %",),
            {YES: {"thrust": 9.80665e-3 * S["Thrust (gf)"], "omega": S["RPM"]}},
        ),
        **{
            f"a load cell in counts, {header}": (
                named(*COMMON, **{header: COUNTS}),
                (f"thrust: found {header}, thrust by its name, from {COUNTS.min():g} to {COUNTS.max():g}", "@A=0,B=10"),
                {by_map(f"thrust={header}:{unit}@84213=0,79213=10.5"): {"thrust": 0.0021 * (84213.0 - COUNTS)}},
            )
            for header, unit in (("load cell (mV)", "mV"), ("loadcell_raw", ""), ("force counts", ""))
        },
        "two load cells": (
            named(*COMMON, **{"F left [N]": 0.25 * T["thrust"], "F right [N]": 0.75 * T["thrust"]}),
            ("F left [N], F right [N], and one speed, expected one thrust",),
            {by_map("thrust=F left+F right"): of("thrust"), by_map("thrust=F left"): of("thrust", gain=0.25)},
        ),
        "two rotors": (
            rotors,
            ("rotors: found 2 (left, right), expected one rotor. Try: --rotor left, or",),
            {(*YES, "--rotor", "left"): of(*TWO.values()), (*YES, "--rotor", "right"): of(*TWO.values(), gain=0.9)},
        ),
        "seconds in two columns": (
            {"stamp.sec": 1.7e9 + np.floor(T["time"]), "stamp.nanosec": 1e9 * (T["time"] % 1.0)} | named("omega_ref", "thrust"),
            ("time: found whole seconds in stamp.sec, beside stamp.nanosec", "--map time=COLUMN:s"),
            {},
        ),
        "unsorted rows": (named(*COMMON, "thrust"), ("Try: sort the rows by their time",), {}),
        "coefficients": (
            {"RPM": [6000, 3000, 6000], "CT": [0.1, 0.08, 0.05], "CP": [0.05] * 3, "J": [0.0, 0.0, 0.4]},
            ("thrust: found no column of it among RPM, CT, CP, J", "Try: --map thrust=COLUMN:UNIT"),
            {},
        ),
        "messages in rows of their own": (
            messages,
            ("rows: found omega in other rows than thrust", "Try: a table joined at the rows of thrust, or --map omega=-"),
            {},
        ),
        "an angle": (
            named("time", "omega_ref", "thrust", body_pitch_deg=np.full(ROWS, 0.5), xi_deg=T["beta_ref"]),
            (f"xi_deg, an angle that moves from {T['beta_ref'].min():g} to {T['beta_ref'].max():g} deg",),
            {by_map("beta_ref=xi_deg:deg"): of("beta_ref"), FIXED: TWO_DEG},
        ),
        "a measured pitch that moves": (
            {"beta" if n == "beta_ref" else n: c for n, c in T.items()},
            ("beta_ref: found a measured pitch from", "Try: --map 'beta_ref=beta:deg' beta=- if its command was not logged"),
            {(*measured, *FIXED): TWO_DEG},
            measured,
        ),
        **{
            f"pulses, {header}": (
                named("time", "omega_ref", "thrust", **{header: PULSES}),
                (f"{header}, pitch by its name", f"beta_ref={header}:us@{PULSES.min():g}=A,{PULSES.max():g}=B"),
                {by_map(f"beta_ref={header}:us@1000=-5,2000=10"): pulses, FIXED: TWO_DEG},
            )
            for header in ("Pitch Servo (us)", "servo pwm")
        },
        "thrust follows": (  # beside it: a step counter, a temperature and the command again, which say nothing of the thrust
            named("time", "omega_ref", "omega", "thrust", **quiet, **{"RCOU.C2": PULSES}),
            (f"RCOU.C2, an unused command from {PULSES.min():g} to {PULSES.max():g} that thrust follows",),
            {by_map("beta_ref=RCOU.C2:us@1000=-5,2000=10"): pulses, FIXED: TWO_DEG},
        ),
        **{
            f"{pairs} pole pairs": (
                named("time", "omega_ref", "thrust", **{"speed (rpm)": pairs * T["omega"]}),
                (f"electrical speed of a motor with {told}", f"omega=speed (rpm):erpm/{pairs}"),
                {by_map(f"omega=speed (rpm):erpm/{pairs}"): of("omega"), ("--force",): of("omega", gain=pairs)},
            )
            for pairs, told in ((7, "7 pole pairs?"), (6, "6 pole pairs, or deg/s?"))
        },
        "omega in rad/s, by its ratio": (
            named("time", "omega_ref", "thrust", **{"speed [rpm]": TURN * T["omega"]}),
            ("(omega in rad/s?)", "--map 'omega=speed [rpm]:rad/s'"),
            {(*by_map("omega=speed [rpm]:rad/s"), "--force"): of("omega", "omega_ref")},
        ),
        "electrical by its unit": (
            electrical,
            ("omega=Motor speed (erpm):erpm/7",),
            {by_map("omega=Motor speed (erpm):erpm/7"): {"omega": S["RPM"]}},
        ),
        "a signal in another unit": (
            S,
            ("signal, column ESC (us): found 1", "another unit of the signal"),
            {},
            by_map("signal=ESC (us):1"),
            "--force",
        ),
    }
    cases["unsorted rows"] = ({h: c[SWAPPED] for h, c in cases["unsorted rows"][0].items()}, *cases["unsorted rows"][1:])
    servo, shared = named(*COMMON, "thrust", servo=PULSES), ("two points of a calibration",)
    for unit in ("us@1000=-5,1000=10", "us@1.2.3=1,2=3", "us@1000=-5"):
        cases[f"no line, {unit}"] = (servo, shared, {}, by_map(f"beta_ref=servo:{unit}"))
    for header, unit, told in (
        ("Fz (gf)", "N", "the unit 'N' for a column whose header says 'gf'"),
        ("Fz (V)", "N", "whose header says 'V'"),
        ("Fz (N)", "bananas", "the unit 'bananas'"),
        ("Fz", "", "no unit, in the log or behind the column"),
        ("Fx", "N", "column Fz: found no such column"),
    ):
        wanted = by_map(f"thrust={'Fz' if header == 'Fx' else header}{unit and ':'}{unit}")
        cases[f"{header} as {unit}"] = (named("time", "omega_ref", **{header: T["thrust"]}), (told,), {}, wanted)
    return {
        name: Form(columns, by, parts, [w for part in words for w in ([part] if isinstance(part, str) else part)])
        for name, (columns, parts, by, *words) in cases.items()
    }


def packed(path: Path) -> None:
    """A log in a gzip file."""
    text()(path)
    path.write_bytes(gzip.compress(path.read_bytes()))


def forms() -> dict[str, Form]:
    """All forms, by name."""
    more = {"gzip": Form(packed, file="log.csv.gz")}
    return {**_texts(), **more, **_clocks(), **_containers(), **_unreadable(), **_doubtful()}
