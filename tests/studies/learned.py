"""python -m tests.studies learned: does `vpp diagnose` learn an effect that is in no list, at its place and without harm?

The rigs are those of the diagnosis study's emulator (rig.py). Each hides one of twelve effects in no list, which were chosen
before any learning existed (`hidden_effects.UNLISTED`). A case is judged by the final model: port and driver of its term, the
share of the thrust error's power removed on a hold-out record, and whether that is below 0.
"""

import time
from collections.abc import Sequence

import numpy as np

from identification.diagnose.diagnose import diagnose
from identification.diagnose.diagnosis import Diagnosis
from identification.diagnose.learned.description import sentence
from identification.diagnose.search.fits import Fit
from vpp_fmu.native import Simulator

from .cases import Case, draw
from .rows import add_options, completed

_MOTOR = {"motor_acceleration", "motor_acceleration_share"}
_SPEED_IN = {"speed_command", "speed_command_share", "rotor_speed"}
_THRUST = {"thrust", "thrust_share", "reading"}

RIGHT = {
    "torque_limit": (_MOTOR, {"speed_to_go", "speed_rate", "thrust"}),
    "coasting": (_MOTOR, {"speed_to_go", "speed_rate", "speed"}),
    "loaded_servo": ({"pitch_rate", "pitch_rate_share"}, {"thrust"}),
    "slow_untwist": ({"effective_pitch"}, {"speed"}),
    "speed_surge": ({"thrust", "reading"}, {"speed_rate"}),
    "eccentric_wheel": ({"effective_pitch"}, {"pitch"}),
    "blocked_speed": ({"thrust", "thrust_share"}, {"speed"}),
    "sticking_mount": ({"reading", "thrust"}, {"thrust"}),
    "soft_stop": (_THRUST, {"thrust"}),
    "draining_battery": (_SPEED_IN, {"thrust"}),
    "coarse_controller": (_SPEED_IN, {"speed_command", "speed_to_go"}),
    "parting_flow": ({"thrust", "thrust_share"}, {"thrust"}),
}
"""Correct ports and drivers: those of the physics, and those that no record can distinguish from them."""


def main(parser, arguments):
    parser.add_argument("--effects", default=",".join(RIGHT), metavar="A,B", help="hide these (default: %(default)s)")
    parser.add_argument("--seconds", type=float, default=60.0, metavar="S", help="of the open loop (default: %(default)g)")
    add_options(parser, "out/learned.jsonl")
    options = parser.parse_args(arguments)
    given = {"size": "paper", "rate": 250, "seconds": options.seconds}
    seeds = {name: options.first_seed + k for k, name in enumerate(RIGHT)}
    cases = [draw(seeds[name], "outside", hidden=(name,), **given) for name in options.effects.split(",")]
    done = completed(options, cases, outcome)
    print("\n".join(map(line, done)))
    print(table(done))


def outcome(case: Case) -> dict:
    """Measure the case, diagnose it, compare with the truth."""
    measured = case.measured()
    stages, began, worked = [], time.perf_counter(), time.process_time()
    found = diagnose(measured, stage=lambda text: stages.append((text, time.process_time())))
    learning = [at for text, at in stages if text.startswith("search for an effect outside the library")]
    record, true = case.unseen()

    def error(fit: Fit) -> float:
        shown = Simulator(fit.problem.model).simulate(fit.values, *record.run)[:, 0]
        return float(np.sqrt(np.mean((shown - true) ** 2)))

    row = case.summary() | {"failed": None, "verdict": found.verdict, "effects": list(found.final.effects)}
    row |= {"before": error(found.base), "after": error(found.final), "lacking": found.before.significant}
    row |= {"seconds": time.perf_counter() - began, "cpu": time.process_time() - worked}
    row |= {"learning_cpu": time.process_time() - learning[0] if learning else 0.0}
    return row | _learned(case, found)


def _learned(case: Case, found: Diagnosis) -> dict:
    if not found.learned:
        return {"learned": None}
    term, (ports, drivers) = found.learned.term, RIGHT[case.hidden[0]]
    together = [term, *found.learned.rivals]
    return {
        "learned": [term.lead.port, term.lead.driver, term.lead.shape],
        "sentence": sentence(term),
        "port_right": term.lead.port in ports,
        "port_in_set": any(t.lead.port in ports for t in together),
        "driver_right": term.lead.driver in drivers,
        "driver_in_set": any(t.lead.driver in drivers for t in together),
    }


def removed(row: dict) -> float:
    """Share of the true error's power that the final model removes on the hold-out record."""
    return 1.0 - (row["after"] / row["before"]) ** 2


def line(row: dict) -> str:
    """One row in one line."""
    if row["failed"]:
        return f"{row['name']:36} {row['failed']}"
    what = " ".join(row["learned"]) if row["learned"] else "+".join(row["effects"]) or "-"
    right = (
        ""
        if not row["learned"]
        else f"port {row['port_right']:d}/{row['port_in_set']:d} driver {row['driver_right']:d}/{row['driver_in_set']:d}"
    )
    ships = f"{removed(row):6.2f}" if row["effects"] else "     -"
    costs = f"{row['cpu']:4.0f} s, learning {row['learning_cpu']:3.0f}"
    return f"{row['name']:36} {row['verdict']:11} {what:58} {right:22} removed {ships}  {costs}"


def table(rows: Sequence[dict]) -> str:
    """Results beside the aims."""
    done = [r for r in rows if not r["failed"]]
    learned, shipped = [r for r in done if r["learned"]], [removed(r) for r in done if r["effects"]]
    lines = [f"\n{len(done)} rigs, {sum(r['lacking'] for r in done)} lack something, {len(learned)} learned"]
    for what, key in (
        ("port right", "port_right"),
        ("port in the set (aim: 80 %)", "port_in_set"),
        ("driver right", "driver_right"),
        ("driver in the set", "driver_in_set"),
    ):
        lines.append(f"  {what}: {sum(r[key] for r in learned)} of {len(learned)}")
    if gains := [removed(r) for r in learned]:
        lines.append(f"  removed where learned: median {np.median(gains):.2f} (aim: 0.8), worst {min(gains):.2f} (aim: 0)")
    if shipped:
        lines.append(
            f"  removed where anything ships: median {np.median(shipped):.2f}, worst {min(shipped):.2f}, of {len(shipped)}"
        )
    if seconds := [r["learning_cpu"] for r in done if r["learning_cpu"] > 0.0]:
        lines.append(f"  CPU seconds of learning: median {np.median(seconds):.0f}, most {max(seconds):.0f} (aim: 20)")
    return "\n".join([*lines, *(f"failed: {r['name']}" for r in rows if r["failed"])])
