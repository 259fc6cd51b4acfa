"""python -m tests.studies learned: does `vpp diagnose` learn an effect that is in no list, at its place and without harm?

The rigs are those of the diagnosis study's emulator (rig.py). Each of the library's effects in turn is hidden in a rig and
deleted from the diagnosis' library; twelve further effects in no list were chosen before any learning existed
(`hidden_effects.UNLISTED`); and there are rigs without hidden effects. A case is judged by the final model: port and driver of
its term, the share of the thrust error's power removed on a hold-out record, and whether that is below 0. A model with a
learned term is exported in both flavours, validated by fmpy, and run through fmpy over that record, to compare it bit by bit
with the functions.
"""

import argparse
import contextlib
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from identification.diagnose.diagnose import Diagnosis, diagnose
from identification.diagnose.learned.description import sentence
from identification.diagnose.learned.laws import curve_of
from identification.diagnose.learned.refit import Term
from identification.diagnose.search.fits import Fit
from vpp_fmu.app.report.page import Page
from vpp_fmu.app.report.pages.effect import data, law, learned_curve
from vpp_fmu.export import Experiment, native_fmu, python_fmu
from vpp_fmu.fmu import Fmu, FmuInstance, problems
from vpp_fmu.invariants import reference
from vpp_fmu.kernel.learned import DRIVERS, PORTS
from vpp_fmu.kernel.plant import LIBRARY
from vpp_fmu.kernel.types import Model
from vpp_fmu.native import Simulator
from vpp_fmu.record import Record

from .cases import Case, draw
from .hidden_effects import LISTED, UNLISTED
from .own_process import Failed, apart
from .row_file import kept, read

KINDS = ("unlisted", "deleted", "none")

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
    parser.add_argument("--seed", type=int, default=1000, metavar="K", help="of the first case (default: %(default)s)")
    parser.add_argument("--clean", type=int, default=10, metavar="N", help="rigs without anything (default: %(default)s)")
    parser.add_argument(
        "--seconds", type=float, default=60.0, metavar="S", help="of the open-loop record (default: %(default)g)"
    )
    parser.add_argument("--rate", type=int, default=250, metavar="HZ", help="of the logger (default: %(default)s)")
    parser.add_argument("--strength", type=float, metavar="X", help="of what is hidden, 0 to 1 (default: drawn)")
    parser.add_argument("--size", default="paper", help="of the rig (default: %(default)s)")
    parser.add_argument("--limit", type=float, default=900.0, metavar="S", help="seconds for a case (default: %(default)g)")
    parser.add_argument("-o", "--output", default="out/learned.jsonl", metavar="F", help="lines (default: %(default)s)")
    parser.add_argument("--pages", metavar="DIR", help="where a curve is known that should come out, draw both")
    parser.add_argument("--only-table", action="store_true", help="no new cases: the table of the file's lines")
    options = parser.parse_args(arguments)
    path = Path(options.output)
    done = read(path)
    if not options.only_table:
        known = {(row["name"], row["kind"]) for row in done}
        missing = [case for case in cases(options) if (case.name, _kind(case)) not in known]
        for row in kept(path, (one(case, options.limit, options.pages) for case in missing)):
            print(line(row), flush=True)
            done.append(row)
    print(table(done))


def cases(options: argparse.Namespace) -> list[Case]:
    """The requested cases, each with its own seed."""
    only = set(filter(None, options.effects.split(",")))
    names = {"unlisted": [h.name for h in UNLISTED], "deleted": [h.name for h in LISTED if h.name in RIGHT], "none": []}
    given = {"size": options.size, "rate": options.rate, "seconds": options.seconds}
    given |= {} if options.strength is None else {"strength": options.strength}
    found = []
    for kind in options.kinds.split(","):
        if kind == "none":
            found += [draw(options.seed + k, "none", **given) for k in range(options.clean)]
        for k, name in enumerate(names[kind]):
            if not only or name in only:
                found.append(draw(options.seed + k, "deleted" if kind == "deleted" else "outside", hidden=(name,), **given))
    return found


def _kind(case: Case) -> str:
    return "unlisted" if case.kind == "outside" else case.kind


def one(case: Case, limit: float, pages: str | None = None) -> dict:
    """A case's row, from a separate process."""
    began = time.perf_counter()
    try:
        return apart(outcome, case, pages, limit=limit)
    except Failed as failed:
        return {"name": case.name, "kind": _kind(case), "failed": str(failed), "seconds": time.perf_counter() - began}


def outcome(case: Case, pages: str | None = None) -> dict:
    """Measure the case, diagnose it, compare with the truth. `pages`: a folder for a page that draws it."""
    measured = case.measured()
    stages, began, worked = [], time.perf_counter(), time.process_time()
    library = [e for e in LIBRARY if e.name != case.deleted]
    found = diagnose(measured, library, stage=lambda text: stages.append((text, time.process_time())))
    learning = [at for text, at in stages if text.startswith("search for an effect outside the library")]
    record, true = case.unseen()

    def error(fit: Fit) -> float:
        shown = Simulator(fit.problem.model).simulate(fit.values, *record.run)[:, 0]
        return float(np.sqrt(np.mean((shown - true) ** 2)))

    row = {"name": case.name, "kind": _kind(case), "hidden": list(case.hidden), "failed": None}
    row |= {"validation": case.factors.validation, "noise": case.factors.noise, "strength": case.factors.strength}
    row |= {"verdict": found.verdict, "effects": list(found.final.effects), "refuted": found.refuted or found.attempt.refuted}
    row |= {"before": error(found.base), "after": error(found.final), "lacking": found.before.found}
    row |= {"seconds": time.perf_counter() - began, "cpu": time.process_time() - worked}
    row |= {"learning_cpu": time.process_time() - learning[0] if learning else 0.0}
    if found.learned and pages and case.hidden[0] in TRUE_CURVES:
        draw_curve(case, found, Path(pages))
    return row | _learned(case, found) | (exported(found, record, true) if found.learned else {})


TRUE_CURVES = {
    "blocked_speed": (
        "thrust_share",
        "speed",
        (0, 1),
        lambda s, size, v: -s["notch"] * np.exp(-(((v / size.speed - 0.68) / 0.06) ** 2)),
    ),
    "speed_surge": ("thrust", "speed_rate", (), lambda s, size, v: s["surge"] * size.thrust / size.speed * v),
    "loaded_servo": (
        "pitch_rate_share",
        "thrust",
        (0,),
        lambda s, size, v: 1.0 / (1.0 + s["servo_load"] * np.maximum(v / size.thrust - 0.25, 0.0)) - 1.0,
    ),
    "soft_stop": ("reading", "thrust", (0, 1), lambda s, size, v: -s["bend"] * np.maximum(v - 0.4 * size.thrust, 0.0)),
}
"""Port, driver, the powers of the driver that other parameters absorb (a thrust map's, a lag's), and the curve that the rig
(rig.c) adds there over values of the driver."""


def draw_curve(case: Case, found: Diagnosis, folder: Path) -> None:
    """Write a page with the learned curve, as a table and as the law that replaced it, beside the curve of the rig."""
    port, driver, powers, true = TRUE_CURVES[case.hidden[0]]
    learned = found.learned
    term, curve = learned.term, learned.curve
    if (term.lead.port, term.lead.driver) != (port, driver) or curve.lead.shape != "curve":
        return
    at, f, std = curve_of(curve)
    fine, there = np.linspace(at[0], at[-1], 400), data(found)
    inside = np.sort(there[(there >= at[0]) & (there <= at[-1])])[:: max(1, len(there) // 5000)]
    basis = np.vander(inside / at[-1], 1 + max(powers, default=-1))

    def beside_table(of: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
        off, *_ = np.linalg.lstsq(basis, np.interp(inside, at, f) - of(inside), rcond=None)
        return of(fine) + np.vander(fine / at[-1], basis.shape[1]) @ off

    lines = {"learned, as a table": (at, f)}
    if term is not curve:
        lines[f"law: {term.lead.shape}"] = fine, beside_table(lambda v: law(term, v))
    lines["in the rig"] = fine, beside_table(lambda v: true(case.rig.settings, case.rig.size, v))
    d, p = DRIVERS[driver], PORTS[port]
    title = f"{case.hidden[0].replace('_', ' ').capitalize()}, in no list: what was learned beside what is there"
    page = Page(title, "")
    page.figure(
        learned_curve(at, f, 1.96 * std, lines, there, title, (d.words, d.unit), (p.words, p.unit)),
        f"The term {sentence(term)}.",
    )
    folder.mkdir(parents=True, exist_ok=True)
    (folder / f"{case.hidden[0]}.html").write_text(page.html())


FLAVOURS = {"python": python_fmu, "native": native_fmu}


def exported(found: Diagnosis, record: Record, true: np.ndarray) -> dict:
    """Export base and final model as FMUs and run them through fmpy over a record whose true thrust is given. Returns the
    problems that validation finds, the numbers of rows that differ from the functions, and the thrust errors [N] of both."""
    said, differ, errors = [], {}, []
    for fit in (found.base, found.final):
        parameters = found.parameters(fit)
        model, values = parameters.model, parameters.values
        exact = reference(model, values, record.columns, np.full(len(record) - 1, record.period))
        with tempfile.TemporaryDirectory() as folder:
            for flavour, make in FLAVOURS.items():
                path = Path(folder, f"{flavour}.fmu")
                path.write_bytes(make(model, values, Experiment()))
                said += problems(path)
                shown = _through_fmpy(path, model, record)
                differ[flavour] = differ.get(flavour, 0) + int(np.sum(np.any(shown != exact, axis=1)))
        errors.append(float(np.sqrt(np.mean((shown[:, 0] - true) ** 2))))
    return {"fmus": {"said": said, "rows": 2 * len(record), "differ": differ, "errors": errors}}


def _through_fmpy(path: Path, model: Model, record: Record) -> np.ndarray:
    names = [u.name for u in model.inputs]
    held = np.column_stack([record[name] for name in names]).tolist()
    with contextlib.closing(Fmu(path)) as unpacked:
        instance = FmuInstance(unpacked, names, [y.name for y in model.outputs])
        shown = [instance.start(held[0])]
        take = instance.stepper(record.period)
        shown += [take(row) for row in held[:-1]]
        instance.close()
    return np.array(shown)


def _learned(case: Case, found: Diagnosis) -> dict:
    if not found.learned:
        tried = [(_place(t), j.evidence, list(j.refused)) for t, j in found.attempt.tried]
        return {"learned": None, "tried": tried}
    term, (ports, drivers) = found.learned.term, RIGHT.get("+".join(case.hidden), (set(), set()))
    together = [term, *found.learned.rivals]
    return {
        "learned": _place(term),
        "sentence": sentence(term),
        "port_right": term.lead.port in ports,
        "port_in_set": any(t.lead.port in ports for t in together),
        "driver_right": term.lead.driver in drivers,
        "driver_in_set": any(t.lead.driver in drivers for t in together),
        "rivals": [_place(t) for t in found.learned.rivals],
    }


def _place(term: Term) -> list[str]:
    return [term.lead.port, term.lead.driver, term.lead.shape]


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
    lines += _exports([r["fmus"] for r in rows if r.get("fmus")])
    failed = [r["name"] for r in rows if r["failed"]]
    return "\n".join([*lines, *([f"\nfailed: {', '.join(failed)}"] if failed else [])])


def _exports(rows: Sequence[dict]) -> list[str]:
    """Results of the exported models with a learned term."""
    if not rows:
        return []
    differ = ", ".join(f"{flavour} {sum(r['differ'][flavour] for r in rows)}" for flavour in FLAVOURS)
    before, after = np.array([r["errors"] for r in rows]).T
    ratio, said, count = after / before, sum(len(r["said"]) for r in rows), sum(r["rows"] for r in rows)
    return [
        f"\nexported in both flavours, without and with the term: {len(rows)}; fmpy validate: {said} problems",
        f"  rows of {count} that are not the functions' to the bit: {differ}",
        f"  thrust error through fmpy, after over before: median {np.median(ratio):.2f}, worst {max(ratio):.2f}",
    ]
