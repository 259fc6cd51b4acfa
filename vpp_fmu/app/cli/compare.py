"""Compare two records, at the times of the first."""

from vpp_fmu.app.cli.answer import Answer
from vpp_fmu.app.cli.options import add_output, run_file
from vpp_fmu.app.cli.output import written
from vpp_fmu.app.report.pages.loop import comparison_page
from vpp_fmu.comparison import compare
from vpp_fmu.outputs import OutputSet
from vpp_fmu.record import read_record
from vpp_fmu.structured import as_json

EXAMPLE = "vpp compare measured.csv out/prediction.csv -o out"


def configure(parser):
    parser.add_argument("first", type=run_file, metavar="A", help="a record, or the folder of a run or a prediction")
    parser.add_argument("second", type=run_file, metavar="B", help="the same")
    add_output(parser)


def run(options):
    found = compare(read_record(options.first, ("time",)), read_record(options.second, ("time",)))
    folder = OutputSet(options.output, "compare")
    page, titles = comparison_page(found, options.first, options.second)
    folder.write("comparison.json", as_json(found.summary()))
    folder.write("report.html", page.html())
    text = f"Over {found.time[-1] - found.time[0]:.4g} s that both records have: {titles[0] if titles else 'no shared column'}."
    return Answer(text, found.summary(), titles[1:], written=written(options, folder))
