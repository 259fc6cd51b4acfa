"""Logs in the formats of other people: the same data written in many ways, by code that shares nothing with the importer.

Each format has the options that its user types and the tolerance that its digits allow, or the reason of its refusal.
"""

import datetime
import gzip
import zipfile
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


UNITS = {"time": "s", "omega_ref": "rpm", "beta_ref": "deg", "omega": "rpm", "thrust": "N", "voltage": "V"}
"""Units of the columns of the data."""


@dataclass(frozen=True)
class Format:
    """A way to write the data. `write(path, truth)`; `words`: options behind the file's name; `time` and `rest`: tolerances of
    time [s] and of the other columns (relative), from the digits written; `refused`: words of the refusal, "" if the log must
    be imported; `said`: words that the output must have."""

    name: str
    write: Callable[[Path, Mapping[str, np.ndarray]], None]
    words: Sequence[str] = ()
    file: str = "log.csv"
    time: float = 1e-9
    rest: float = 1e-8
    refused: str = ""
    said: Sequence[str] = ()
    columns: Sequence[str] = tuple(UNITS)
    keep: Callable[[int], np.ndarray] = field(default=lambda rows: np.ones(rows, bool))


PLAIN = {name: name for name in UNITS}
OWN = ("--map", *(f"{name}={name}:{unit}" for name, unit in UNITS.items()))
TOLD = {
    "time": "t (s)",
    "omega_ref": "speed cmd (rpm)",
    "beta_ref": "pitch cmd (deg)",
    "omega": "speed (rpm)",
    "thrust": "Fz (N)",
    "voltage": "Vbat (V)",
}


def text(
    names: Mapping[str, str] | None = None,
    delimiter: str = ",",
    decimal: str = ".",
    head: Sequence[str] = (),
    under: Sequence[Sequence[str]] = (),
    end: str = "\n",
    encoding: str = "utf-8",
    mark: bytes = b"",
    factors: Mapping[str, float] | None = None,
    digits: str = ".10g",
    cells: Mapping[str, Callable[[float], str]] | None = None,
    quote: bool = False,
    tail: str = "",
    lines: Callable[[list[str]], list[str]] = lambda rows: rows,
    pack: bool = False,
    title: Callable[[str], str] = lambda row: row,
):
    """A writer of text. `factors`: from a record's unit to the file's; `cells`: how quantities are written, else as numbers."""
    names, factors, cells = TOLD if names is None else names, factors or {}, cells or {}

    def write(path: Path, t: Mapping[str, np.ndarray]) -> None:
        def row(parts):
            return delimiter.join(f'"{part}"' if quote else part for part in parts) + tail

        def cell(name, value):
            if name in cells:
                return cells[name](value)
            return "" if np.isnan(value) else f"{value * factors.get(name, 1.0):{digits}}".replace(".", decimal)

        rows = [row([cell(name, t[name][k]) for name in names]) for k in range(len(t["time"]))]
        titles = [title(row(names.values()))] if any(names.values()) else []
        content = end.join([*head, *titles, *(row(u) for u in under), *lines(rows)]) + end
        data = mark + content.encode(encoding)
        path.write_bytes(gzip.compress(data) if pack else data)

    return write


def stamped(form: str, cut: int = 6) -> Callable[[float], str]:
    """A time of a calendar, to so many digits of a second."""

    def cell(seconds: float) -> str:
        moment = START + datetime.timedelta(microseconds=round(1e6 * seconds))
        return moment.strftime(form).replace("%f", f"{moment.microsecond:06d}"[:cut])

    return cell


def epoch(seconds: float) -> int:
    """Microseconds since 1970."""
    return round(1e6 * START.replace(tzinfo=datetime.timezone.utc).timestamp()) + round(1e6 * seconds)


def containers() -> list[Format]:
    """Parquet, MAT and HDF5, by their own libraries; MAT 7.3 as MATLAB lays it out: a head of 512 bytes, then HDF5."""

    def parquet(path, t, stamp=False, units=False):
        import pyarrow as pa
        import pyarrow.parquet as pq

        arrays = dict(t)
        if stamp:
            arrays["time"] = np.datetime64(START, "us") + np.round(1e6 * t["time"]).astype("timedelta64[us]")
        schema = None
        if units:
            told = {"time": "s", "omega_ref": "rad/s", "beta_ref": "deg", "omega": "rad/s", "thrust": "kgf", "voltage": "V"}
            schema = pa.schema([pa.field(n, pa.float64(), metadata={"unit": u}) for n, u in told.items()])
            arrays |= {"omega_ref": t["omega_ref"] * TURN, "omega": t["omega"] * TURN, "thrust": t["thrust"] / G}
        pq.write_table(pa.table(arrays, schema=schema), path)

    def mat(path, t, struct=False):
        from scipy.io import savemat

        content = {name: column[:, None] for name, column in t.items()}
        savemat(path, {"log": content, "fs": 100.0} if struct else content | {"note": "stand 3", "fs": 100.0})

    def mat73(path, t):
        import h5py

        with h5py.File(path, "w", userblock_size=512) as file:
            for name, column in t.items():
                data = file.create_dataset(f"run/{name}", data=column[None, :])
                data.attrs["MATLAB_class"] = np.bytes_("double")
            note = file.create_dataset("note", data=np.frombuffer("stand".encode("utf-16-le"), np.uint16)[:, None])
            note.attrs["MATLAB_class"] = np.bytes_("char")
        with open(path, "r+b") as file:
            file.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\x00\x02IM")

    def hdf5(path, t, form="vectors"):
        import h5py

        with h5py.File(path, "w") as file:
            if form == "vectors":
                for name, column in t.items():
                    scale, unit = {"time": (1e3, "ms"), "thrust": (1e3 / G, "gf")}.get(name, (1.0, ""))
                    data = file.create_dataset(name, data=column * scale)
                    data.attrs["units"] = unit or {"omega": "rpm", "omega_ref": "rpm", "beta_ref": "deg", "voltage": "V"}[name]
            elif form == "matrix":
                data = file.create_dataset("table", data=np.column_stack(list(t.values())))
                data.attrs["columns"] = [name.encode() for name in t]
            else:
                rows = np.zeros(len(t["time"]), dtype=[(name, float) for name in t])
                for name, column in t.items():
                    rows[name] = column
                file.create_dataset("log", data=rows)

    def part(function, **options):
        return lambda path, t: function(path, t, **options)

    return [
        Format("Parquet", part(parquet), OWN, file="log.parquet"),
        Format(
            "Parquet, timestamps",
            part(parquet, stamp=True),
            [w for w in OWN if w != "time=time:s"] + ["time=time:iso"],
            file="log.parquet",
        ),
        Format("Parquet, units in its schema", part(parquet, units=True), file="log.parquet"),
        Format("MAT v5, vectors", part(mat), OWN, file="log.mat"),
        Format("MAT v5, a struct", part(mat, struct=True), OWN, file="log.mat"),
        Format("MAT v7.3", mat73, OWN, file="log.mat"),
        Format("HDF5, vectors with units", part(hdf5), file="log.h5"),
        Format("HDF5, a matrix with names", part(hdf5, form="matrix"), OWN, file="log.h5"),
        Format("HDF5, a compound", part(hdf5, form="compound"), OWN, file="log.h5"),
    ]


def _without(row: int, by: str) -> Callable[[list[str]], list[str]]:
    return lambda rows: [*rows[:row], by, *rows[row:]]


def _clock_back(t):
    """Three rows whose stamp is 4 ms before that of the row in front."""
    time = t["time"].copy()
    time[[80, 180, 280]] = time[[79, 179, 279]] - 0.004
    return t | {"time": time}


LONG = ("omega_ref", "beta_ref", "omega", "thrust")


def _long(rows: list[str]) -> list[str]:
    return [f"{row},{LONG[k % len(LONG)]}" for k, row in enumerate(rows)]


def _with(change, write):
    return lambda path, t: write(path, change(dict(t)))


def _holes(t):
    thrust = t["thrust"].copy()
    thrust[::7] = np.nan
    return t | {"thrust": thrust}


def _named(form: str, units: Mapping[str, str] | None = None) -> dict[str, Callable[[float], str]]:
    """Cells with their name in front, and perhaps a unit behind."""
    return {name: lambda value, name=name: form.format(name, value, (units or {}).get(name)) for name in PLAIN}


def _texts() -> list[Format]:
    told = [name.split(" (")[0] for name in TOLD.values()]
    units = list(UNITS.values())
    bare = dict(zip(TOLD, told, strict=True))
    comma = {"delimiter": ";", "decimal": ","}
    german = {"time": "Zeit [s]", "omega_ref": "Solldrehzahl [U/min]", "beta_ref": "Soll-Pitch [°]"}
    german |= {"omega": "Istdrehzahl [U/min]", "thrust": "Schub [N]", "voltage": "Spannung [V]"}
    number = lambda value: f"{value:.10g}"  # noqa: E731
    na = {"thrust": lambda v: "NA" if np.isnan(v) else number(v)}
    dash = {"thrust": lambda v: "-" if np.isnan(v) else number(v)}
    return [
        Format("a record's own names", text(PLAIN), OWN),
        Format("units in the names", text()),
        Format("semicolon, decimal comma", text(**comma)),
        Format("tab", text(delimiter="\t"), file="log.txt"),
        Format("tab, decimal comma", text(delimiter="\t", decimal=","), file="log.txt"),
        Format("bar", text(delimiter="|"), file="log.txt"),
        Format("spaces", text(PLAIN, delimiter="   "), OWN, file="log.dat"),
        Format(
            "spaces, units torn from names",
            text({n: f"{n} {v.split()[-1]}" for n, v in TOLD.items()}, delimiter=" "),
            file="log.dat",
        ),
        Format("comma and space", text(delimiter=", ")),
        Format("all quoted", text(quote=True)),
        Format("quoted, comma and decimal comma", text(quote=True, decimal=",")),
        Format("Excel's sep=", text(head=["sep=;"], **comma)),
        Format("a row of units", text(bare, under=[units])),
        Format("units in brackets, decimal comma", text(bare, under=[[f"[{u}]" for u in units]], **comma)),
        Format(
            "an empty column, - for its unit",
            _with(
                lambda t: t | {"note": t["time"]},
                text(bare | {"note": "note"}, under=[[*units, "-"]], cells={"note": lambda v: ""}),
            ),
        ),
        Format("units, then remarks", text(bare, under=[units, ["raw", "set", "-", "filtered", "a cell", "supply"]])),
        Format("numpy's savetxt", text(PLAIN, delimiter=" ", title=lambda row: f"# {row}", digits=".18e"), OWN, file="log.txt"),
        Format("comments of three kinds", text(head=["# stand 3", "% by hand", "// no wind"], lines=_without(50, "# knock"))),
        Format("a preamble", text(head=["Logger,V2.1", "Serial: 17", "", "Operator,Smith, J."])),
        Format(
            "no names",
            text(dict.fromkeys(PLAIN, "")),
            ("--map", *(f"{n}={k}:{u}" for k, (n, u) in enumerate(UNITS.items(), 1))),
        ),
        Format(
            "names once more", text(lines=lambda r: [*r[:200], ",".join(TOLD.values()), *r[200:]]), said=["names once more 1"]
        ),
        Format(
            "LabVIEW, counts and units above the names",
            _with(
                lambda t: t | {"note": t["time"]},
                text(
                    bare | {"note": "Comment"},
                    delimiter="\t",
                    head=[
                        "LabVIEW Measurement",
                        "Separator\tTab",
                        "***End_of_Header***",
                        "\t".join(["Samples", *["400"] * 6]),
                        "\t".join(["Date", *["2024/05/31"] * 6]),
                        "\t".join(["Y_Unit_Label", *units[1:], ""]),
                        "X_Dimension\tTime",
                    ],
                    cells={"note": lambda v: ""},
                ),
            ),
            file="log.lvm",
        ),
        Format(
            "a name before each value",
            text(dict.fromkeys(PLAIN, ""), delimiter=", ", head=["Booting...", "ready: 1"], cells=_named("{}={:.10g}")),
            file="serial.txt",
            said=["lines without these values 2"],
        ),
        Format(
            "a name before each value, units behind it",
            text(
                dict.fromkeys(PLAIN, ""),
                delimiter=" ",
                cells=_named("{}: {:.10g} {}", UNITS),
            ),
            file="serial.txt",
        ),
        Format(
            "JSON lines",
            text(
                dict.fromkeys(PLAIN, ""),
                delimiter=", ",
                cells=_named('"{}": {:.10g}'),
                lines=lambda rows: [f"{{{row}}}" for row in rows],
            ),
            file="log.jsonl",
        ),
        Format("cut off in the last row", text(lines=lambda r: [*r, "4.0,3000,2"]), said=["cut off at the end 1"]),
        Format("a comma at each end", text(tail=",")),
        Format("an index of dates without a name", text({**TOLD, "time": ""}, cells={"time": stamped("%F %T.%%f")})),
        Format("durations", text({**TOLD, "time": "t"}, cells={"time": lambda s: f"0 days 00:00:{s:09.6f}"})),
        Format(
            "a serial monitor's time before each row",
            text(
                {n: v for n, v in TOLD.items() if n != "time"},
                head=["23:59:58.100 -> booting"],
                title=lambda row: f"23:59:58.200 -> {row}",
                lines=lambda rows: [f"{stamped('%T.%%f', 3)(STEP * k)} -> {row}" for k, row in enumerate(rows)],
            ),
            file="serial.txt",
            said=["midnight"],
        ),
        Format("UTF-8 with mark, CRLF", text(mark=b"\xef\xbb\xbf", end="\r\n")),
        Format(
            "UTF-16 LE with mark, tabs",
            text(mark=b"\xff\xfe", encoding="utf-16-le", delimiter="\t", end="\r\n"),
            file="log.txt",
        ),
        Format("UTF-16 BE with mark", text(mark=b"\xfe\xff", encoding="utf-16-be")),
        Format("UTF-16 LE without mark", text(encoding="utf-16-le")),
        Format("Latin-1, umlauts and degrees", text(german, encoding="latin-1", **comma)),
        Format("lines ended by CR", text(end="\r")),
        Format("gzip", text(pack=True), file="log.csv.gz"),
        Format(
            "1.234,56",
            text(
                delimiter=";",
                cells={n: lambda v: f"{v:,.6f}".translate(str.maketrans(",.", ".,")) for n in ("omega", "omega_ref", "thrust")},
                decimal=",",
            ),
            rest=1e-6,
        ),
        Format(
            "thousands with a point, in whole numbers",
            text(
                PLAIN | {"time": "time_ms"},
                delimiter=";",
                decimal=",",
                cells={n: lambda v, k=k: f"{k * v:,.0f}".replace(",", ".") for n, k in (("time", 1e3), ("omega_ref", 1.0))},
            ),
            said=("decimal comma",),
        ),
        Format("Fortran's exponents", text(cells={n: lambda v: f"{v:.9E}".replace("E", "D") for n in UNITS})),
        Format("a row too long", text(lines=_without(100, "1,2,3,4,5,6,7,8")), said=("damaged (line 102)",)),
        Format("a row too short, CRLF", text(lines=_without(100, "0.99,2900"), end="\r\n"), said=("damaged (line 102)",)),
        Format(
            "a bad byte in a number",
            text(lines=_without(100, "0.99,29\xb20,1,2900,3,22"), encoding="cp1252"),
            said=("damaged (line 102)",),
        ),
        Format("two marks in a number", text(lines=_without(100, "0.99,29.0.1,1,2900,3,22")), said=("damaged (line 102)",)),
        Format(
            "power-up garbage before the names",
            text(mark=b"\xf8\xff\0\x9612.5,3.1\n3,4100.0\n"),
            said=("lines before the table 2", "text in utf-8"),
        ),
        Format('"1,234.56"', text(quote=True, cells={n: lambda v: f"{v:,.6f}" for n in ("omega", "omega_ref")}), rest=1e-6),
        Format("1'234.56", text(cells={"omega": lambda v: f"{v:,.6f}".replace(",", "'")}), rest=1e-6),
        Format(
            "units behind the numbers",
            text(
                bare | {"thrust": "Fz"},
                cells={
                    "time": lambda v: f"{v:.3f} s",
                    "omega": lambda v: f"{v:.3f} rpm",
                    "omega_ref": lambda v: f"{v:.0f} rpm",
                    "thrust": lambda v: f"{v:.5f} N",
                    "beta_ref": lambda v: f"{v:.2f} deg",
                    "voltage": lambda v: f"{v:.4f} V",
                },
            ),
        ),
        Format("1.5E+03", text(digits=".9E")),
        Format("NA for no value", _with(_holes, text(cells=na)), keep=lambda n: np.arange(n) % 7 > 0),
        Format(
            "- for no value, decimal comma",
            _with(_holes, text(cells={n: lambda v, f=f: f(v).replace(".", ",") for n, f in dash.items()}, **comma)),
            keep=lambda n: np.arange(n) % 7 > 0,
        ),
        Format(
            "rad/s, gf, rad",
            text(PLAIN, factors={"omega": TURN, "omega_ref": TURN, "thrust": 1e3 / G, "beta_ref": np.pi / 180}),
            [
                *(w for w in OWN if "omega" not in w and "thrust" not in w and "beta" not in w),
                "omega=omega:rad/s",
                "omega_ref=omega_ref:rad/s",
                "thrust=thrust:gf",
                "beta_ref=beta_ref:rad",
            ],
        ),
        Format(
            "thrust downwards",
            text({**TOLD, "thrust": "Fz (gf)"}, factors={"thrust": -1e3 / G}),
            ("--map", "time=1:s", "omega_ref=2:rpm", "beta_ref=3:deg", "omega=4:rpm", "thrust=5:-1 gf", "voltage=6:V"),
        ),
    ]


def _clocks() -> list[Format]:
    def timed(name, cell, unit="", said=(), time=1e-9, **options):
        words = [w for w in OWN if not w.startswith("time=")] + [f"time=stamp{unit}"]
        written = text({**PLAIN, "time": "stamp"}, cells={"time": cell}, **options)
        return Format(name, written, words, time=time, said=said)

    def plain(scale, digits, offset=0.0):
        return lambda s: f"{(s + offset) * scale:.{digits}f}"

    wrap = 2**32
    return [
        timed("ms", plain(1e3, 0), unit=":ms"),
        timed("minutes, first one not 0", plain(1 / 60, 10, 754.3), unit=":min", time=1e-7),
        timed("days of Excel", plain(1 / 86400, 12, 45443.2 * 86400), unit=":day", time=2e-6),
        timed("since 1970, s", lambda s: f"{epoch(s) / 1e6:.6f}", unit=":s", time=1e-6),
        timed("since 1970, ms", lambda s: f"{epoch(s) // 1000}", unit=":ms", time=1e-6),
        timed("since 1970, us", lambda s: f"{epoch(s)}", unit=":us", time=1e-6),
        timed("since 1970, ns", lambda s: f"{epoch(s)}000", unit=":ns", time=1e-6),
        timed("ISO, Z", stamped("%Y-%m-%dT%H:%M:%S.%%fZ")),
        timed("ISO, offset, blank", stamped("%Y-%m-%d %H:%M:%S.%%f+02:00", 3), unit=":iso"),
        timed("31.05.2024 23:59:58,250", stamped("%d.%m.%Y %H:%M:%S,%%f", 3), delimiter=";", decimal=","),
        timed("05/31/2024 11:59:58.250 PM", stamped("%m/%d/%Y %I:%M:%S.%%f %p", 3)),
        timed("time of day over midnight", stamped("%H:%M:%S.%%f", 3), said=["midnight"]),
        timed("whole seconds for 100 rows", stamped("%Y-%m-%d %H:%M:%S"), said=["spread evenly"], time=0.011),
        timed(
            "a 32-bit counter of us, begun anew",
            lambda s: str((wrap - 1_500_000 + round(1e6 * s)) % wrap),
            unit=":us",
            said=["unwrapped"],
        ),
        Format(
            "no time: rows 10 ms apart",
            text({n: v for n, v in PLAIN.items() if n != "time"}),
            [w for w in OWN if not w.startswith("time=")] + ["time=row:10ms"],
        ),
        Format(
            "goes back by 4 ms in 3 rows", _with(_clock_back, text()), said=["goes back in 3 of 400 rows, by 4 ms"], time=0.0101
        ),
        Format(
            "each tenth row twice",
            text(lines=lambda r: [x for k, row in enumerate(r) for x in [row] * (1 + (k % 10 == 5))]),
            said=["40 rows at the time of the next one"],
        ),
    ]


def _refused() -> list[Format]:
    def raw(data):
        return lambda path, t: path.write_bytes(data)

    def workbook(path, t):
        with zipfile.ZipFile(path, "w") as file:
            file.writestr("xl/workbook.xml", "<workbook/>")

    def unit(word):
        return [w for w in OWN if not w.startswith("thrust=")] + [f"thrust=thrust:{word}"]

    back = lambda t: t | {"time": np.where(np.arange(ROWS) < 200, t["time"], t["time"] - 1.0)}  # noqa: E731
    return [
        Format("a workbook", workbook, file="log.xlsx", refused="workbook"),
        Format("a ROS bag", raw(b"#ROSBAG V2.0\n" + bytes(200)), file="log.bag", refused="a ROS bag"),
        Format("MCAP", raw(b"\x89MCAP0\r\n" + bytes(200)), file="log.mcap", refused="MCAP"),
        Format("comma for both", text(decimal=","), refused="decimal"),
        Format("back by a second", _with(back, text()), refused="line 202: found 1.0 after 1.99, back by 0.99"),
        Format("a unit that nobody knows", text(PLAIN), unit("bananas"), refused="bananas"),
        Format("a unit of something else", text(PLAIN), unit("rpm"), refused="a unit like N"),
        Format("no unit", text(PLAIN), ("--map", "time=time:s", "thrust=thrust", "omega_ref=omega_ref:rpm"), refused="no unit"),
        Format("no thrust", text({n: v for n, v in TOLD.items() if n != "thrust"}), refused="thrust"),
        Format("no command", text({n: v for n, v in TOLD.items() if n != "omega_ref"}), refused="command of speed"),
        Format(
            "two units in one column",
            text(cells={"thrust": lambda v: f"{v:.3f} N" if round(1e3 * v) % 2 else f"{1e3 * v:.0f} mN"}),
            refused="no column of it",
        ),
        Format(
            "one value a row",
            _with(
                lambda t: {"time": np.repeat(t["time"], 4), "value": np.stack([t[n] for n in LONG], 1).ravel()},
                text({"time": "_time", "value": "_value"}, title=lambda row: f"{row},_field", lines=_long),
            ),
            refused="no column of it",
        ),
        Format("no such column", text(PLAIN), ("--map", "thrust=Fx:N"), refused="column Fx"),
        Format(
            "a word among numbers", text(cells={"thrust": lambda v: "overload" if v > 10.0 else f"{v:.5f}"}), refused="overload"
        ),
        Format(
            "two marks that may separate thousands",
            text(
                PLAIN,
                delimiter=";",
                cells={n: lambda v: f"{v:,.0f}".replace(",", ".") for n in ("omega", "omega_ref")}
                | {n: lambda v: f"{1.5 + v % 8:.3f}".replace(".", ",") for n in ("time", "beta_ref", "thrust", "voltage")},
            ),
            refused="--decimal comma",
        ),
        Format("many rows too long", text(lines=lambda rows: [*rows, *["1,2,3,4,5,6,7,8"] * 6]), refused="at most 1 % damaged"),
        Format(
            "the names again in another order",
            text(PLAIN, lines=_without(100, ",".join(reversed(PLAIN)))),
            refused="line 102: found the names again",
        ),
        Format("bytes", raw(bytes(range(256)) * 20), refused="no text"),
        Format("half a character", raw("t,n\n1,2\n".encode("utf-16")[:-1]), refused="bytes that are no utf-16"),
        Format("empty", raw(b""), refused="comments"),
        Format("prose", raw(b"On the first day the rotor broke.\nOn the second day too.\n"), file="log.txt", refused="line"),
        Format("half a Parquet file", raw(b"PAR1" + bytes(100)), file="log.parquet", refused="Parquet"),
        Format(
            "half a MAT file",
            raw(b"MATLAB 5.0 MAT-file, Platform: GLNXA64".ljust(128) + bytes(64)),
            file="log.mat",
            refused="MAT",
        ),
        Format("half an HDF5 file", raw(b"\x89HDF\r\n\x1a\n" + bytes(64)), file="log.h5", refused="HDF5"),
    ]


def formats() -> list[Format]:
    """All formats."""
    return [*_texts(), *_clocks(), *containers(), *_refused()]


def came_out(format: Format, folder: Path, run: Callable[[list[str]], tuple[int, str, str]]) -> tuple[bool, str]:
    """Write a format into a new folder, import it and read the record with the csv module: (whether it is right, the result in
    words). `run`: the command line, which returns its exit code, output and errors."""
    t, path = truth(), folder / format.file
    format.write(path, t)
    code, out, err = run(["import", "csv", str(path), *format.words, "-o", str(folder / "out")])
    if format.refused:
        one_line = code == 2 and err.count("\n") == 1 and format.refused in err and "found" in err and "expected" in err
        return one_line and not (folder / "out").exists(), err.strip().replace(str(folder) + "/", "")
    if code:
        return False, err.strip().replace(str(folder) + "/", "")
    missing = [part for part in format.said if part not in out]
    if missing:
        return False, f"not said: {', '.join(missing)}"
    return _compared(format, t, folder / "out" / "open_loop.csv")


def _compared(format: Format, t: Mapping[str, np.ndarray], path: Path) -> tuple[bool, str]:
    head, *rows = [line.split(",") for line in path.read_text().splitlines()]
    if set(head) != set(format.columns):
        return False, f"columns {', '.join(head)}"
    if len(rows) != ROWS:
        return False, f"{len(rows)} rows of {ROWS}"
    worst = {}
    for k, name in enumerate(head):
        found = np.array([float(row[k] or "nan") for row in rows])
        kept = format.keep(ROWS) if name == "thrust" else np.ones(ROWS, bool)
        if np.isnan(found[kept]).any() or np.isfinite(found[~kept]).any():
            return False, f"{name}: other cells are empty"
        scale = 1.0 if name == "time" else np.abs(t[name]).max()
        worst[name] = float(np.max(np.abs(found - t[name])[kept]) / scale)
    off = max(worst[n] for n in worst if n != "time")
    good = worst["time"] <= format.time and off <= format.rest
    return good, f"time within {worst['time']:.1e} s, the rest within {off:.1e}"
