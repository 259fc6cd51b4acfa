"""python -m tests.studies degenerate: every verb over incomplete and unusual campaigns (incomplete_campaigns.py).

Each must end with its files, a report and strictly valid JSON, or with exit 2 and one line that states the error; no traceback,
no warning of numpy; no verb refuses what another wrote. Parameters that are not identifiable must be named, and the others must
be right, since the truth is known here.
"""

import contextlib
import io
import json
import re
import tempfile
import time
import traceback
import warnings
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from identification.fit.refine import BASE_PARAMETERS
from vpp_fmu.app.cli import VERBS
from vpp_fmu.app.cli import main as vpp

from .incomplete_campaigns import CASES, LONG, SIZES, Case, scale_parameters

NOTE_OR_STAGE = re.compile(r"vpp: note: .*|vpp \w+: .* \(\d+ s\)")
"""Lines that a verb prints although it succeeds: notes, and stages in a pipe."""

FAR = 5.0
"""Allowed error of an identifiable parameter in standard deviations: by chance one of two million exceeds it."""

BENT = {
    "steps only": "lags of the thrust, not of what is behind it",
    "from standstill": "its record does not start settled",
    "starts mid-flight": "its record does not start settled",
    "huge offset": "no model of thrust has an offset of three times its scale",
    "dead load cell": "nothing was measured",
    "static of zeros": "its steady points contradict its records",
    "pitch 12 to 25 deg": "the truth in these scales has a term that the paper's map lacks",
    "nothing missing, rig not declared": "the truth in these scales has a term that the paper's map lacks",
}
"""Campaigns whose parameters are not compared with the truth, and the reason."""

FIRST = ("check", "identify", "diagnose")
"""Verbs that take the campaign; the others follow an identification."""

FOLLOWED = ("fixed pitch", "fixed speed", "one move only", "static map only", "steps only", "validation only", "no noise")
"""Campaigns whose parameters are used for a plan, for FMUs and for their closed loop."""

TUNED = ("fixed pitch", "static map only", "fixed speed")
"""Campaigns for whose parameters gains are tuned: half a minute each."""

NEEDED = {
    "check": (),
    "identify": ("parameters.json", "parameters.ssv", "identification.json", "report.html"),
    "diagnose": ("diagnosis.json", "parameters.json", "parameters_base.json", "report.html"),
    "simulate": ("prediction.csv",),
    "compare": ("comparison.json", "report.html"),
    "plan": ("plan.csv", "plan.json", "report.html"),
    "export": ("VppPlant.fmu", "VppController.fmu"),
    "cosim": ("run.csv", "report.html"),
    "tune": ("tuning.json", "report.html"),
}
"""Files that a verb must write."""


@dataclass(frozen=True)
class Row:
    """Result of a verb on a campaign: `outcome` in words, and `fault` ("" if there is none)."""

    verb: str
    campaign: str
    outcome: str
    fault: str
    seconds: float


def run(verb: str, arguments: Sequence[str], out: Path) -> tuple[int | None, list[str], str]:
    """(exit code, or None after a traceback; lines on standard error but for notes; the traceback's last line) of a verb."""
    said, printed = io.StringIO(), io.StringIO()
    try:
        with warnings.catch_warnings(), contextlib.redirect_stderr(said), contextlib.redirect_stdout(printed):
            warnings.simplefilter("error")
            code = vpp([verb, *arguments, "-o", str(out)])
    except Exception as error:  # any exception is a finding
        where = traceback.extract_tb(error.__traceback__)[-1]
        return None, [], f"{type(error).__name__}: {error} ({Path(where.filename).name}, {where.name})"
    return code, [line for line in said.getvalue().splitlines() if not NOTE_OR_STAGE.fullmatch(line)], ""


def judged(verb: str, name: str, arguments: Sequence[str], out: Path) -> Row:
    """Run a verb and check its files."""
    began = time.perf_counter()
    code, lines, broken = run(verb, arguments, out)
    seconds = time.perf_counter() - began
    if broken:
        return Row(verb, name, broken, "traceback", seconds)
    if code != 0:
        fault = "" if code == 2 and len(lines) == 1 else f"exit {code} with {len(lines)} lines"
        line = " ".join(lines).replace(f"{out.parent}/", "").replace(f"vpp {verb}: ", "")
        return Row(verb, name, f"exit {code}: {line}", fault, seconds)
    missing = [file for file in NEEDED[verb] if not (out / file).exists()]
    invalid = [path.name for path in sorted(out.glob("*.json")) if not valid(path)]
    fault = f"no {', '.join(missing)}" if missing else f"invalid JSON: {', '.join(invalid)}" if invalid else ""
    fault = fault or ("said on standard error: " + lines[0] if lines else "")
    return Row(verb, name, ", ".join(sorted(path.name for path in out.iterdir())), fault, seconds)


def valid(path: Path) -> bool:
    """Whether a file is JSON without NaN and Infinity, which Python's reader accepts."""

    def refused(constant: str):
        raise ValueError(constant)

    try:
        json.loads(path.read_text(), parse_constant=refused)
    except ValueError:
        return False
    return True


def identified(row: Row, case: Case, out: Path) -> Row:
    """The row with the identification's results; a fault if a parameter is neither identified nor named, or is wrong."""
    found = json.loads((out / "identification.json").read_text())
    values, unidentified = found["parameters"], found["not_identifiable"]
    size = SIZES[case.size]
    errors = [f"{error / size.noise:.2f}" for error in found["rmse_thrust"].values() if error is not None]
    outcome = f"{len(set(values) - set(unidentified))} of {len(BASE_PARAMETERS)} told"
    outcome += f", not {', '.join(unidentified)}" if unidentified else ""
    outcome += f"; thrust error {', '.join(errors)} x noise" if errors else "; no record to judge by"
    silent = [n for n in BASE_PARAMETERS if n not in values and n not in unidentified]
    # A parameter that is held biases those that it is combined with; the reasons name them.
    bent = " ".join(unidentified.values())
    checked = [n for n in values if n not in unidentified and n not in bent] if row.campaign not in BENT else []
    off = {n: abs(values[n]["value"] - size.truth[n]) / values[n]["std"] for n in checked if values[n]["std"]}
    covered = {n for n in off if values[n]["interval"][0] <= size.truth[n] <= values[n]["interval"][1]}  # it may be asymmetric
    wrong = [f"{n} off by {pull:.0f} sd" for n, pull in off.items() if pull > FAR and n not in covered]
    fault = f"not named: {', '.join(silent)}" if silent else ", ".join(wrong)
    return replace(row, outcome=outcome, fault=row.fault or fault)


def diagnosed(row: Row, out: Path) -> Row:
    """The row with the diagnosis' verdict."""
    found = json.loads((out / "diagnosis.json").read_text())
    effects = " + ".join(effect["name"] for effect in found["effects"])
    before, after = (found[when]["rmse_thrust"] for when in ("before", "after"))
    outcome = f"{found['verdict']}{f' ({effects})' if effects else ''}, {before:.4g} -> {after:.4g} N"
    return replace(row, outcome=outcome)


def rows(
    names: Iterable[str], verbs: Sequence[str], folder: Path, options: Mapping[str, Sequence[str]] | None = None
) -> Iterator[Row]:
    """Each verb on each campaign by name, written below `folder`; `options`: further arguments by verb."""
    for name in names:
        case, home = CASES[name], folder / name.replace(" ", "_").replace(",", "")
        case.write(home)
        for verb in (v for v in FIRST if v in verbs):
            row, out = judged(verb, name, [str(home), *(options or {}).get(verb, ())], home / verb), home / verb
            if verb == "identify" and (out / "identification.json").exists() and not row.fault:
                row = identified(row, case, out)
            if verb == "diagnose" and (out / "diagnosis.json").exists() and not row.fault:
                row = diagnosed(row, out)
            yield row
        if (home / "identify" / "parameters.json").exists():
            yield from _verbs_after_identify(name, case, verbs, home)


def _verbs_after_identify(name: str, case: Case, verbs: Sequence[str], home: Path) -> Iterator[Row]:
    """Verbs that take the parameters of an identification."""
    given = ["--parameters", str(home / "identify" / "parameters.json")]
    record = next((home / f"{n}.csv" for n in LONG if (home / f"{n}.csv").exists()), None)
    calls: dict[str, list[str]] = {}
    if record is not None:
        calls["simulate"] = [str(record), *given]
        calls["compare"] = [str(record), str(home / "simulate" / "prediction.csv")]
    if name in FOLLOWED:
        known = ["--knowledge", str(home / "identify" / "identification.json")]
        time_scale = json.loads((home / "identify" / "parameters.json").read_text())["source"]["rig"]["scales"]["time_scale"]
        calls["plan"] = [*given, *known, "--seconds", f"{20.0 * time_scale:g}"]
        calls["export"] = given
        fmus = [str(home / "export" / f"Vpp{part}.fmu") for part in ("Plant", "Controller")]
        calls["cosim"] = [*fmus, "--profile", str(_profile(case, home)), "--step", "0.01"]
    if name in TUNED:
        calls["tune"] = given
    for verb, arguments in calls.items():
        if verb in verbs:
            row = judged(verb, name, arguments, home / verb)
            if verb == "tune" and not row.fault:
                row = tuned(row, home / verb)
            yield replace(row, fault=row.fault or "refuses what identify wrote") if row.outcome.startswith("exit") else row


def tuned(row: Row, out: Path) -> Row:
    """The row; a fault if gains are missing without a reason."""
    left_out = json.loads((out / "tuning.json").read_text())["left_out"]
    files = {"dual": "gains.json", "speed_only": "gains_speed_only.json"}
    missing = [file for name, file in files.items() if name not in left_out and not (out / file).exists()]
    return replace(row, fault=f"no {', '.join(missing)}") if missing else row


def _profile(case: Case, home: Path) -> Path:
    """A step of the thrust set-point."""
    full, path = scale_parameters(SIZES[case.size].scales)["thrust_scale"], home / "profile.csv"
    path.write_text(f"time,thrust_set\n0,{0.2 * full}\n2,{0.5 * full}\n6,{0.5 * full}\n")
    return path


def show(found: Sequence[Row]) -> None:
    """Print the table's foot, in which the counts of faults must be 0."""
    refused = sum(row.outcome.startswith("exit 2") for row in found)
    print(f"\n{len(found)} rows: {len(found) - refused} with their files, {refused} refused in one line")
    print(f"tracebacks {sum(row.fault == 'traceback' for row in found)}")
    print(f"invalid JSON {sum(row.fault.startswith('invalid JSON') for row in found)}")
    others = [row for row in found if row.fault and row.fault != "traceback" and not row.fault.startswith("invalid JSON")]
    print(f"other faults {len(others)}")


def line(row: Row) -> str:
    """A row of the table."""
    return f"{row.verb:9}| {row.campaign:37} | {row.outcome}" + (f" | FAULT: {row.fault}" if row.fault else "")


def main(parser, arguments):
    known = [verb for verb in NEEDED if verb in VERBS]
    parser.add_argument("--verbs", default=",".join(known), metavar="A,B", help="of %(default)s")
    parser.add_argument("--only", default="", metavar="WORD", help="campaigns whose name holds it")
    parser.add_argument("-o", "--output", metavar="DIR", help="keep campaigns and results there")
    options = parser.parse_args(arguments)
    names = [name for name in CASES if options.only in name]
    found = []
    with tempfile.TemporaryDirectory() as temporary:
        for row in rows(names, options.verbs.split(","), Path(options.output or temporary)):
            print(line(row), flush=True)
            found.append(row)
    show(found)
