"""Plan the next experiment: commands that reduce the uncertainty of the model's weakest direction, and the expected accuracy.

They stay within the range of the parameters' campaign, or of its rig.json."""

import sys

from identification.plan.plan import NOISE
from vpp_fmu.app.api.plan import plan
from vpp_fmu.app.cli.options import SEED, Number, add_knowledge, add_output, add_plant
from vpp_fmu.app.cli.output import answer
from vpp_fmu.app.cli.prompts import Prompts
from vpp_fmu.kernel.signals import BETA_REF, OMEGA_REF
from vpp_fmu.rig import rig_file

EXAMPLE = "vpp plan --parameters out/parameters.json --knowledge out/identification.json --omega-slew 20000 -o next"

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
    def go_on(found: str) -> bool:
        return options.yes or (sys.stdin.isatty() and Prompts(None).choice(f"{found}; go on", ("yes", "no")) == "yes")

    return answer(options, plan, go_on=go_on)
