"""python -m tests.studies fuzz --runs 2000 [--first-seed S] [--verbs A,B] [--minutes M]: damaged files, given to every verb.

Each case takes a command whose files are good, and damages one of them: cells, headers and encodings of a table, a gzip file
cut or with a wrong bit, JSON and TOML nested, duplicated, huge or of wrong kinds, an FMU damaged in each of its parts, an
effect's lines. It runs in a separate process, forked after the imports. Aim: no exit code other than 0 and 2, no traceback, no
run over 60 s, no NaN in JSON and no half-written output.
"""

import contextlib
import gzip
import io
import json
import os
import random
import re
import resource
import shutil
import signal
import struct
import sys
import tempfile
import time
import traceback
import zipfile
import zlib
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from hil.emulator.rig import CALIBRATION
from identification.demo import example_folder
from identification.logs.speed_map import FORMAT as SPEED_MAP_FORMAT
from vpp_fmu.app.cli import main as vpp
from vpp_fmu.app.cli import parser_of
from vpp_fmu.campaign import read_campaign
from vpp_fmu.files import OutputFolder
from vpp_fmu.record import write_record

EFFECT = Path(__file__).parents[1] / "own_effect.py"
"""The README's effect, which gives a load cell a lag: `cell_lag`."""

NOTE_OR_STAGE = re.compile(r"vpp: note: .*|vpp \w+: .* \(\d+ s\)")
"""Lines that a verb prints although it succeeds: notes, and stages in a pipe."""

LIMIT, LONGEST = 60, 300.0
"""s that a case may take: CPU time, and wall-clock time on a shared machine."""

MEMORY = 4 * 2**30
"""Bytes of address space that a case may ask for."""

COMMANDS: Mapping[str, Sequence[str]] = {
    "check": ["{campaign} -o {out}"],
    "identify": ["{campaign} --starts 1 -o {out}", "{plain} --record {record} --starts 1 -o {out}"],
    "diagnose": [
        "{campaign} --effects pitch_command_deadband --workers 1 -o {out}",
        "{plain} --parameters {parameters} --effects pitch_offset --workers 1 -o {out}",
        "{plain} --effects-from {cell_lag} --effects pitch_offset,cell_lag --workers 1 -o {out}",
    ],
    "allocate": ["--parameters {powered} -o {out}"],
    "tune": ["--parameters {parameters} --profile {profile} --knowledge {knowledge} --gains {gains} -o {out}"],
    "learn": ["{parameters} --knowledge {knowledge} --gains {gains} --generations 2 --plants 2 -o {out}"],
    "export": [
        "--parameters {parameters} --gains {gains} -o {out}",
        "--parameters {parameters} --gains {gains} --flavour native -o {out}",
        "--parameters {parameters} --twin {knowledge} -o {out}",
        "--parameters {parameters} --effects-from {cell_lag} -o {out}",
    ],
    "cosim": [
        "{plant} {controller} --profile {profile} -o {out}",
        "{native_plant} {native_controller} --profile {profile} -o {out}",
        "{plant} {controller} --twin {twin} --profile {profile} -o {out}",
    ],
    "simulate": [
        "{record} --parameters {parameters} -o {out}",
        "{packed} --parameters {parameters} --effects-from {cell_lag} -o {out}",
    ],
    "compare": ["{record} {packed} -o {out}"],
    "plan": [
        "--parameters {parameters} --knowledge {knowledge} --rig {own_rig} --seconds 4 -o {out}",
        "--parameters {parameters} --campaign {campaign} --seconds 4 -o {out}",
    ],
    "import": [
        "csv {log} --yes -o {out}",
        "csv {log} --map {mapping} --as open_loop -o {out}",
        "csv {log} --propose {out}/mine.toml -o {out}",
        "csv {esc_log} --map signal=esc:us --fixed beta_ref=0:deg --speed-map {speed_map} -o {out}",
        "rcbenchmark {stand} --speed-map {speed_map} -o {out}",
    ],
    "effects": ["--effects-from {cell_lag}"],
    "check-effect": ["{cell_lag}"],
    "twin": ["{out} --virtual --rounds 1 --rig emulated {own_rig} --calibration {calibration} --parameters {parameters}"],
    "hil": [
        "run --virtual --calibration {calibration} --limits {limits} --profile {profile} -o {out}",
        "run --virtual --rig emulated {own_rig} --parameters {parameters} --gains {gains} --profile {profile} -o {out}",
        "run --virtual --controller {controller} --profile {profile} -o {out}",
        "run --rig fmu {native_plant} --profile {profile} -o {out}",
        "campaign --virtual --commands {record} --rig emulated {own_rig} -o {out}",
        "replay {run} {controller} -o {out}",
        "report {run_folder}",
        "calibrate --virtual --parts load_cell --answers {answers} --calibration {calibration} -o {out}",
    ],
}
"""By verb, its words; {NAME} is a file or folder of `materials`. A verb that takes no file is not here."""

RARE = {"tune": 0.25, "twin": 0.1, "diagnose": 0.5}
"""Weights of slow verbs in the draw of a case; those of the others are 1."""


def materials(home: Path, verbs: Iterable[str]) -> dict[str, Path]:
    """Good files by name, made in `home`: a short part of the example campaign, and what other verbs make of it for `verbs`."""
    found = {"campaign": home / "campaign", "plain": home / "campaign", "out": home / "out"}
    whole, folder = read_campaign(example_folder()), OutputFolder(home / "campaign")
    cuts = {"open_loop": whole.open_loop.part(slice(0, 5000, 4)), "repeat": whole.repeat.part(slice(0, 5000, 4))}
    cuts["validation"] = whole.validation.part(slice(0, 2000, 4))
    for name, record in cuts.items():
        write_record(folder, f"{name}.csv{'.gz' * (name == 'repeat')}", record)
    folder.write("static.csv", gzip.decompress((example_folder() / "static.csv.gz").read_bytes()))
    text = gzip.decompress((example_folder() / "steps.csv.gz").read_bytes()).decode().splitlines()
    runs = list(dict.fromkeys(line.partition(",")[0] for line in text[1:]))[::8]
    folder.write("steps.csv", "\n".join([text[0], *(line for line in text[1:] if line.partition(",")[0] in runs)]) + "\n")
    ranges = {"speed": {"min": 2000, "max": 6000, "unit": "rpm"}, "pitch": {"min": -5, "max": 10, "unit": "deg"}}
    rig = {"format": "vpp-rig/1", "name": "fuzz", **ranges, "slew": {"speed": 20000, "pitch": 100}}
    folder.write("rig.json", json.dumps(rig))
    gain = {"value": 0.5, "std": None, "unit": "1"}
    gains = {"format": "vpp-parameters/1", "parameters": {"kp_omega": gain}, "effects": [], "source": {}}
    watts = {"power_map.p30": {"value": 200.0, "std": 2.0, "unit": "W"}}
    powered = {"format": "vpp-parameters/1", "parameters": watts, "effects": ["power_map"], "source": {}}
    n = np.arange(1500)
    esc = 1100.0 + 100.0 * (n // 250)
    speed = 4.0 * (esc - 1000.0)
    thrust, stamp = 4e-7 * speed**2, 0.02 * n
    rows = zip(1e3 * stamp, speed, 2.0 + n // 300, thrust + 0.01 * np.sin(n), strict=True)
    own = np.column_stack([stamp, esc, speed, thrust])
    speed_map = {
        "format": SPEED_MAP_FORMAT,
        "signal": {"kind": "PWM", "minimum": 1000, "maximum": 2000, "turns_from": 1100, "fitted_to": 1700},
        "coefficients": [0.0, 4000.0, 0.0, 0.0],
        "nominal_voltage": 12.0,
        "rms": 1.0,
        "points": 6,
        "source": "fuzz",
    }
    texts = {
        "powered.json": json.dumps(powered),
        "own_rig.json": json.dumps(rig),
        "profile.csv": "time,thrust_set\n0,1.5\n0.3,6\n0.6,6\n",
        "cell_lag.py": EFFECT.read_text(encoding="utf-8"),
        "calibration.json": CALIBRATION.read_text(encoding="utf-8"),
        "limits.json": json.dumps({"format": "vpp-limits/1", "limits": {"run_time": {"value": 60, "unit": "s"}}}),
        "gains.json": json.dumps(gains),
        "answers.txt": "\n\nwith\n" + "\n" * 60,
        "log.csv": "t [ms],rpm cmd [rpm],pitch cmd [deg],Fz [N]\n" + _lines(rows),
        "esc_log.csv": "time [s],esc,rpm,thrust [N]\n" + _lines(own),
        "stand.csv": "Time (s),ESC signal (µs),Thrust (N),Voltage (V),Current (A),"
        "Motor Electrical Speed (RPM),Motor Optical Speed (RPM)\n" + _lines((t, e, f, 12.0, 1.0, 0.0, w) for t, e, w, f in own),
        "mapping.toml": 'format = "vpp-mapping/1"\n\n[open_loop]\nlog = "log.csv"\n\n[open_loop.columns]\ntime = "t [ms]:ms"\n'
        'omega_ref = "rpm cmd [rpm]:rpm"\nbeta_ref = "pitch cmd [deg]:deg"\nthrust = "Fz [N]:N"\n',
        "speed_map.json": json.dumps(speed_map),
    }
    for file, content in texts.items():
        found[Path(file).stem] = home / file
        (home / file).write_text(content, encoding="utf-8")
    other = whole.open_loop.part(slice(8000, 9200, 4))
    other = other.with_columns(time=other.time - other.time[0])
    write_record(OutputFolder(home), "record.csv", other)
    write_record(OutputFolder(home), "record.csv.gz", other)
    found |= {"record": home / "record.csv", "packed": home / "record.csv.gz"}
    needed = {word for verb in verbs for word in re.findall(r"\{(\w+)\}", " ".join(COMMANDS[verb]))}
    if needed & {"parameters", "knowledge"}:
        _must("identify", found["campaign"], "--starts", "1", "-o", home / "known")
        found |= {"parameters": home / "known" / "parameters.json", "knowledge": home / "known" / "identification.json"}
    names = {"plant": "VppPlant", "controller": "VppController", "twin": "VppTwin"}
    if needed & {*names, "native_plant"}:
        given = ("--parameters", found["parameters"], "--twin", found["knowledge"])
        _must("export", *given, "--flavour", "both", "-o", home / "fmus")
        found |= {name: home / "fmus" / f"{file}.fmu" for name, file in names.items()}
        found |= {f"native_{name}": home / "fmus" / f"{file}.native.fmu" for name, file in names.items()}
    if needed & {"run", "run_folder"}:
        _must("hil", "run", "--virtual", "--profile", found["profile"], "-o", home / "runs")
        run = next(path.parent for path in (home / "runs").rglob("log.csv*"))
        found |= {"run": run / "run.csv", "run_folder": run}
    return found


def _lines(rows: Iterable[Iterable[float]]) -> str:
    return "".join(",".join(f"{x:.6g}" for x in row) + "\n" for row in rows)


def _must(*words: object) -> None:
    said = io.StringIO()
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(said):
        if vpp([str(word) for word in words]):
            raise RuntimeError(f"the study's own files: {said.getvalue()}")


CELLS = ("nan", "inf", "-inf", "1e999", "-1e300", "1e-320", "", '"', "1,5", "é", "\0", "0x10", "1_000", "=1+1", "١٢", "-")
CELLS += ("x" * 3000,)
HEADS = ("", "time", "thrust", "\ufefftime", "TIME", "omega_ref", "a\tb", "\x1b[31m", "x" * 300, "thrust (N)", '"', "nan")
VALUES = (None, True, [], {}, "x", "", -1, 0, 1e308, 1e-320, 10**290, [[]], {"value": []}, "\u2028", "../../x", [1.0] * 5)
TEXTS = ("NaN", "-Infinity", "1e999", "9" * 5000, "[" * 100_000, '{"a":' * 500 + "1" + "}" * 500, '"\\ud800"')
TEXTS += (f'"{"y" * 10**6}"', "")
LINES = ("x = " + "[" * 3000, "x" + ".x" * 1500 + " = 1", "[" + "x." * 1500 + "x]", "x = inf", "x = nan", "x = 2026-99-99")
LINES += ("[open_loop]", "[open_loop.columns]", 'columns = "x"', "[[open_loop]]", 'time = ""', 'time = "::"', "time = []")
LINES += ('omega_ref = "no such column:rpm"', 'omega_ref = "t [ms]:furlong"', "x = " + "9" * 4000, f'x = "{"y" * 200_000}"')
LINES += ('"" = 1', "= 1", "\0", 'read = "x"', "[open_loop.read]\ndelimiter = 1", '[open_loop.fixed]\nbeta_ref = "x"')


def table(rng: random.Random, data: bytes) -> tuple[str, bytes]:
    """(kind of damage, a damaged CSV)."""
    lines = data.decode().split("\n")
    grid = [line.split(",") for line in lines if line]
    row, column = rng.randrange(1, len(grid)), rng.randrange(len(grid[0]))
    what = rng.choice(
        ("cell", "cells", "head", "row gone", "row twice", "rows swapped", "column", "order", "few rows", "marks", "text")
    )
    if what == "cell":
        grid[row][column] = rng.choice(CELLS)
    elif what == "cells":
        value = rng.choice((*CELLS, "0", "1e9", "-5", "90"))
        for cells in grid[1:]:
            cells[column] = value
    elif what == "head":
        grid[0][column] = rng.choice(HEADS)
    elif what == "row gone":
        del grid[row]
    elif what == "row twice":
        grid.insert(row, grid[row])
    elif what == "rows swapped":
        other = rng.randrange(1, len(grid))
        grid[row], grid[other] = grid[other], grid[row]
    elif what == "column":
        factor = rng.choice((0.0, -1.0, 1e-6, 1e6, 1e12))
        for cells in grid[1:]:
            with contextlib.suppress(ValueError):
                cells[column] = repr(float(cells[column]) * factor)
    elif what == "order":
        grid[1:] = grid[:0:-1]
    elif what == "few rows":
        del grid[rng.randrange(1, 4) :]
    text = (";" if what == "marks" else ",").join
    done = "\n".join(map(text, grid)) + "\n"
    return ("table: " + what, done.encode()) if what != "text" else encoding(rng, data)


def encoding(rng: random.Random, data: bytes) -> tuple[str, bytes]:
    """(kind of damage, the text in other bytes)."""
    text, half = data.decode(), rng.randrange(len(data) + 1)
    ways: dict[str, Callable[[], bytes]] = {
        "utf-16": lambda: text.encode("utf-16"),
        "utf-32": lambda: text.encode("utf-32"),
        "byte-order mark": lambda: b"\xef\xbb\xbf" * 2 + data,
        "cut": lambda: data[:half],
        "empty": lambda: b"",
        "zeros": lambda: data[:half] + bytes(1000),
        "latin-1": lambda: data[:half] + b"\xe9" + data[half:],
        "bytes": lambda: rng.randbytes(500),
        "carriage returns": lambda: data.replace(b"\n", b"\r\r\n"),
        "one line": lambda: data.replace(b"\n", b" "),
        "twice": lambda: data + data,
        "a bit": lambda: (
            data[:half] + bytes([data[half] ^ 1 << rng.randrange(8)]) + data[half + 1 :] if half < len(data) else b""
        ),
    }
    what = rng.choice(list(ways))
    return "bytes: " + what, ways[what]()


def bomb(megabytes: int) -> bytes:
    """A gzip file of zeros that is never in memory as a whole: its blocks are equal, so one is compressed (RFC 1951)."""
    zeros, pack, check = bytes(2**20), zlib.compressobj(9, wbits=-15), 0
    block = pack.compress(zeros) + pack.flush(zlib.Z_FULL_FLUSH)
    for _ in range(megabytes):
        check = zlib.crc32(zeros, check)
    end = b"\x03\0" + struct.pack("<II", check, megabytes * 2**20 % 2**32)  # an empty last block, CRC and size
    return b"\x1f\x8b\x08" + bytes(7) + block * megabytes + end


def packed(rng: random.Random, data: bytes) -> tuple[str, bytes]:
    """(kind of damage, a damaged gzip file)."""
    at = rng.randrange(1, len(data))
    what = rng.choice(("cut", "a bit", "tail", "twice", "bomb", "not packed", "damaged inside"))
    if what == "bomb":
        return "gzip: bomb", bomb(1500)
    if what == "damaged inside":
        done, inside = table(rng, gzip.decompress(data))
        return f"gzip: {done}", gzip.compress(inside)
    bent = data[:at] + bytes([data[at] ^ 1 << rng.randrange(8)]) + data[at + 1 :]
    ways = {"cut": data[:at], "a bit": bent, "tail": data + b"x", "twice": data * 2, "not packed": gzip.decompress(data)}
    return f"gzip: {what}", ways[what]


def places(content: object, place: tuple = ()) -> Iterator[tuple]:
    """Places of all values in a JSON value."""
    yield place
    inside = content.items() if isinstance(content, dict) else enumerate(content[:20]) if isinstance(content, list) else ()
    for key, value in inside:
        yield from places(value, (*place, key))


def objects(rng: random.Random, data: bytes) -> tuple[str, bytes]:
    """(kind of damage, a damaged JSON file)."""
    what = rng.choice(("value", "value", "value", "gone", "renamed", "more", "twice", "raw", "text"))
    if what == "text":
        return encoding(rng, data)
    content = json.loads(data)
    place = rng.choice([p for p in places(content) if p])
    holder = content
    for key in place[:-1]:
        holder = holder[key]
    shown = f"JSON: {what} of {', '.join(map(str, place))}"
    mark = "\0mark"
    if what == "value":
        value = holder[place[-1]] = rng.choice(VALUES)
        shown += f" = {json.dumps(value)[:40]}"
    elif what == "gone":
        del holder[place[-1]]
    elif what == "raw":
        holder[place[-1]] = mark
    elif isinstance(holder, dict):
        held = holder[place[-1]]
        if what == "renamed":
            holder[rng.choice(("", "x", "value", "\u00e9" * 50))] = holder.pop(place[-1])
        elif what == "more":
            holder[rng.choice(("", "x", "value", "\x1b[31m"))] = rng.choice(VALUES)
        else:
            twice = f"{json.dumps(place[-1])}: {json.dumps(held)}, {json.dumps(place[-1])}: {json.dumps(held)}"
            del holder[place[-1]]
            holder[mark] = 0
            return shown, json.dumps(content).replace(f"{json.dumps(mark)}: 0", twice).encode()
    text = json.dumps(content)
    raw = rng.choice(TEXTS)
    return (f"{shown} = {raw[:20]}" if what == "raw" else shown), text.replace(json.dumps(mark), raw).encode()


def toml(rng: random.Random, data: bytes) -> tuple[str, bytes]:
    """(kind of damage, a damaged TOML file)."""
    lines = data.decode().split("\n")
    at = rng.randrange(len(lines))
    new = rng.choice(LINES)
    what = rng.choice(("line gone", "line twice", "line more", "line in place", "line in place", "text"))
    if what == "text":
        return encoding(rng, data)
    if what == "line gone":
        del lines[at]
    elif what == "line twice":
        lines.insert(at, lines[at])
    elif what == "line more":
        lines.insert(at, new)
    else:
        lines[at] = new
    return f"TOML: {what} {new[:40]!r}", "\n".join(lines).encode()


def python(rng: random.Random, data: bytes) -> tuple[str, bytes]:
    """(kind of damage, damaged lines of Python)."""
    lines = data.decode().split("\n")
    at = rng.randrange(len(lines))
    what = rng.choice(("line gone", "word", "raise", "cut", "text"))
    if what == "text":
        return encoding(rng, data)
    if what == "line gone":
        del lines[at]
    elif what == "word":
        words = ("0.0", "None", "x.nothing", "nan", '""', "()", "-1e300", "1e999", "lambda *a: a")
        lines[at] = re.sub(r"[\w.]+", lambda found: rng.choice(words) if rng.random() < 0.3 else found[0], lines[at])
    elif what == "raise":
        lines.insert(at, rng.choice(("raise RuntimeError('x\\ny')", "raise SystemExit(3)", "1 / 0", "import nothing")))
    else:
        del lines[at:]
    return f"Python: {what}, line {at + 1}", "\n".join(lines).encode()


def fmu(rng: random.Random, data: bytes) -> tuple[str, bytes]:
    """(kind of damage, an FMU damaged in one of its parts, or in its archive)."""
    at = rng.randrange(len(data))
    what = rng.choice(("archive cut", "archive bit", "archive hole", *["member"] * 7))
    if what != "member":
        bent = {"archive cut": data[:at], "archive bit": data[:at] + bytes([data[at] ^ 1 << rng.randrange(8)]) + data[at + 1 :]}
        return f"FMU: {what}", bent.get(what, data[:at] + bytes(min(100, len(data) - at)) + data[at + 100 :])
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        files = {name: archive.read(name) for name in archive.namelist()}
    kinds = {"description": "modelDescription.xml", "module": "resources/", "library": "binaries/"}
    kind = rng.choice([k for k, start in kinds.items() if any(name.startswith(start) for name in files)])
    names = [name for name in files if name.startswith(kinds[kind]) and not name.startswith("resources/pythonfmu/")]
    name, other = rng.choice(names), rng.choice(list(files))
    content, cut = files[name], rng.randrange(max(len(files[name]), 1))
    ways: dict[str, Callable[[], bytes | None]] = {
        "gone": lambda: None,
        "empty": lambda: b"",
        "cut": lambda: content[:cut],
        "another's": lambda: files[other],
    }
    if kind == "description":
        ways |= dict.fromkeys(("attribute", "attribute ", "attribute  "), lambda: _attribute(rng, content))
    elif kind == "module":
        ways |= dict.fromkeys(("lines", "lines ", "lines  "), lambda: python(rng, content)[1])
    else:
        ways["zeros"] = lambda: content[:cut] + bytes(len(content) - cut)
    how = rng.choice(list(ways))
    changed = ways[how]()
    del files[name]
    files |= {} if changed is None else {name: changed}
    made = io.BytesIO()
    with zipfile.ZipFile(made, "w", zipfile.ZIP_DEFLATED) as archive:
        for each, inside in files.items():
            archive.writestr(each, inside)
    return f"FMU: {name} {how.strip()}", made.getvalue()


def _attribute(rng: random.Random, content: bytes) -> bytes:
    found = list(re.finditer(rb'="([^"]*)"', content))
    at = rng.choice(found)
    new = rng.choice((b"", b"-1", b"999999", b"nan", b"1e999", b"x" * 2000, b"input", b"output", b"Integer", b"false", b"\xff"))
    return content[: at.start(1)] + new + content[at.end(1) :]


DAMAGES = {".csv": table, ".gz": packed, ".json": objects, ".toml": toml, ".fmu": fmu, ".py": python}
DAMAGES |= {".txt": encoding, ".jsonl": encoding}


@dataclass(frozen=True)
class Case:
    """A case by its seed: its `verb`, the damaged `file` and `how`; exit `code` (negative: by a signal; None: out of time),
    `seconds`, standard error `said`, and `faults`, of which there should be none."""

    seed: int
    verb: str
    file: str
    how: str
    code: int | None
    seconds: float
    said: str
    faults: tuple[str, ...]


FAULTS = ("exit code", "traceback", "over 60 s", "NaN in JSON", "half-written", "not one line")


def undamaged(verbs: Sequence[str], good: Mapping[str, Path], home: Path) -> Iterator[tuple[str, int | None, str]]:
    """(verb, exit code, standard error) of each command on good files, to show that refusals come from the damage."""
    for verb in verbs:
        for words in COMMANDS[verb]:
            place = home / "case"
            place.mkdir()
            code = _forked([verb, *(word.format(**{**good, "out": place / "out"}) for word in words.split())], place)
            yield verb, code, (place / "stderr").read_text(errors="replace")
            shutil.rmtree(place)


def run_case(seed: int, good: Mapping[str, Path], home: Path, verbs: Sequence[str]) -> Case:
    """Damage a file by the seed, run its command in a fork, and check the result."""
    rng = random.Random(seed)
    verb = rng.choices(verbs, [RARE.get(verb, 1.0) for verb in verbs])[0]
    words = rng.choice(COMMANDS[verb]).split()
    given = {word[1:-1]: good[word[1:-1]] for word in words if re.fullmatch(r"\{\w+\}", word) and word != "{out}"}
    place, out = home / "case", home / "case" / "out"
    place.mkdir()
    targets = []
    for name, path in given.items():
        copy = given[name] = place / path.relative_to(good["campaign"].parent)
        copy.parent.mkdir(parents=True, exist_ok=True)
        inside = [p for p in path.rglob("*") if p.is_file()] if path.is_dir() else [path]
        for each in inside:
            to = place / each.relative_to(good["campaign"].parent)
            to.parent.mkdir(parents=True, exist_ok=True)
            to.write_bytes(each.read_bytes())
            targets += [to] if to.suffix in DAMAGES and name != "plain" else []
    target = rng.choice(targets)
    how, damaged = DAMAGES[target.suffix](rng, target.read_bytes())
    target.write_bytes(damaged)
    called = [verb, *(word.format(**{**given, "out": out}) for word in words)]
    began = time.monotonic()
    code = _forked(called, place)
    seconds = time.monotonic() - began
    said = (place / "stderr").read_text(errors="replace")
    faults = tuple(_faults(verb, words, code, said, out))
    return Case(seed, verb, str(target.relative_to(place)), how, code, seconds, said, faults)


def _forked(words: Sequence[str], place: Path) -> int | None:
    """The exit code of `vpp` with these words in a fork of this process; None after its time, negative after a signal."""
    sys.stdout.flush()
    child = os.fork()
    if not child:
        code = 1
        try:
            os.setsid()
            os.chdir(place)
            resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
            resource.setrlimit(resource.RLIMIT_CPU, (LIMIT, LIMIT + 5))
            for number, name in ((1, "stdout"), (2, "stderr")):
                os.dup2(os.open(name, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o644), number)
                setattr(sys, name, open(number, "w", encoding="utf-8"))  # noqa: SIM115
            os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
            code = vpp(list(words))
        except SystemExit as ended:
            code = ended.code if isinstance(ended.code, int) else 1
        except BaseException:  # as the interpreter would end
            traceback.print_exc()
        finally:
            with contextlib.suppress(Exception):
                sys.stdout.flush()
                sys.stderr.flush()
            os._exit(code)
    end = time.monotonic() + LONGEST
    try:
        while time.monotonic() < end:
            done, status = os.waitpid(child, os.WNOHANG)
            if done:
                code = os.waitstatus_to_exitcode(status)
                return None if code == -signal.SIGXCPU else code
            time.sleep(0.01)
        os.killpg(child, signal.SIGKILL)
        os.waitpid(child, 0)
        return None
    finally:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(child, signal.SIGKILL)


def _faults(verb: str, words: Sequence[str], code: int | None, said: str, out: Path) -> Iterator[str]:
    if code is None:
        yield "over 60 s"
    elif code not in (0, 2):
        yield "exit code"
    if "Traceback" in said:
        yield "traceback"
    lines = [line for line in said.splitlines() if not NOTE_OR_STAGE.fullmatch(line)]
    if code == 2 and len(lines) != 1 and verb not in ("hil", "twin"):  # these print more as they run
        yield "not one line"
    files = [path for path in out.rglob("*") if path.is_file()]
    if any(".part" in path.name or "vpp-scratch" in str(path) for path in files):
        yield "half-written"
    if code == 2 and files and verb not in ("check", "hil", "twin"):  # an ended run keeps its files, by design
        yield "half-written"
    for path in files:
        if path.suffix == ".json" and not valid(path):
            yield "NaN in JSON"


def valid(path: Path) -> bool:
    """Whether a file is JSON without NaN and Infinity, which Python's reader accepts."""
    try:
        json.loads(path.read_text(), parse_constant=int)  # ValueError
    except ValueError:
        return False
    return True


def cases(first: int, runs: int, verbs: Sequence[str] = tuple(COMMANDS), minutes: float = 1e9) -> Iterator[Case]:
    """The cases of `runs` seeds from `first` on, or as many as the minutes allow."""
    end = time.monotonic() + 60.0 * minutes
    for verb in verbs:  # imported once, and not in every fork
        parser_of(verb)
    with tempfile.TemporaryDirectory() as name:
        home = Path(name)
        good = made_apart(home, verbs)
        for seed in range(first, first + runs):
            if time.monotonic() > end:
                return
            yield run_case(seed, good, home, verbs)
            shutil.rmtree(home / "case")


def made_apart(home: Path, verbs: Iterable[str]) -> dict[str, Path]:
    """`materials`, made in a fork, so that this process loads no FMU and starts no thread."""
    (home / "good").mkdir()
    if not (child := os.fork()):
        code = 1
        try:
            paths = {name: str(path) for name, path in materials(home / "good", verbs).items()}
            (home / "good.json").write_text(json.dumps(paths))
            code = 0
        except BaseException:
            traceback.print_exc()
        finally:
            os._exit(code)
    if os.waitpid(child, 0)[1]:
        raise RuntimeError("the study's own files cannot be made")
    return {name: Path(path) for name, path in json.loads((home / "good.json").read_text()).items()}


def shown(found: Sequence[Case]) -> Iterator[str]:
    """The lines of the table: exit codes and faults of each verb, and examples of each fault."""
    heads = " ".join(f"{fault:>12}" for fault in FAULTS)
    yield f"{'verb':13} {'cases':>6} {'exit 0':>7} {'exit 2':>7} {heads} {'slowest':>9}"
    for verb in [*dict.fromkeys(case.verb for case in found), None]:
        own = [case for case in found if verb in (None, case.verb)]
        counts = Counter(fault for case in own for fault in set(case.faults))
        ends = Counter(case.code for case in own)
        line = f"{verb or 'all':13} {len(own):6} {ends[0]:7} {ends[2]:7} " + " ".join(f"{counts[f]:12}" for f in FAULTS)
        yield f"{line} {max(case.seconds for case in own):7.1f} s"
    for fault in FAULTS:
        for case in [case for case in found if fault in case.faults][:8]:
            last = " ".join(case.said.split())[-300:]
            yield f"{fault}: seed {case.seed}, {case.verb}, {case.file}, {case.how}: exit {case.code}, {last}"


def main(parser, arguments):
    parser.add_argument("--runs", type=int, default=2000, metavar="N", help="cases (default: %(default)s)")
    parser.add_argument("--first-seed", type=int, default=0, metavar="S", help="of the first case (default: %(default)s)")
    parser.add_argument("--verbs", default=",".join(COMMANDS), metavar="A,B", help="of %(default)s")
    parser.add_argument("--minutes", type=float, default=1e9, metavar="M", help="end after the case that is run then")
    options = parser.parse_args(arguments)
    began, found = time.monotonic(), []
    for case in cases(options.first_seed, options.runs, options.verbs.split(","), options.minutes):
        found.append(case)
        if case.faults:
            print(f"seed {case.seed}: {', '.join(case.faults)}", flush=True)
    print("\n".join(shown(found)))
    print(f"{len(found)} cases in {time.monotonic() - began:.0f} s")
