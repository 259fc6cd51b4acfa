"""Plan the next experiment: commands that shrink the model's weakest direction, within limits, and what they would bring."""

from collections.abc import Sequence
from math import inf

import numpy as np

from identification.fit.uncertainty import NORMAL_95
from identification.plan.excitation import Limits
from identification.plan.plan import DURATION, Plan, plan
from identification.worth.information import read_knowledge
from vpp_fmu.cli.options import SEED, Number
from vpp_fmu.cli.output import add_output, as_json, say_written
from vpp_fmu.kernel.plant import BETA_REF, OMEGA_REF, plant
from vpp_fmu.outputs import OutputSet
from vpp_fmu.parameters import check_same_model, read_parameters
from vpp_fmu.record import write_record
from vpp_fmu.report import Page, thinning
from vpp_fmu.report.plan import interval_widths, planned_commands

EXAMPLE = "vpp plan --parameters out/parameters.json --knowledge out/identification.json --omega-slew 20000 -o next"

UNKNOWN = 10.0
"""A standard deviation of more than so many times the size counts as no knowledge."""

COLOURED = 1.5
"""What was known before counts as hampered by coloured residuals when its intervals are wider by this factor."""

RANGES = {
    "--seconds": Number(*DURATION, "s"),
    "--omega": Number(OMEGA_REF.minimum, OMEGA_REF.maximum, OMEGA_REF.unit),
    "--pitch": Number(BETA_REF.minimum, BETA_REF.maximum, BETA_REF.unit),
    "--omega-slew": Number(0.0, 1e9, "rpm/s", above=True),
    "--pitch-slew": Number(0.0, 1e9, "deg/s", above=True),
    "--step": Number(0.0005, 0.05, "s"),
    "--noise": Number(0.0, 1e6, "N", above=True),
    "--omega-noise": Number(0.0, 1e6, "rpm", above=True),
}
"""What the options may be."""


def configure(parser):
    def number(name, default, text, metavar="X"):
        shown = "" if default is None else " (default: %(default)s)"
        parser.add_argument(name, type=RANGES[name], default=default, metavar=metavar, help=text + shown)

    parser.add_argument("--parameters", metavar="F", required=True, help="the plant's parameters")
    parser.add_argument(
        "--knowledge", metavar="F", help="identification.json of the data there are (default: nothing is known)"
    )
    number("--seconds", 60.0, "length of the experiment", "S")
    for name, pair, what in (("--omega", (2000.0, 6000.0), "speed in rpm"), ("--pitch", (-5.0, 10.0), "pitch in deg")):
        text = f"range of {what} (default: {pair[0]:g} {pair[1]:g})"
        parser.add_argument(name, nargs=2, type=RANGES[name], default=pair, metavar=("LOW", "HIGH"), help=text)
    number("--omega-slew", None, "largest slew of the speed command in rpm/s (default: it may jump)")
    number("--pitch-slew", None, "largest slew of the pitch command in deg/s (default: it may jump)")
    number("--step", 0.004, "time between commands and between readings in s", "S")
    number("--noise", 0.3, "standard deviation of a thrust reading in N")
    number("--omega-noise", None, "standard deviation of a speed reading in rpm (default: speed is not measured)")
    parser.add_argument("--seed", type=SEED, default=0, metavar="N", help="of the search (default: %(default)s)")
    add_output(parser)


def run(options):
    parameters = read_parameters(options.parameters, plant)
    knowledge, inflation = read_knowledge(options.knowledge) if options.knowledge else (None, 1.0)
    if options.knowledge:
        check_same_model(options.knowledge, parameters, options.parameters)
    slews = (inf if slew is None else slew for slew in (options.omega_slew, options.pitch_slew))
    limits = Limits(tuple(options.omega), tuple(options.pitch), *slews, step=options.step)
    folder = OutputSet(options.output, "plan")
    found = plan(
        parameters.model,
        parameters.values,
        limits,
        options.seconds,
        options.noise,
        knowledge,
        options.seed,
        omega_std=options.omega_noise,
    )
    write_record(folder, "plan.csv", found.commands)
    folder.write("plan.json", as_json(found.summary()))
    remarks = [_coloured(inflation, options.noise)] if inflation > COLOURED else []
    folder.write("report.html", plan_page(found, remarks).html())
    for label, value, note in key_figures(found):
        print(f"{label}: {value} ({note})")
    for remark in remarks:
        print(f"note: {remark}")
    say_written(folder, parameters)


def key_figures(found: Plan) -> list[tuple[str, str, str]]:
    """(label, value, note) of what a reader must know first."""
    figures = []
    stages = (("before", found.before), ("with the paper's plan", found.paper), ("with this plan", found.after))
    for when, forecast in stages:
        if forecast is not None:
            direction, spread = forecast.weakest()
            note = f"std of {combination(forecast.names, direction)}, in parts of the parameters"
            figures.append((f"weakest direction {when}", _percent(spread), note))
    figures.append(("gain over the paper's plan", f"{found.gain:.2f}", f"weakest direction, {_seconds(found)} s each"))
    return figures


def plan_page(found: Plan, remarks: Sequence[str] = ()) -> Page:
    """The report of a plan; `remarks` stand above its figures."""
    limits, after = found.limits, found.after
    page = Page(
        "The next experiment",
        f"{_seconds(found)} s of commands, speed {limits.omega[0]:g} to {limits.omega[1]:g} rpm, pitch {limits.beta[0]:g} to "
        f"{limits.beta[1]:g} deg, and what they would tell about the model, if a thrust reading every {1e3 * limits.step:g} ms "
        f"has white noise of {found.noise_std:g} N. What the model lacks, and any colour of the noise, widens all intervals.",
    )
    page.tiles(key_figures(found))
    for remark in remarks:
        page.note(remark)
    for name, why in found.untold.items():
        page.note(f"{name} is not planned for and counts as known: {why}.")
    title = f"The paper's plan leaves {_percent(found.paper.weakest()[1])} in the weakest direction, this one"
    widths = {"before": found.before, "the paper's plan": found.paper, "after this plan": after}
    shown = {name: 100.0 * NORMAL_95 * forecast.relative for name, forecast in widths.items() if forecast is not None}
    page.figure(
        interval_widths(after.names, shown, f"{title} {_percent(after.weakest()[1])}"),
        "Predicted 95 % intervals. The paper's plan: as long, a third speed only, a third pitch only, a third both, "
        "levels held for 1 to 2.5 s." + ("" if found.before is None else " Both plans add to what is known before."),
    )
    columns = found.commands.columns
    changes = int(np.sum(np.any(np.diff([columns["omega_ref"], columns["beta_ref"]]) != 0.0, axis=0)))
    title = f"Commands change at {changes} of {len(found.commands)} rows; thrust is predicted between "
    title += f"{found.thrust.min():.1f} and {found.thrust.max():.1f} N"
    drawn = planned_commands(columns["time"], columns["omega_ref"], columns["beta_ref"], found.thrust, title)
    page.figure(drawn, f"plan.csv. {thinning(len(found.commands))}")
    _add_tables(page, found)
    return page


def _add_tables(page: Page, found: Plan) -> None:
    before, paper, after = found.before, found.paper, found.after
    unknown = [None] * len(after.names)
    known = unknown if before is None else np.where(before.relative < UNKNOWN, before.std, np.nan)
    rows = zip(after.names, after.values, known, paper.std, after.std, *after.intervals.T, strict=True)
    columns = ("parameter", "value", "std before", "std, paper's plan", "std after", "95 % from", "to")
    page.table(columns, list(rows), "Time constants in s, coefficients normalised, effects' parameters in their units.")
    directions = [unknown if f is None else f.weakest()[0] for f in (before, paper, after)]
    rows = list(zip(after.names, *directions, strict=True))
    page.table(("parameter", "before", "paper's plan", "after"), rows, "Weakest directions, in parts of the parameters' sizes.")


def combination(names, direction: np.ndarray, most: int = 3) -> str:
    """A direction in words: its largest parts, in their order of size."""
    largest = [k for k in np.argsort(-np.abs(direction))[:most] if abs(direction[k]) > 0.2]
    return " ".join(f"{direction[k]:+.2f} {names[k]}" for k in largest).removeprefix("+")


def _coloured(inflation: float, noise: float) -> str:
    return (
        f"Coloured residuals made the intervals of the data so far {inflation:.1f} times as wide as white noise would; the "
        f"forecast is for white noise, so before and after do not compare. --noise {inflation * noise:.2g} would allow for as "
        "much again."
    )


def _percent(share: float) -> str:
    return f"{100.0 * share:.2g} %" if share < UNKNOWN else "unknown"


def _seconds(found: Plan) -> str:
    return f"{found.commands.time[-1]:g}"
