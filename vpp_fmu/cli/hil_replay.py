"""Feed what a controller saw in a recorded run to a controller FMU, and compare what it commands, to the bit.

An FMU runs its author's code, with your rights."""

import warnings

from hil.replay import replay
from vpp_fmu.cli.output import add_output, as_json, say_written
from vpp_fmu.errors import BadInput
from vpp_fmu.files import OutputFolder
from vpp_fmu.plants import COMMANDS, FmuController
from vpp_fmu.record import QUANTITIES, RecordWarning, read_record
from vpp_fmu.report import Page, two_records

EXAMPLE = "vpp hil replay out/run.csv fmus/VppController.fmu -o replay"


def configure(parser):
    parser.add_argument("recorded", metavar="RUN", help="run.csv of vpp hil run: time, thrust_set, thrust and the commands")
    parser.add_argument("controller", metavar="CONTROLLER", help="controller FMU: thrust_set, thrust to omega_ref, beta_ref")
    add_output(parser)


def run(options):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RecordWarning)  # a run has more columns than a record must
        recorded = read_record(options.recorded, ("time", "thrust_set", "thrust", *COMMANDS))
    if len(recorded) < 2:
        raise BadInput(options.recorded, "rows", len(recorded), "two or more")
    folder, controller = OutputFolder(options.output), FmuController(options.controller)
    found = replay(recorded, controller)
    controller.close()
    row = found.first_difference
    told = {
        "format": "vpp-replay/1",
        "rows": len(recorded),
        "same_to_the_bit": row is None,
        "first_difference": None if row is None else float(recorded.time[row]),
        "largest": found.largest,
    }
    said = f"{options.controller} on the {len(recorded)} rows of {options.recorded}: "
    if row is None:
        said += "the same commands to the bit"
    else:
        omega, beta = found.largest.values()
        said += f"other commands from {recorded.time[row]:.3f} s on, at most {omega:.3g} rpm and {beta:.3g} deg off"
    page = Page("Replay", said + ".")
    for name, quantity in (("omega_ref", "speed command"), ("beta_ref", "pitch command")):
        title = f"The replayed {quantity} differs by at most {found.largest[name]:.3g} {QUANTITIES[name].unit}"
        a, b = found.recorded[name], found.record[name]
        fig = two_records(recorded.time, a, recorded.time, b, "recorded", "replayed", title, quantity, QUANTITIES[name].unit)
        page.figure(fig, f"Of every row, {quantity} as recorded and as replayed.")
    folder.write("replay.json", as_json(told))
    folder.write("report.html", page.html())
    print(said)
    say_written(folder)
