"""Compare two records, at the times of the first."""

from vpp_fmu.app.cli.output import add_output, say_written
from vpp_fmu.app.report.pages.loop import comparison_page
from vpp_fmu.comparison import compare
from vpp_fmu.outputs import OutputSet
from vpp_fmu.record import read_record
from vpp_fmu.structured import as_json

EXAMPLE = "vpp compare measured.csv out/prediction.csv -o out"


def configure(parser):
    parser.add_argument("first", metavar="A", help="a record")
    parser.add_argument("second", metavar="B", help="a record")
    add_output(parser)


def run(options):
    held = compare(read_record(options.first, ("time",)), read_record(options.second, ("time",)))
    folder = OutputSet(options.output, "compare")
    page, titles = comparison_page(held, options.first, options.second)
    folder.write("comparison.json", as_json(held.summary()))
    folder.write("report.html", page.html())
    say_written(folder, lines=titles)
