"""Tune the controller for a model: the paper's cost, within limits on overshoot and sensitivity; both actuators, speed alone.

The controller samples, saturates and reads thrust through a converter as on the rig, whose ranges are its limits. New gains
are accepted only if no step settles later, overshoots or rings more than with the initial gains, which are kept otherwise. The
result is simulated again with both FMUs. With --robust, gains are optimised for the worst case, or the mean, over plants drawn
from the parameters' uncertainty."""

import argparse
import os
from collections.abc import Iterator, Mapping

from identification.power.allocation import allocate, allocated_controller
from identification.power.model import PowerModel
from identification.tune.controllers import POWERS, controllers
from identification.tune.objective import ALPHA
from identification.tune.profile import common_reach, rig_profile
from identification.tune.summary import NAMES, change_rows, headline, key_figures, margin_rows, summary
from identification.tune.tune import Tuning, TuningTask, chain_of, tune
from identification.tune.verdict import UNITS
from vpp_fmu.app.cli.answer import Answer
from vpp_fmu.app.cli.inputs import (
    add_gains,
    add_knowledge,
    add_plant,
    knowledge_of,
    noise_in,
    profile_file,
    read_gains,
    read_plant,
)
from vpp_fmu.app.cli.options import SEED, WORKERS, Number, whole
from vpp_fmu.app.cli.output import add_output, dated, written
from vpp_fmu.app.report.pages.tuning import tuning_page
from vpp_fmu.errors import BadInput
from vpp_fmu.files import OutputFolder
from vpp_fmu.kernel.effects.dual_pid import ALLOCATED, ALLOCATION
from vpp_fmu.kernel.effects.thrust_reading import LONGEST
from vpp_fmu.kernel.measurement import CONVERSIONS
from vpp_fmu.outputs import OutputSet
from vpp_fmu.parameters import ParameterSet, beside, to_json
from vpp_fmu.record import read_profile, write_record
from vpp_fmu.rig import ASSUMED
from vpp_fmu.structured import as_json

EXAMPLE = "vpp tune --parameters out/parameters.json --assume tau_beta_2=0.05 -o out"

FILES = {"dual": "gains.json", "speed_only": "gains_speed_only.json", "allocated": "gains.json"}

UNITS_OF = {"omega": "rpm", "beta": "deg"}

RANGES = {
    "alpha": Number(0.0, 1.0),
    "overshoot": Number(0.01, 100.0, "%"),
    "sensitivity": Number(1.1, 100.0),
    "noise": Number(0.0, 100.0, "N"),
    "delay": Number(0.0, 10.0, "s"),
    "lag": Number(0.0, 1.0, "s"),
    "resolution": Number(0.0, 10.0, "N"),
    "sample-time": Number(1e-5, 1.0, "s"),
    "draws": whole(1, 10000),
    "spread": Number(0.0, 1.0),
    "seed": SEED,
    "workers": WORKERS,
}
"""Ranges of the options."""

WEIGHTS = {"power": 0.0, "agility": 1.0}


class Weight(Number):
    """A weight of the allocation, as a number or a word."""

    def __call__(self, text: str) -> float:
        if text in WEIGHTS:
            return WEIGHTS[text]
        try:
            return super().__call__(text)
        except argparse.ArgumentTypeError as error:
            raise argparse.ArgumentTypeError(f"{error}, {' or '.join(WEIGHTS)}") from error


PAPERS = "the paper's fine-tuned set"
"""Default parameters."""


def configure(parser):
    def number(name, default, text, metavar="X"):
        shown = "" if default is None else " (default: %(default).4g)"
        parser.add_argument(f"--{name}", type=RANGES[name], default=default, metavar=metavar, help=text + shown)

    add_plant(parser, f" (default: {PAPERS})")
    text = "a parameter that the design assumes instead, as the paper does with tau_beta_2=0.05; may be repeated"
    parser.add_argument("--assume", action="append", default=[], metavar="NAME=VALUE", help=text)
    text = "limits, filter, sample time and first gains of the controller (default: the rig's limits, the paper's gains)"
    add_gains(parser, text)
    text = "tune the law that rests on the best pairs of speed and pitch instead (vpp allocate): those of least power, of the "
    text += "largest reserve of thrust by pitch, or a weight between 0 (power) and 1 (agility); for parameters with power"
    parser.add_argument("--objective", type=Weight(0.0, 1.0), metavar="power|agility|W", help=text)
    text = "CSV with time, thrust_set (default: 0.1 to 0.8 of the thrust scale and back, as far as the rig reaches)"
    parser.add_argument("--profile", type=profile_file, metavar="P", help=text)
    text = (
        "period of the controller in s (default: the campaign's, else 0.004; other where the plant's faster channel needs it)"
    )
    number("sample-time", None, text, "S")
    number("alpha", ALPHA, "weight of the squared norm of the gains")
    number("overshoot", 1.0, "largest overshoot in %% of a step")
    number("sensitivity", 2.0, "largest amplification of a disturbance around the operating points")
    number("noise", None, "standard deviation of a thrust reading in N (default: that of --knowledge, else 0)")
    number("delay", 1.0 / CONVERSIONS, "delay of a thrust reading in s", "S")
    number("lag", 0.0, "time constant of the thrust reading in s", "S")
    number("resolution", None, "step of the converter in N (default: 2e-4 of the thrust scale, the paper's)")
    parser.add_argument("--robust", choices=("worst", "mean"), help="tune over many plants as well")
    number("draws", 200, "plants to tune over", "N")
    number("spread", 0.1, "standard deviation, as a share, of assumed parameters and of those whose file has none")
    text = "identification.json: correlation of the parameters, noise of thrust (default: the one beside --parameters)"
    add_knowledge(parser, text)
    number("seed", 0, "of plants and noise", "N")
    number("workers", 1, "number of parallel searches", "N")
    parser.add_argument("--scheduler", metavar="ADDRESS", help="a Dask scheduler to run the searches on instead")
    add_output(parser)


def run(options):
    parameters = read_plant(options)
    task, starts = _task(options, parameters)
    came = {"parameters": (options.parameters or PAPERS, parameters)}
    folder = OutputSet(options.output, "tune")
    setting = _setting(task, starts)
    found = tune(task, starts, options.workers, options.scheduler)
    write_tuning(folder, found, **came)
    place = written(options, folder, parameters)
    return Answer(headline(found), summary(found), setting, key_figures(found), [*_details(found)], place)


def _details(found: Tuning) -> Iterator[str]:
    """Every step and margin, before and after, as lines of text."""
    for name, tuned in found.tuned.items():
        for which, verdict in tuned.verdicts.items():
            yield f"{NAMES[name]}, {found.task.reference} → {which}"
            for step, *changes in change_rows(verdict):
                yield f"  {step}: " + ", ".join(f"{n} {c}" for n, c in zip(UNITS, changes, strict=True))
            yield "  " + ", ".join(f"{margin} {change}" for margin, change in margin_rows(verdict))
    yield f"tuned in {found.seconds:.1f} s"


def write_tuning(folder: OutputFolder, found: Tuning, **came: tuple[str | os.PathLike[str], ParameterSet]) -> None:
    """All files of a tuning. `came`: (file, its content) of the plant's parameters."""
    for name in found.tuned:
        folder.write(FILES[name], to_json(dated(gains_of(found, name), **came)))
    folder.write("tuning.json", as_json(summary(found)))
    write_record(folder, "profile.csv", found.task.profile)
    folder.write("report.html", tuning_page(found).html())


def _setting(task: TuningTask, starts) -> list[str]:
    """Conditions from the rig: limits, sampling, the profile, and controllers that it does not allow."""
    rig, settings = task.parameters.rig, next(iter(starts.values()))
    ends = ((f"{settings[f'{u}_min']:.6g}", f"{settings[f'{u}_max']:.6g}", unit) for u, unit in UNITS_OF.items())
    limits = (f"{low} {unit}" if low == high else f"{low} to {high} {unit}" for low, high, unit in ends)
    where = ", ".join(dict.fromkeys(rig.origin.get(name, ASSUMED) for name in ("speed", "pitch")))
    lines = [f"limits: {', '.join(limits)} (rig: {where}); sampled every {1e3 * settings['sample_time']:.4g} ms"]
    lines.append(f"noise of a thrust reading: {task.noise_std:.3g} N")
    low, high = common_reach(task.parameters, starts)
    wanted = task.profile["thrust_set"]
    line = f"{task.profile.source}: {wanted.min():.4g} to {wanted.max():.4g} N; in reach are {low:.4g} to {high:.4g} N"
    beyond = wanted.min() < low or wanted.max() > high
    lines.append(line + (", so that a part of it can't be followed" if beyond else ""))
    return lines + [f"no gains for {NAMES[name]}: {why}" for name, why in task.left_out.items()]


def _task(options, parameters: ParameterSet) -> tuple[TuningTask, Mapping[str, Mapping[str, float]]]:
    given = read_gains(options)
    assumed = dict(_assumed(text, parameters) for text in options.assume)
    known_in, knowledge = knowledge_of(options, parameters)
    parameters = parameters.replaced(assumed)
    own = controllers(parameters, given, options.sample_time, options.gains)
    period = next(iter(own.settings.values()))["sample_time"]
    if options.delay > LONGEST * period:
        raise BadInput(
            "command line",
            "--delay",
            f"{options.delay:g} s",
            f"0 to {LONGEST * period:g} s, {LONGEST} samples of the controller",
        )
    starts = _starts(options, parameters, own.settings, given)
    profile = read_profile(options.profile) if options.profile else rig_profile(parameters, starts)
    if profile.time[-1] < 10.0 * period:
        raise BadInput(options.profile, "time", f"{profile.time[-1]:g} s", f"{10.0 * period:g} s or more")
    chain = chain_of(parameters, period) | {"time_constant": options.lag, "delay": options.delay / period}
    if options.resolution is not None:
        chain["resolution"] = options.resolution
    task = TuningTask(
        parameters=parameters,
        effects_from=tuple(options.effects_from),
        profile=profile,
        assumed=tuple(assumed),
        chain=chain,
        noise_std=noise_in(known_in) if options.noise is None else options.noise,
        alpha=options.alpha,
        overshoot=options.overshoot / 100.0,
        sensitivity=options.sensitivity,
        reference=own.reference,
        robust=options.robust,
        draws=options.draws,
        spread=options.spread,
        knowledge=knowledge and knowledge[0],
        seed=options.seed,
        left_out=own.left_out,
        lowered=own.scaled,
    )
    return task, starts


def _starts(options, parameters: ParameterSet, settings, given: ParameterSet | None) -> dict[str, dict[str, float]]:
    """Settings of each controller to tune: those of the rig, or the law of the best pairs alone. BadInput without power."""
    if options.objective is None:
        pairs = given is not None and given.values["mode"] == ALLOCATED
        return {"allocated": dict(settings["dual"])} if pairs and "dual" in settings else dict(settings)
    power = PowerModel.of(parameters, options.parameters and beside(options.parameters))
    own = allocated_controller(allocate(parameters, power, options.objective), parameters).values
    kept = {} if given is None else {name: e.value for name, e in given.estimates.items() if name[:3] in POWERS}
    return {"allocated": {**settings["dual"], **{n: own[n] for n in (*ALLOCATION, "ki_beta")}, **kept}}


def _assumed(text: str, parameters: ParameterSet) -> tuple[str, float]:
    known = {p.name: p for p in parameters.model.parameters}
    name, _, value = text.partition("=")
    if name not in known:
        raise BadInput("command line", "--assume", text, f"NAME=VALUE with one of {', '.join(known)}")
    p = known[name]
    try:
        number = float(value)
    except ValueError:
        number = float("nan")
    if not p.minimum <= number <= p.maximum:
        raise BadInput("command line", f"--assume {name}", value, f"a number from {p.minimum:g} to {p.maximum:g} {p.unit}")
    return name, number


def gains_of(found: Tuning, name: str) -> ParameterSet:
    """The parameter set of the controller `name`, "dual" or "speed_only"."""
    tuned = found.tuned[name]
    source = {
        "made_by": "vpp tune",
        "assumed": {n: found.task.parameters.values[n] for n in found.task.assumed},
        "robust": found.task.robust,
        "cost": tuned.cost(tuned.chosen),
        "verdict": {which: each.words() for which, each in tuned.verdicts.items()},
        "rig": found.task.parameters.rig.summary(),
    }
    return ParameterSet(found.task.controller, source=source).replaced(tuned.objective.with_gains(tuned.final))
