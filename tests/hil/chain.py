"""The whole chain on the emulated rig: `python -m tests.hil.chain [EFFECT[=SIZE]] [-o DIR] [--seed N]`.

The unchanged rig is measured and diagnosed once; its model is the reference for later measurements. Then the rig gets a hidden
effect. A new campaign, `vpp identify`, `vpp diagnose --parameters` with the reference, and `vpp export` make three plant FMUs:
the reference, one identified anew, and one with the diagnosed effects. Each predicts a new record of the rig and runs beside it
in the loop. Every step is a user's command; the table has the thrust error of each FMU.
"""

import argparse
import json
import sys
import time
from pathlib import Path

import numpy as np

from hil.commands import validation
from hil.cycle import PERIOD
from vpp_fmu.app.cli import main as vpp
from vpp_fmu.files import OutputFolder
from vpp_fmu.fmu import simulate_in_fmpy
from vpp_fmu.record import Record, read_record, write_record

STEPS = {"time": np.array([0.0, 3.0, 6.0, 9.0, 12.0, 15.0]), "thrust_set": np.array([1.5, 12.0, 1.5, 6.0, 8.0, 8.0])}
LESS = ["--samples", "1000"]
"""A fifth of the paper's readings per point and three levels: the static map then takes 12 minutes, 20 s in virtual time."""


def command(*words: object) -> float:
    """Run a command and return its seconds. The chain ends if a command fails."""
    print("\n$ vpp", *words, flush=True)
    began = time.perf_counter()
    code = vpp([str(word) for word in words])
    if code:
        sys.exit(f"vpp {words[0]} ended with {code}")
    return time.perf_counter() - began


def rmse(fmu: Path, record: Record) -> float:
    """Thrust error of a plant FMU under the record's commands, by fmpy's own simulation [N]."""
    seen = np.isfinite(record["thrust"])
    return float(np.sqrt(np.mean((simulate_in_fmpy(fmu, record) - record["thrust"])[seen] ** 2)))


def chain(effect: str, out: Path, seed: int, more: list[str]) -> dict:
    """Measure, identify, diagnose, export, measure and run again; return the results."""
    rig, known = ["--virtual", "--hide", effect], out / "known" / "parameters.json"
    command("hil", "campaign", "--virtual", "--seed", seed, *more, "-o", out / "campaign_before")
    took = {"diagnose, before": command("diagnose", out / "campaign_before", "-o", known.parent)}
    took["campaign"] = command("hil", "campaign", *rig, "--seed", seed, *more, "-o", out / "campaign")
    took["identify"] = command("identify", out / "campaign", "-o", out / "identified")
    took["diagnose"] = command("diagnose", out / "campaign", "--parameters", known, "-o", out / "diagnosed")
    folder = OutputFolder(out)
    write_record(folder, "new_commands.csv", validation(seed + 1000, 60.0, PERIOD))
    write_record(folder, "steps.csv", Record(STEPS, ""))
    command("hil", "campaign", *rig, "--seed", seed + 1, "--commands", out / "new_commands.csv", "-o", out / "new")
    new = read_record(out / "new" / "record.csv", holes=("thrust",))
    verdict = json.loads((out / "diagnosed" / "diagnosis.json").read_text())
    found = {"effect": effect, "verdict": verdict["verdict"], "effects": [_effect_text(e) for e in verdict["effects"]]}
    found |= {"noise": verdict["noise_floor_thrust"], "seconds": took, "models": {}}
    for name in ("known", "identified", "diagnosed"):
        parameters = out / name / "parameters.json"
        command("export", "--parameters", parameters, "-o", out / f"fmus_{name}")
        fmu = out / f"fmus_{name}" / "VppPlant.fmu"
        loop = ["--profile", out / "steps.csv", "--beside", fmu, "-o", out / f"run_{name}"]
        command("hil", "run", *rig, "--seed", seed + 2, "--parameters", parameters, *loop)
        beside = json.loads((out / f"run_{name}" / "hil.json").read_text())["beside"]["rms_thrust"]
        found["models"][name] = {"new record": rmse(fmu, new), "in the loop": beside}
    return found


def _effect_text(effect: dict) -> str:
    sizes = (f"{n} {p['value']:.3g} {p['unit']}" for n, p in effect["parameters"].items() if n != "form")
    return f"{effect['name']} ({', '.join(sizes)})"


def main() -> None:
    """Run the chain and print its table."""
    parser = argparse.ArgumentParser(prog="python -m tests.hil.chain", description=__doc__)
    parser.add_argument("effect", nargs="?", default="lac_command_deadband=1", help="as --hide has it (default: %(default)s)")
    parser.add_argument("-o", "--output", default="chain", help="folder (default: chain)")
    parser.add_argument("--seed", type=int, default=3)
    parser.add_argument("--paper", action="store_true", help="as many readings as the paper takes")
    options = parser.parse_args()
    out = Path(options.output)
    found = chain(options.effect, out, options.seed, [] if options.paper else LESS)
    OutputFolder(out).write("chain.json", json.dumps(found, indent=2) + "\n")
    print(f"\nhidden: {found['effect']}; verdict: {found['verdict']}, {' and '.join(found['effects']) or 'nothing'}")
    print(f"{'thrust error of the FMU [N]':40} {'new record':>12} {'in the loop':>12}")
    titles = {"known": "the model of before", "identified": "identified anew", "diagnosed": "with what was found"}
    for name, errors in found["models"].items():
        print(f"{titles[name]:40} {errors['new record']:12.3f} {errors['in the loop']:12.3f}")
    took = ", ".join(f"{name} {seconds:.0f} s" for name, seconds in found["seconds"].items())
    print(f"noise of one reading: {found['noise']:.3f} N; {took}")


if __name__ == "__main__":
    main()
