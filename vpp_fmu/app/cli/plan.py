"""Plan the next experiment: commands that reduce the uncertainty of the model's weakest direction, and the expected accuracy.

They stay within the range of the parameters' campaign, or of its rig.json."""

import sys
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from identification.assessment.information import read_noise
from identification.assessment.prediction import predict
from identification.assessment.reading_noise import reading_noise
from identification.plan.plan import NOISE, Plan, plan, step_of
from vpp_fmu.app.cli.answer import Answer
from vpp_fmu.app.cli.inputs import add_knowledge, add_plant, knowledge_of, read_plant
from vpp_fmu.app.cli.options import SEED, Number
from vpp_fmu.app.cli.output import add_output, written
from vpp_fmu.app.cli.prompts import Prompts
from vpp_fmu.app.report.pages.plan import headline, key_figures, plan_page
from vpp_fmu.campaign import Campaign, read_campaign
from vpp_fmu.errors import BadInput
from vpp_fmu.files import OutputFolder
from vpp_fmu.kernel.signals import BETA_REF, OMEGA_REF
from vpp_fmu.kernel.simulation import Simulation
from vpp_fmu.outputs import OutputSet
from vpp_fmu.parameters import ParameterSet
from vpp_fmu.record import write_record
from vpp_fmu.rig import DECLARED, RANGES, SLEWS, Rig, declared_rig, rig_file
from vpp_fmu.structured import as_json

EXAMPLE = "vpp plan --parameters out/parameters.json --knowledge out/identification.json --omega-slew 20000 -o next"

COLOURED = 1.5
"""Factor by which coloured residuals must widen the present intervals for a remark."""

OPTIONS = {
    "--seconds": Number(0.01, 1e6, "s"),
    "--omega": Number(OMEGA_REF.minimum, OMEGA_REF.maximum, OMEGA_REF.unit),
    "--pitch": Number(BETA_REF.minimum, BETA_REF.maximum, BETA_REF.unit),
    "--omega-slew": Number(0.0, 1e9, "rpm/s", above=True),
    "--pitch-slew": Number(0.0, 1e9, "deg/s", above=True),
    "--step": Number(1e-5, 10.0, "s"),
    "--noise": Number(0.0, 1e6, "N", above=True),
    "--omega-noise": Number(0.0, 1e6, "rpm", above=True),
}
"""Ranges of the options on any rig."""

ASKED = "the command line"
"""Origin of a range that the user named."""


def configure(parser):
    def number(name, default, text, metavar="X"):
        parser.add_argument(name, type=OPTIONS[name], metavar=metavar, help=f"{text} (default: {default})")

    add_plant(parser, required=True)
    text = "identification.json of the data there are (default: the one beside --parameters; without it nothing is known)"
    add_knowledge(parser, text)
    text = "take range, sampling and noise from this campaign (default: what --parameters tells of its own)"
    parser.add_argument("--campaign", metavar="DIR", help=text)
    text = "a rig.json: the range and slew that it declares go before what was measured"
    parser.add_argument("--rig", type=rig_file, metavar="FILE", help=text)
    number("--seconds", "120 time scales of the rig, a minute for the paper's", "length of the experiment", "S")
    for name, what in (("--omega", "speed in rpm"), ("--pitch", "pitch in deg")):
        text = f"range of {what}, within the rig's (default: the rig's)"
        parser.add_argument(name, nargs=2, type=OPTIONS[name], metavar=("LOW", "HIGH"), help=text)
    for name, what in (("--omega-slew", "speed command in rpm/s"), ("--pitch-slew", "pitch command in deg/s")):
        number(name, "the rig's; without one it may jump", f"largest slew of the {what}")
    number(
        "--step",
        "the campaign's, at most a tenth of the rig's time scale",
        "time between commands and between readings in s",
        "S",
    )
    text = "standard deviation of a thrust reading in N"
    number("--noise", f"that of --knowledge or --campaign, else {NOISE:g} of the thrust scale", text)
    number("--omega-noise", "speed is not measured", "standard deviation of a speed reading in rpm")
    parser.add_argument("--seed", type=SEED, default=0, metavar="N", help="of the search (default: %(default)s)")
    text = "go on where the thrust hardly changes over the ranges of --omega and --pitch, without being asked"
    parser.add_argument("--yes", action="store_true", help=text)
    add_output(parser)


def run(options):
    parameters = read_plant(options).without_power
    known_in, known = knowledge_of(options, parameters)
    knowledge, inflation = known or (None, 1.0)
    campaign = read_campaign(options.campaign) if options.campaign else None
    rig = _rig(options, campaign, parameters)
    noise, noise_from = _noise(options, campaign, parameters, known_in)
    step = _step(options, campaign, parameters, rig)
    check_signal(options, parameters, rig, noise)
    folder = OutputSet(options.output, "plan")
    found = plan(
        parameters.model,
        parameters.values,
        rig,
        options.seconds,
        noise,
        knowledge,
        options.seed,
        omega_std=options.omega_noise,
        step=step,
    )
    remarks = remarks_on(found, inflation)
    basis = [f"commands within {', '.join(rig.command_lines())}", f"noise of a thrust reading {noise:.3g} N ({noise_from})"]
    write_plan(folder, found, basis, remarks, parameters.label)
    lines = [*basis, *(f"note: {remark}" for remark in remarks)]
    return Answer(headline(found), found.summary(), lines, key_figures(found), written=written(options, folder, parameters))


def remarks_on(found: Plan, inflation: float = 1.0) -> list[str]:
    """Remarks on a plan. `inflation`: factor by which autocorrelated residuals widen the present intervals."""
    return ([_coloured(inflation, found.noise_std)] if inflation > COLOURED else []) + _overload(found)


def write_plan(
    folder: OutputFolder, found: Plan, basis: Sequence[str] = (), remarks: Sequence[str] = (), source: str = ""
) -> None:
    """All files of a plan."""
    write_record(folder, "plan.csv", found.commands)
    folder.write("plan.json", as_json(found.summary()))
    folder.write("report.html", plan_page(found, basis, remarks, source).html())


def check_signal(options, parameters: ParameterSet, rig: Rig, noise: float) -> None:
    """Ask for confirmation if the static thrust changes by less than one reading's noise over a range that the user named:
    such an experiment has almost no information. BadInput without a terminal."""
    if options.yes or (options.omega is None and options.pitch is None):
        return
    model, thrust = parameters.model, []
    for omega in rig.speed:
        for beta in rig.pitch:
            inputs = {**model.measured_inputs, "omega_ref": omega, "beta_ref": beta}
            thrust.append(Simulation(model, parameters.values).start(inputs)["thrust"])
    change = max(thrust) - min(thrust)
    if change >= noise:
        return
    found = f"a range over which the thrust changes by {change:.2g} N, less than the {noise:.2g} N of noise of a reading"
    option = "--omega" if options.omega is not None else "--pitch"
    if sys.stdin.isatty() and Prompts(None).choice(f"{option}: {found}; go on", ("yes", "no")) == "yes":
        return
    raise BadInput("command line", option, found, "a wider range", "--yes to go on")


def _rig(options, campaign: Campaign | None, parameters: ParameterSet) -> Rig:
    """The rig of the parameters, the campaign or a rig.json, narrowed by the command line. BadInput if its range is unknown."""
    rig = parameters.rig
    if campaign is not None:
        rig = replace(campaign.rig, scales=rig.scales)  # of the map: they belong to the parameters
    if options.rig:
        rig = declared_rig(options.rig, rig)
    rig = _narrowed(rig, options)
    if rig.unknown:
        hint = "--campaign DIR, --rig FILE, or --omega and --pitch"
        raise BadInput(
            options.parameters, f"range of {' and '.join(rig.unknown)}", "none", "a measured or declared range", hint
        )
    return rig


def _step(options, campaign: Campaign | None, parameters: ParameterSet, rig: Rig) -> float | None:
    """Sampling period [s]: from the command line, else by `step_of` from the campaign or the parameters; None: unknown."""
    if options.step is not None:
        return options.step
    records = (campaign.open_loop, campaign.repeat, campaign.validation) if campaign is not None else ()
    periods = [record.period for record in records if record is not None]
    return step_of(periods[0] if periods else parameters.sample_period, rig)


def _narrowed(rig: Rig, options) -> Rig:
    """The rig with the ranges of the command line, which must lie within known ranges."""
    changes, origin = {}, dict(rig.origin)
    for name, asked in (("speed", options.omega), ("pitch", options.pitch)):
        if asked is None:
            continue
        option, unit, (low, high) = "--omega" if name == "speed" else "--pitch", RANGES[name].unit, getattr(rig, name)
        known = name not in rig.unknown
        if not known:
            low, high = RANGES[name].minimum, RANGES[name].maximum
        if not low <= asked[0] <= asked[1] <= high:
            where, wider = (f" ({origin[name]})", "--rig FILE, which declares a wider range") if known else ("", "")
            found = f"{asked[0]:g} to {asked[1]:g} {unit}"
            within = f"within {low:.6g} to {high:.6g} {unit}, the lower first{where}"
            raise BadInput("command line", option, found, within, wider)
        changes[name] = tuple(asked)
        origin[name] = f"{ASKED}, within {low:.6g} to {high:.6g} of {origin[name]}" if known else ASKED
    for name, asked in (("speed", options.omega_slew), ("pitch", options.pitch_slew)):
        if asked is None:
            continue
        most, unit = getattr(rig, f"{name}_slew"), SLEWS[name]
        if not 0.0 < asked <= most:
            allowed = f"more than 0 and at most {most:g} {unit}" if np.isfinite(most) else f"more than 0 {unit}"
            option = "--omega-slew" if name == "speed" else "--pitch-slew"
            raise BadInput("command line", option, f"{asked:g} {unit}", allowed)
        changes[f"{name}_slew"], origin[f"{name}_slew"] = asked, ASKED
    return replace(rig, **changes, origin=origin)


def _noise(options, campaign: Campaign | None, parameters: ParameterSet, known_in: str | None) -> tuple[float, str]:
    """(standard deviation of a thrust reading [N], its source). `known_in`: an identification.json, or None."""
    if options.noise is not None:
        return options.noise, ASKED
    if known_in and (options.knowledge or campaign is None):  # a named campaign takes precedence over a default file
        found = read_noise(known_in)
        if found and found[0] > 0.0:
            return found
    if campaign is not None:
        records = [record for record in (campaign.open_loop, campaign.repeat) if record is not None]
        shown = [predict(parameters.model, parameters.values, record) for record in records]
        if found := reading_noise(shown, campaign.static, parameters.values):
            return found.std, found.source
    return NOISE * parameters.values["thrust_scale"], f"{NOISE:g} of the thrust scale, not measured"


def _overload(found: Plan) -> list[str]:
    """Remark if the predicted thrust is outside of the rig's declared range."""
    low, high = found.rig.thrust
    least, most = float(found.thrust.min()), float(found.thrust.max())
    if found.rig.origin.get("thrust") != DECLARED or (low <= least and most <= high):
        return []
    return [
        f"The model predicts {least:.3g} to {most:.3g} N, and the rig is declared for {low:g} to {high:g} N: narrow --omega or "
        "--pitch before this is run."
    ]


def _coloured(inflation: float, noise: float) -> str:
    return (
        f"Coloured residuals made the intervals of the data so far {inflation:.1f} times as wide as white noise would; the "
        f"forecast is for white noise, so before and after do not compare. --noise {inflation * noise:.2g} would allow for as "
        "much again."
    )
