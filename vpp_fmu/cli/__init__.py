"""The command `vpp`: one verb a file, each calls what the library offers."""

import argparse
import importlib
import sys
import warnings

from vpp_fmu.errors import VppError
from vpp_fmu.record import RecordWarning

VERBS = {
    "demo": "the whole job on the campaign that ships with the project",
    "check": "what a campaign's files are, hold and lack, and whether they can be trusted",
    "identify": "a campaign to parameters",
    "diagnose": "what the model lacks, and the model with it",
    "tune": "gains for a model",
    "export": "parameters to FMUs",
    "cosim": "the closed loop of two FMUs",
    "simulate": "the open-loop response to a record",
    "compare": "two records side by side",
    "plan": "the next experiment for a model: commands, and what they would tell",
    "import": "a test stand's log to a record",
    "paper": "the paper's study on the emulated rig, every number beside the paper's",
    "hil": "the loop with the rig, emulated or real, in the plant's place",
}


class Parser(argparse.ArgumentParser):
    """Says what is wrong in one line."""

    def error(self, message):
        self.exit(2, f"{self.prog}: {message} (see {self.prog} --help)\n")


def main(arguments: list[str] | None = None) -> int:
    """Run one verb; returns the exit code: 0, or 2 where the input is bad, after one line on standard error."""
    arguments = sys.argv[1:] if arguments is None else arguments
    listing = "\n".join(f"  {verb:10} {text}" for verb, text in VERBS.items())
    parser = Parser("vpp", description="Rig data to FMUs.", formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.epilog = f"verbs:\n{listing}\n\nvpp VERB --help tells the rest"
    parser.add_argument("verb", choices=VERBS, metavar="VERB")
    verb = parser.parse_args(arguments[:1]).verb
    module = importlib.import_module(f"vpp_fmu.cli.{verb}")
    parser = Parser(f"vpp {verb}", description=module.__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.epilog = f"example:\n  {module.EXAMPLE}"
    module.configure(parser)
    options = parser.parse_args(arguments[1:])
    with warnings.catch_warnings():
        warnings.simplefilter("always", RecordWarning)
        warnings.showwarning = _one_line
        try:
            module.run(options)
        except VppError as error:
            print(f"vpp {verb}: {' '.join(str(error).split())}", file=sys.stderr)
            return 2
        except KeyboardInterrupt:
            print(f"vpp {verb}: stopped", file=sys.stderr)
            return 130
    return 0


def _one_line(message, *_):
    print(f"vpp: note: {message}", file=sys.stderr)
