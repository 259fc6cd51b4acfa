"""python -m tests.studies hidden: what does `vpp diagnose` name on the emulated rig, with each hidden effect at three sizes?

The rig has the paper's whole physics (hil/physics), so that its model lacks something already with nothing hidden: that is the
first case. Each case is the two documented commands, `vpp hil campaign --virtual --hide EFFECT=SIZE` and `vpp diagnose`, in a
separate process, and becomes a line of a file as soon as it is done. The names that count as right are listed below.
"""

import contextlib
import io
import json
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from hil.emulator.rig import NEAREST
from hil.physics.rig_model import library
from vpp_fmu.app.cli import main as vpp
from vpp_fmu.digits import number
from vpp_fmu.kernel.types import Effect

from .rows import add_options, completed, peak

TIMES = (0.5, 1.0, 2.0)
"""Sizes over the documented one. If the largest is beyond what the rig allows, all are half as large."""

OWN = ("speed_dependent_lag", "pitch_speed_coupling", "pitch_rate_limit", "pitch_speed_limits", "inflow_lag")
"""Effects of the rig with nothing hidden: quadratic drag, pitch that loads the rotor, an actuator whose drive ends, inflow."""

RELATED = {
    "lac_command_deadband": ("pitch_stop_restart", "pitch_error_deadzone", "pitch_stop_band"),
    "lac_stop_band": ("pitch_stop_restart", "pitch_error_deadzone", "pitch_command_deadband"),
    "rod_speed_limit": ("pitch_rate_limit",),
    "linkage_resonance": ("stand_resonance",),
    "supply_droop": ("speed_saturation", "supply_voltage"),
    "motor_heating": ("supply_sag",),
    "load_cell_drift": ("thrust_gain_drift",),
}
"""Names of the library that these data may hardly distinguish from the nearest one (`hil.emulator.rig.NEAREST`)."""


def sizes(effect: Effect) -> list[float]:
    """Values of its first parameter: TIMES the documented distance from off; or times its value, if off is without a limit."""
    p = effect.parameters[0]
    off, documented = effect.off[p.name], effect.probe[p.name]
    zero = 0.0 if off == p.maximum else off

    def at(share: float) -> float:
        return zero + share * (documented - zero)

    halved = 1.0 if at(TIMES[-1]) <= p.maximum else 0.5
    return [at(halved * k) for k in TIMES]


@dataclass(frozen=True)
class RigCase:
    """A campaign of the emulated rig. `hidden`: NAME=SIZE, or "" for nothing; `seed` of the rig."""

    hidden: str
    seed: int

    @property
    def name(self) -> str:
        """Name in the table."""
        return f"{self.hidden or 'nothing'} #{self.seed}"

    def summary(self) -> dict:
        """Entries of a row."""
        return {"name": self.name, "hidden": self.hidden}


def outcome(case: RigCase) -> dict:
    """Measure the campaign, diagnose it: a row."""
    began = time.process_time()
    with tempfile.TemporaryDirectory() as folder:
        hide = ["--hide", case.hidden] if case.hidden else []
        measured, found = f"{folder}/campaign", f"{folder}/found"
        _run("hil", "campaign", "--virtual", *hide, "--seed", str(case.seed), "-o", measured)
        half = time.process_time()
        _run("diagnose", measured, "--workers", "1", "-o", found)
        content = json.loads(Path(found, "diagnosis.json").read_text())
    row = case.summary() | {"failed": None, "verdict": content["verdict"], "channels": content["channels"]}
    row |= {"family": content["family"], "learned": (term := content["learned"]) and [term["port"], term["driver"]]}
    row |= {"effects": {e["name"]: {n: p["value"] for n, p in e["parameters"].items()} for e in content["effects"]}}
    row |= {"error": [content[when]["rmse_thrust"] for when in ("before", "after")], "noise": content["noise_floor_thrust"]}
    return row | {"measuring": half - began, "cpu": time.process_time() - half, "mb": peak()}


def _run(*words: str) -> None:
    """One verb of the command line; RuntimeError if it fails."""
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()) as said:
        code = vpp([*words, "--quiet"])
    if code:
        raise RuntimeError(f"vpp {words[0]} ended with {code}: {said.getvalue().strip().splitlines()[-1:]}")


def main(parser, arguments):
    known = {e.name: e for e in library(commanded=False) if e.off is not None}
    parser.add_argument("--hide", default=",".join(["nothing", *known]), metavar="A,B", help="of %(default)s")
    parser.add_argument("--seeds", type=int, default=1, metavar="N", help="rigs of each size (default: %(default)s)")
    add_options(parser, "out/hidden.jsonl", saves=False)
    options = parser.parse_args(arguments)
    asked = options.hide.split(",")
    if unknown := set(asked) - {"nothing", *known}:
        raise SystemExit(f"not known: {', '.join(sorted(unknown))}; known: nothing, {', '.join(known)}")
    hidden = ["" for name in asked if name == "nothing"]
    hidden += [f"{name}={size:.6g}" for name in asked if name in known for size in sizes(known[name])]
    seeds = range(options.first_seed, options.first_seed + options.seeds)
    print(table(completed(options, [RigCase(words, seed) for words in hidden for seed in seeds], outcome)))


def group(c: dict) -> str:
    """How the hidden effect is named: "right", "related", "other" (a name of neither), "learned", "own only" (the rig's OWN
    effects alone), "says so" (no name, something is missing), "none" or "failed"."""
    if c["failed"]:
        return "failed"
    hidden = c["hidden"].partition("=")[0]
    names = [{name, *c["family"].get(name, ())} for name in c["effects"]]
    right, related = {NEAREST.get(hidden)}, {*RELATED.get(hidden, ())}
    if any(own & right for own in names):
        return "right"
    if any(own & related for own in names):
        return "related"
    if others(c):
        return "other"
    if c["learned"]:
        return "learned"
    return "own only" if names else "none" if c["verdict"] == "none" else "says so"


def others(c: dict) -> list[str]:
    """Names that are neither of the hidden effect nor of the rig itself."""
    hidden = c["hidden"].partition("=")[0]
    known = {NEAREST.get(hidden), *RELATED.get(hidden, ()), *OWN, "learned"}
    return [name for name in c["effects"] if not {name, *c["family"].get(name, ())} & known]


def table(cases: Sequence[dict]) -> str:
    """A line for each case, then counts."""
    lines = [f"{'hidden':34} {'is':9} {'verdict':12} {'cpu s':>6}  N before, after (noise)"]
    lines += [text for c in cases for text in _lines(c)]
    groups = [group(c) for c in cases if c["hidden"]]
    lines.append("")
    lines.append(f"of {len(groups)} hidden effects: " + ", ".join(f"{n} {groups.count(n)}" for n in dict.fromkeys(groups)))
    more = sum(bool(others(c)) for c in cases if not c["failed"])
    lines.append(
        f"a name that is neither of the hidden effect nor of the rig itself ({', '.join(OWN)}): {more} of {len(cases)}"
    )
    return "\n".join(lines)


def _lines(c: dict) -> list[str]:
    if c["failed"]:
        return [f"{c['name']:34} FAILED {c['failed']}"]
    before, after, noise = map(number, (*c["error"], c["noise"]))
    first = f"{c['name']:34} {group(c):9} {c['verdict']:12} {c['cpu']:6.0f}  {before}, {after} ({noise})"
    return [first, *(f"{'':4}{one}: {part['verdict']}{_named(c, part['effects'])}" for one, part in c["channels"].items())]


def _named(c: dict, names: Sequence[str]) -> str:
    words = []
    for name in names:
        sized = ", ".join(f"{n} {number(v)}" for n, v in c["effects"].get(name, {}).items())
        families = "".join(f" ~ {other}" for other in c["family"].get(name, ()))
        words.append(f"{name}{families} ({sized})")
    return "".join(f"; {text}" for text in words)
