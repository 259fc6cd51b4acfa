"""Identify the model's parameters from a measured campaign (a folder with open_loop.csv, static.csv, ...)."""

from tqdm import tqdm

from identification.fit.refine import METHODS
from vpp_fmu.app.api.identify import identify
from vpp_fmu.app.cli.options import SEED, add_accept, add_output, add_records, whole
from vpp_fmu.app.cli.output import answer

EXAMPLE = "vpp identify campaigns/monday -o out"


def configure(parser):
    parser.add_argument("campaign", metavar="CAMPAIGN", help="folder of the campaign")
    add_records(parser)
    parser.add_argument("--method", choices=METHODS, default=METHODS[0], help="how to search (default: %(default)s)")
    parser.add_argument(
        "--starts", type=whole(1, 1000), default=8, metavar="N", help="starts of the search (default: %(default)s)"
    )
    parser.add_argument("--seed", type=SEED, default=0, metavar="N", help="of the random starts (default: %(default)s)")
    add_accept(parser)
    add_output(parser)


def run(options):
    with tqdm(disable=None, leave=False, bar_format="{desc} {elapsed}") as bar:
        return answer(options, identify, stage=bar.set_description)
