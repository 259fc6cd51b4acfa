"""Predict the open-loop response to the commands of a record."""

from vpp_fmu.app.api.loop import simulate
from vpp_fmu.app.cli.options import add_output, add_plant, commands_file
from vpp_fmu.app.cli.output import answer

EXAMPLE = "vpp simulate campaigns/monday/validation.csv --parameters out/parameters.json -o out"


def configure(parser):
    text = "CSV with time, omega_ref, beta_ref, or the folder of a campaign or a plan"
    parser.add_argument("record", type=commands_file, metavar="RECORD", help=text)
    add_plant(parser, required=True)
    add_output(parser)


def run(options):
    return answer(options, simulate)
