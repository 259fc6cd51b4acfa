"""The same loop, controllers and records with a rig in the plant's place: emulated, or real.

Run a closed loop, measure a campaign, test the rig itself, or feed a recorded run to a controller once more. Before the
first run on a real rig read hil/README.md."""

import importlib
import sys

EXAMPLE = "vpp hil run --profile step.csv --virtual -o out"

VERBS = {
    "run": "a closed loop over a profile of wanted thrust",
    "campaign": "static map, steps, open loop, its repeat, validation: what `vpp identify` reads",
    "calibrate": "weights, pitch table, polarity and the throttle's idle, step by step",
    "selftest": "jitter, buses, calibration, pulse outputs",
    "report": "report and record of a run from its log, where the run could not make them itself",
    "replay": "a recorded run once more through a controller FMU",
}


def configure(parser):
    if sys.platform != "linux":
        parser.error(f"this is {sys.platform}; a rig, emulated or real, needs Linux: its clock, PWM files, I2C and terminals")
    parts = parser.add_subparsers(dest="what", required=True, metavar="WHAT", parser_class=type(parser))
    for name, text in VERBS.items():
        module = importlib.import_module(f"vpp_fmu.cli.hil_{name}")
        own = parts.add_parser(name, help=text, description=module.__doc__, formatter_class=parser.formatter_class)
        own.epilog = f"example:\n  {module.EXAMPLE}"
        module.configure(own)
        own.set_defaults(run=module.run)


def run(options):
    options.run(options)
