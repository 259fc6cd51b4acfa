"""Compare two records, at the times of the first."""

from vpp_fmu.app.cli.options import add_output, run_file
from vpp_fmu.app.cli.output import answered, output
from vpp_fmu.app.report.pages.loop import CompareResult
from vpp_fmu.comparison import compare
from vpp_fmu.record import read_record

EXAMPLE = "vpp compare measured.csv out/prediction.csv -o out"


def configure(parser):
    parser.add_argument("first", type=run_file, metavar="A", help="a record, or the folder of a run or a prediction")
    parser.add_argument("second", type=run_file, metavar="B", help="the same")
    add_output(parser)


def run(options):
    with output(options) as folder:
        found = compare(read_record(options.first, ("time",)), read_record(options.second, ("time",)))
        return answered(options, folder, CompareResult(found, options.first, options.second))
