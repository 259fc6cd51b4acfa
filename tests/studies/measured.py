"""python -m tests.studies measured FOLDER [--diagnose]: errors of campaigns and logs on data that no fit has seen.

FOLDER is a campaign, or contains campaigns, logs of a stand (one a day), or folders of these. Logs are those of RCbenchmark,
and any table beside which an import.toml defines the columns (`vpp import csv LOG --propose import.toml`). A campaign is
identified, exported, and its FMU run by fmpy on validation.csv. Of two logs that follow each other by name, each is fitted and
the other predicted by the same model, with the fitted one's map of the speed. The floor of a campaign is its noise. The floor
of a day is the error after the steady map alone is fitted to that day, because no lag explains the difference between days.
"""

import contextlib
import io
import tempfile
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

from identification.assessment.prediction import rmse
from identification.diagnose.diagnose import diagnose
from identification.diagnose.diagnosis import Diagnosis
from identification.fit.refine import refine
from identification.identify import identify
from identification.logs.delimited import read_delimited
from identification.logs.intake import clock_of
from identification.logs.mapping import FILE, Plan, parse_pairs
from identification.logs.rcbenchmark import preset
from identification.logs.sampling import SAMPLED
from vpp_fmu.app import cli
from vpp_fmu.app.report.summary import artefact
from vpp_fmu.campaign import NAMES, Campaign, read_campaign
from vpp_fmu.errors import BadInput, VppError
from vpp_fmu.export import python_fmu
from vpp_fmu.fmu import simulate_in_fmpy
from vpp_fmu.parameters import ParameterSet
from vpp_fmu.record import RecordWarning

MAP = ("c20", "c11", "c21", "c12", "c30")


@dataclass(frozen=True)
class Row:
    """One line of the table, errors in N: of the identified model, of the diagnosis' base and of its final model (None: not
    requested), and the floor (None: unknown)."""

    name: str
    identified: float
    before: float | None
    after: float | None
    floor: float | None
    verdict: str


def main(parser, arguments):
    parser.add_argument("folder", type=Path, metavar="FOLDER")
    parser.add_argument("--diagnose", action="store_true", help="also what the model lacks, and the error with it")
    options = parser.parse_args(arguments)
    rows = []
    try:
        for row in found(options.folder, options.diagnose):
            rows.append(row)
    except VppError as error:
        raise SystemExit(str(error)) from error
    print(table(rows))


def found(folder: Path, look: bool) -> Iterator[Row]:
    """A row for each campaign, and two for each pair of logs, in a folder and its subfolders. BadInput if there is none."""
    if not folder.is_dir():
        raise BadInput(folder, "folder", "no folder", "a campaign, or a folder of campaigns or of a stand's logs")
    rows = 0
    for place in (folder, *sorted(p for p in folder.iterdir() if p.is_dir())):
        if is_campaign(place):
            yield of_campaign(read_campaign(place), look)
            rows += 1
            continue
        for one, other in pairwise(logs(place)):
            for fitted, predicted in ((one, other), (other, one)):
                yield of_days(fitted, predicted, look)
                rows += 1
    if not rows:
        allowed = f"a campaign, two logs of RCbenchmark, or two tables beside an {FILE} that says what their columns are"
        raise BadInput(folder, "files", ", ".join(sorted(p.name for p in folder.iterdir())[:8]) or "none", allowed)


def is_campaign(folder: Path) -> bool:
    """Whether a folder holds a file of a campaign."""
    return any(f.name.partition(".")[0] in NAMES for f in folder.glob("*.csv*"))


def logs(folder: Path) -> list[Path]:
    """The logs of a folder by name, if they are records in time; for each other file a line says why it is left out."""
    kept, mapping = [], (folder / FILE).exists()
    for path in sorted(p for p in folder.iterdir() if p.is_file() and p.name != FILE):
        why = "" if mapping else _no_record(path)
        if why:
            print(f"{path.name}: left out: {why}")
        else:
            kept.append(path)
    return kept


def _no_record(path: Path) -> str:
    """Why a file is no record of an RCbenchmark stand; empty if it is one."""
    if ".csv" not in path.suffixes:
        return f"neither a log of RCbenchmark nor a table with an {FILE} beside it"
    try:
        table = read_delimited(path, {})
        plan = Plan(parse_pairs(preset(table, (), False), table))
        averages = clock_of(table, plan, "record", None).step > SAMPLED
        return "averages, so steady points and no record" if averages else ""
    except BadInput as error:
        return str(error).removeprefix(f"{path}: ")


def of_campaign(campaign: Campaign, look: bool) -> Row:
    """A campaign by its validation record if it has one, else cross-validated."""
    known, name = identify(campaign), campaign.folder.name
    floor = known.noise.std
    text = f"{name}: noise of one reading {floor:.4g} N ({known.noise.basis})"
    error = known.predictions[known.fitted[0]].rmse_thrust
    if campaign.validation is not None:
        error = in_fmpy(known.parameters, campaign)
        text += f"; rmse on validation.csv {error:.4g} N through the FMU in fmpy"
        text += f", fit {known.predictions['validation'].fit_thrust:.1f} %"
        text += f", {100 * known.coverage['validation']:.1f} % of the readings in the 95 % band"
    print(text, flush=True)
    if not look:
        return Row(name, error, None, None, floor, "")
    seen = diagnose(campaign)
    if campaign.validation is not None:
        before, after = (in_fmpy(seen.parameters(fit), campaign) for fit in (seen.base, seen.final))
    else:
        before, after = (seen.errors(fit)[0] for fit in (seen.base, seen.final))
    _say(name, seen, before, after, "on validation.csv" if campaign.validation is not None else "cross-validated")
    return Row(name, error, before, after, floor, _verdict(seen))


def of_days(fitted: Path, other: Path, look: bool) -> Row:
    """One day's log is fitted, and the other predicted by the same model."""
    with tempfile.TemporaryDirectory() as place:
        return _of_days(days(fitted, other, Path(place, fitted.stem)), fitted, other, look)


def _of_days(campaign: Campaign, fitted: Path, other: Path, look: bool) -> Row:
    name = f"{fitted.stem} -> {other.stem}"
    known = identify(campaign)
    day, own = known.predictions["validation"], known.predictions["open_loop"]
    print(
        f"{fitted.stem} fitted: {own.rmse_thrust:.3f} N, fit {own.fit_thrust:.1f} %; "
        f"{other.stem} as it stands: {day.rmse_thrust:.3f} N, fit {day.fit_thrust:.1f} %, "
        f"held: {', '.join(known.refinement.held) or 'none'}",
        flush=True,
    )
    if not look:
        return Row(name, day.rmse_thrust, None, None, map_of_the_day(known.parameters, campaign), "")
    seen = diagnose(campaign)
    before, after = (seen.errors(fit)[0] for fit in (seen.base, seen.final))
    floor = map_of_the_day(seen.parameters(seen.final), campaign)
    _say(fitted.stem, seen, before, after, "other day")
    return Row(name, day.rmse_thrust, before, after, floor, _verdict(seen))


def days(fitted: Path, other: Path, place: Path) -> Campaign:
    """Two logs as open-loop and validation record of a campaign in the folder `place`, by `vpp import` as a user would, with
    the fitted day's map of the speed. BadInput."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RecordWarning)
        for log, kind in ((fitted, "open_loop"), (other, "validation")):
            toml = log.parent / FILE
            words = ["csv", str(log), "--map", str(toml)] if toml.exists() else ["rcbenchmark", str(log)]
            printed = io.StringIO()
            with contextlib.redirect_stdout(printed), contextlib.redirect_stderr(printed):
                failed = cli.main(["import", *words, "--as", kind, "-o", str(place)])
            if failed:
                raise BadInput(log, "log", printed.getvalue().strip().splitlines()[-1], "one that vpp import takes in")
        return read_campaign(place)


def map_of_the_day(parameters: ParameterSet, campaign: Campaign) -> float:
    """Thrust error [N] on the other day, with the steady map alone fitted to it."""
    record = campaign.validation
    there = refine(parameters.model, [record], parameters.values, MAP, channels=("thrust",))
    return rmse(there.problem.thrust_errors(there.values)[0])


def in_fmpy(parameters: ParameterSet, campaign: Campaign) -> float:
    """Thrust error (N) on the validation record of the exported FMU, run by fmpy."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "VppPlant.fmu")
        path.write_bytes(python_fmu(parameters.model, parameters.values))
        return rmse(simulate_in_fmpy(path, campaign.validation) - campaign.validation["thrust"])


def _verdict(seen: Diagnosis) -> str:
    refuted = f" (refuted: {', '.join(seen.selection.final.effects)}: {seen.refuted})" if seen.refuted else ""
    return f"{seen.verdict}: {', '.join(seen.final.effects) or 'no effect'}{refuted}"


def _say(name: str, seen: Diagnosis, before: float, after: float, where: str) -> None:
    print(f"{name}: {_verdict(seen)}; {where} {before:.4g} N before, {after:.4g} N after", flush=True)
    for effect, judged in seen.selection.judgements.items():
        gains = ", ".join(f"{channel} {gain:+.4g}" for channel, gain in judged.gain.items())
        note = artefact(seen, effect)
        print(
            f"  {effect}: evidence {judged.evidence:.4g} nats; cross-validated {gains}" + f"; {note}" * bool(note), flush=True
        )


def table(rows: list[Row]) -> str:
    """A line for each row, N."""
    width = max((len(r.name) for r in rows), default=0)
    lines = [f"{'N':{width}}  identified  before   after   floor  verdict"]
    for r in rows:
        cells = ["       -" if x is None else f"{x:8.4g}" for x in (r.before, r.after, r.floor)]
        lines.append(f"{r.name:{width}}  {r.identified:10.4g}{''.join(cells)}  {r.verdict}".rstrip())
    return "\n".join(lines)
