"""Compare two records, at the times of the first."""

from vpp_fmu.app.cli.output import add_output, say_written
from vpp_fmu.app.report.figures.time import two_records
from vpp_fmu.app.report.page import Page
from vpp_fmu.comparison import compare
from vpp_fmu.digits import number
from vpp_fmu.outputs import OutputSet
from vpp_fmu.record import QUANTITIES, read_record
from vpp_fmu.structured import as_json

EXAMPLE = "vpp compare measured.csv out/prediction.csv -o out"


def configure(parser):
    parser.add_argument("first", metavar="A", help="a record")
    parser.add_argument("second", metavar="B", help="a record")
    add_output(parser)


def run(options):
    held = compare(read_record(options.first, ("time",)), read_record(options.second, ("time",)))
    folder = OutputSet(options.output, "compare")
    summary = held.summary()
    page = Page("Two records", f"{options.second} beside {options.first}, at the times of the latter.")
    rows, titles = [], []
    for name, figures in summary["columns"].items():
        unit = QUANTITIES[name].unit if name in QUANTITIES else "as recorded"
        rows.append((f"{name} [{unit}]", figures["rms"], figures["mean"], figures["largest"]))
        title = f"{name} differs by {number(figures['rms'])} {unit} rms, at most {number(figures['largest'])} {unit}"
        pair = (held.time, held.first[name], held.time, held.second[name])
        page.figure(two_records(*pair, options.first, options.second, title, name, unit), "Second less first below.")
        titles.append(title)
    page.table(("column", "rms", "mean", "largest"), rows, "Differences, second less first.")
    folder.write("comparison.json", as_json(summary))
    folder.write("report.html", page.html())
    say_written(folder, lines=titles)
