"""python -m tests.studies learned: does `vpp diagnose` learn an effect that is in no list, at its place and without harm?

The rigs are those of the diagnosis study's emulator (rig.py). Each of the library's effects in turn is hidden in a rig and
deleted from the diagnosis' library; twelve further effects in no list were chosen before any learning existed
(`hidden_effects.UNLISTED`); and there are rigs without hidden effects. A case is judged by the final model: port and driver of
its term, the share of the thrust error's power removed on a hold-out record, and whether that is below 0.
"""

import time
from collections.abc import Sequence

import numpy as np

from identification.diagnose.diagnose import Diagnosis, diagnose
from identification.diagnose.learned.description import sentence
from identification.diagnose.search.fits import Fit
from vpp_fmu.kernel.plant import LIBRARY
from vpp_fmu.native import Simulator

from .cases import Case, draw
from .hidden_effects import LISTED, UNLISTED
from .rows import add_options, completed

KINDS = ("outside", "deleted", "none")

_PITCH_RATE = ({"pitch_rate", "pitch_rate_share"}, {"pitch_to_go", "pitch_rate"})
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
    "pitch_command_deadband": ({"pitch_command"}, {"pitch_command", "pitch_to_go"}),
    "pitch_error_deadzone": _PITCH_RATE,
    "pitch_stop_band": _PITCH_RATE,
    "pitch_stop_restart": _PITCH_RATE,
    "pitch_speed_limits": _PITCH_RATE,
    "pitch_stall_latch": _PITCH_RATE,
    "pitch_backlash": ({"effective_pitch"}, {"pitch", "pitch_rate"}),
    "pitch_rate_limit": ({*_PITCH_RATE[0], "pitch_command"}, {"pitch_to_go", "pitch_rate"}),
    "pitch_asymmetry": _PITCH_RATE,
    "pitch_travel_limit": ({"pitch_command", "effective_pitch"}, {"pitch_command", "pitch"}),
    "pitch_delay": ({"pitch_command"}, {"pitch_rate", "pitch_to_go"}),
    "speed_delay": ({"speed_command"}, {"speed_rate", "speed_to_go"}),
    "speed_asymmetry": (_MOTOR, {"speed_to_go", "speed_rate"}),
    "speed_overshoot": (_MOTOR, {"speed_to_go", "speed_rate"}),
    "speed_dependent_lag": (_MOTOR, {"speed"}),
    "speed_saturation": (_SPEED_IN, {"speed_command", "speed"}),
    "supply_sag": (_SPEED_IN, {"pitch", "pitch_command", "thrust", "speed_command", "speed"}),
    "supply_voltage": (_SPEED_IN, {"time"}),
    "pitch_speed_coupling": ({*_MOTOR, "rotor_speed", "speed_command"}, {"pitch_rate", "pitch_to_go"}),
    "thrust_gain_drift": ({"thrust", "thrust_share"}, {"time", "thrust"}),
    "inflow_lag": ({"thrust", "thrust_share", "effective_pitch"}, {"pitch", "pitch_rate"}),
    "pitch_rate_feedthrough": ({"thrust", "thrust_share"}, {"pitch_rate", "pitch_to_go"}),
    "recirculation": (_THRUST, {"thrust"}),
    "map_terms": ({"thrust", "thrust_share", "effective_pitch"}, {"pitch", "speed", "thrust"}),
    "sensor_lag": (_THRUST, {"thrust"}),
    "stand_resonance": (_THRUST, {"thrust"}),
    "reading_delay": (_THRUST, {"thrust"}),
    "sensor_drift": (_THRUST, {"time"}),
}
"""Correct ports and drivers: those of the physics, and those that no record can distinguish from them."""


def main(parser, arguments):
    parser.add_argument("--kinds", default=",".join(KINDS), metavar="A,B", help="of %(default)s")
    parser.add_argument("--effects", default="", metavar="A,B", help="hide these only")
    parser.add_argument("--clean", type=int, default=10, metavar="N", help="rigs without anything (default: %(default)s)")
    parser.add_argument("--seconds", type=float, default=60.0, metavar="S", help="of the open loop (default: %(default)g)")
    parser.add_argument("--strength", type=float, metavar="X", help="of what is hidden, 0 to 1 (default: drawn)")
    add_options(parser, "out/learned.jsonl")
    options = parser.parse_args(arguments)
    only, first = set(filter(None, options.effects.split(","))), options.first_seed
    names = {"outside": [h.name for h in UNLISTED], "deleted": [h.name for h in LISTED if h.name in RIGHT]}
    given = {"size": "paper", "rate": 250, "seconds": options.seconds}
    given |= {} if options.strength is None else {"strength": options.strength}
    found = []
    for kind in options.kinds.split(","):
        if kind == "none":
            found += [draw(first + k, "none", **given) for k in range(options.clean)]
        for k, name in enumerate(names.get(kind, ())):
            if not only or name in only:
                found.append(draw(first + k, kind, hidden=(name,), **given))
    done = completed(options, found, outcome)
    print("\n".join(map(line, done)))
    print(table(done))


def outcome(case: Case) -> dict:
    """Measure the case, diagnose it, compare with the truth."""
    measured = case.measured()
    stages, began, worked = [], time.perf_counter(), time.process_time()
    library = [e for e in LIBRARY if e.name != case.deleted]
    found = diagnose(measured, library, stage=lambda text: stages.append((text, time.process_time())))
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
    term, (ports, drivers) = found.learned.term, RIGHT.get("+".join(case.hidden), (set(), set()))
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
    """Results by kind, beside the aims."""
    lines = []
    for kind in KINDS:
        part = [r for r in rows if r["kind"] == kind and not r["failed"]]
        if not part:
            continue
        learned = [r for r in part if r["learned"]]
        shipped = [removed(r) for r in part if r["effects"]]
        lines.append(f"\n{kind}: {len(part)} rigs, {sum(r['lacking'] for r in part)} lack something, {len(learned)} learned")
        if kind == "none":
            lines.append(f"  learned without anything there: {len(learned)} (aim: 1 of 100 at most)")
            continue
        lines += [
            f"  {what}: {sum(r[key] for r in learned)} of {len(learned)}"
            for what, key in (
                ("port right", "port_right"),
                ("port in the set (aim: 80 %)", "port_in_set"),
                ("driver right", "driver_right"),
                ("driver in the set", "driver_in_set"),
            )
        ]
        gains = [removed(r) for r in learned]
        if gains:
            lines.append(f"  removed where learned: median {np.median(gains):.2f} (aim: 0.8), worst {min(gains):.2f} (aim: 0)")
        if shipped:
            lines.append(
                f"  removed where anything ships: median {np.median(shipped):.2f}, worst {min(shipped):.2f}, of {len(shipped)}"
            )
        seconds = [r["learning_cpu"] for r in part if r["learning_cpu"] > 0.0]
        if seconds:
            lines.append(f"  CPU seconds of learning: median {np.median(seconds):.0f}, most {max(seconds):.0f} (aim: 20)")
    failed = [r["name"] for r in rows if r["failed"]]
    return "\n".join([*lines, *([f"\nfailed: {', '.join(failed)}"] if failed else [])])
