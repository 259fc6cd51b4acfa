"""A finding of the quality gate: the fault, its evidence as a number, the likely cause, and advice."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from vpp_fmu.errors import BadInput

ERROR, WARNING = "error", "warning"


@dataclass(frozen=True)
class Kind:
    """Meaning of a code, and advice. `accept`: effect of `--accept CODE`; "": it cannot be accepted."""

    level: str
    meaning: str
    advice: str
    accept: str = ""


_GO_ON = "continues with the data unchanged"
_KEEP = "keeps the rows"

KINDS = {
    "too_short": Kind(ERROR, "too few rows, seconds or readings to show a lag", "Record longer, or leave the file out"),
    "no_move": Kind(WARNING, "both commands are constant", "Move at least one; a record at rest identifies one thrust only"),
    "no_commands": Kind(ERROR, "no command moves while the rotor does", "Log the commands, row by row"),
    "thrust_dead": Kind(ERROR, "the thrust never changes", "Look at the load cell and its wires"),
    "copied": Kind(ERROR, "a file has the readings of another one", "Remove the file, so that it counts as missing"),
    "seen_commands": Kind(
        WARNING,
        "validation.csv repeats the commands of a fitted record",
        "Name it repeat.csv, and measure other commands as validation.csv",
    ),
    "time_unit": Kind(ERROR, "responses are slower or faster than any rotor's", "Write seconds", _GO_ON),
    "speed_unit": Kind(ERROR, "speed in rad/s, Hz or deg/s, or electrical speed", "Write rpm of the rotor", _GO_ON),
    "pitch_unit": Kind(ERROR, "pitch in rad, or as a share of its travel", "Write degrees", _GO_ON),
    "thrust_unit": Kind(ERROR, "thrust in gf, kgf, lbf, ozf, mN or kN", "Write newtons", _GO_ON),
    "thrust_sign": Kind(
        ERROR,
        "thrust counts downwards",
        "Import the log again, --map thrust=COLUMN:'-1 UNIT' (torque, too), or import rcbenchmark --backwards",
        _GO_ON,
    ),
    "pitch_sign": Kind(ERROR, "thrust decreases with pitch", "Import the log again, --map beta_ref=COLUMN:'-1 UNIT'", _GO_ON),
    "speed_dead": Kind(
        WARNING, "the measured speed is constant while its command moves", "Look at the mark and its sensor", _KEEP
    ),
    "frozen": Kind(WARNING, "a reading is constant despite noise or a moving command", "Look at wires and logger", _KEEP),
    "clipped": Kind(WARNING, "readings at the sensor's limit", "Measure with more range, or less thrust", _KEEP),
    "spikes": Kind(WARNING, "single readings far from their neighbours", "Look at wires and shield", _KEEP),
    "speed_multiple": Kind(
        WARNING, "the measured speed is doubled or halved for a while", "Look at the marks and their sensor", _KEEP
    ),
    "run_in": Kind(WARNING, "a record begins before the rig has settled", "Hold the first command before the log begins"),
    "gap": Kind(WARNING, "rows are missing", "Log without gaps", _KEEP),
    "speed_off": Kind(WARNING, "the measured speed does not follow its command", "Look at both columns"),
    "not_logged": Kind(WARNING, "a command is constant while its measured value moves", "Log the commands, row by row"),
    "early": Kind(
        WARNING,
        "the response begins before its command",
        "Nothing: the fit corrects it; vpp import --mend corrects the file",
    ),
    "tare": Kind(WARNING, "the thrust reading has an offset", "Tare at rest, or correct the column; else vpp diagnose"),
    "zero_drift": Kind(WARNING, "the thrust reading at rest drifts", "vpp diagnose, of which sensor_drift is a candidate"),
    "zero_jump": Kind(ERROR, "the thrust reading at rest jumps", "Import the file with vpp import, which levels it", _GO_ON),
    "disagree": Kind(WARNING, "files differ in thrust at the same commands", "Measure all files on one rig"),
    "beyond_rig": Kind(WARNING, "commands or readings are outside the ranges of rig.json", "Correct rig.json, or the file"),
    "on_bound": Kind(WARNING, "a fitted parameter is at its bound", "Look at units and scales; it is no estimate"),
    "poor_fit": Kind(WARNING, "the fit explains less than half", "Compare the record with its prediction"),
    "above_noise": Kind(WARNING, "the error is far above the noise", "vpp diagnose"),
    "thin": Kind(
        WARNING, "the commands do not identify all parameters", "More moves over the whole range; vpp plan proposes them"
    ),
    "slow_sampling": Kind(WARNING, "the sampling period is longer than a fifth of the fastest lag", "Log more often"),
    "narrowed": Kind(
        WARNING,
        "validation.csv was used to estimate a threshold",
        "Use vpp plan, and measure the proposed commands as a new validation.csv",
    ),
    "power": Kind(WARNING, "torque or power contradicts itself, or does not suffice for a map", "Look at signs and units"),
    "no_motor": Kind(WARNING, "torque and power in a record only", "Measure steady points with both"),
    "no_fit": Kind(ERROR, "no model can be fitted", "See above"),
}
"""Every finding of the gate, by code."""


@dataclass(frozen=True)
class Finding:
    """One finding. `value`, in `unit`: the evidence; `told`: the same in a sentence. `where`: the file's source; `field`: its
    column, or a parameter. `accepted`: the user accepts it."""

    code: str
    where: str
    field: str
    value: float
    unit: str
    told: str
    cause: str
    accepted: bool = False

    @property
    def level(self) -> str:
        return WARNING if self.accepted else KINDS[self.code].level

    @property
    def advice(self) -> str:
        return KINDS[self.code].advice

    @property
    def file(self) -> str:
        """The file without its folder."""
        return Path(self.where).name

    @property
    def text(self) -> str:
        """The finding in one line."""
        accepted = " (accepted)" if self.accepted else ""
        what = f"{self.level} {self.code}{accepted}: {self.file}, {self.field}"
        return f"{what}: {self.told}. Likely: {self.cause}. {self.advice}."

    def summary(self) -> dict:
        """For identification.json, diagnosis.json and check.json."""
        names = ("level", "code", "file", "field", "value", "unit", "told", "cause", "advice", "accepted")
        return {name: getattr(self, name) for name in names}


def acceptable() -> list[str]:
    """The codes that `--accept` takes."""
    return [code for code, kind in KINDS.items() if kind.accept]


def check_accepted(accept: Iterable[str]) -> frozenset[str]:
    """The codes that a user accepts. BadInput for a code that cannot be accepted."""
    accept = frozenset(accept)
    if unknown := sorted(accept - set(acceptable())):
        raise BadInput("command line", "--accept", ", ".join(unknown), f"any of {', '.join(acceptable())}")
    return accept


def settled(findings: Iterable[Finding], accept: frozenset[str]) -> tuple[Finding, ...]:
    """The findings, errors first; those of an accepted code are marked."""
    marked = [replace(f, accepted=True) if f.code in accept else f for f in findings]
    return tuple(sorted(marked, key=lambda f: f.level != ERROR))


def refuse(findings: Sequence[Finding]) -> None:
    """BadInput for the first error, if there is one."""
    errors = [f for f in findings if f.level == ERROR]
    if not errors:
        return
    first = errors[0]
    way_out = f", or --accept {first.code}" if KINDS[first.code].accept else ""
    more = f"; vpp check for {len(errors) - 1} more" if len(errors) > 1 else ""
    hint, allowed = f"{first.advice[:1].lower()}{first.advice[1:]}{way_out}{more}", "data that can be fitted"
    raise BadInput(first.where, first.field, f"{first.told} (likely: {first.cause})", allowed, hint)
