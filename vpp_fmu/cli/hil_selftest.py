"""Test the rig without turning the rotor: loop timing, buses, calibration, pulse outputs, log."""

from hil.report import add_counts, add_timing
from hil.selftest import selftest
from vpp_fmu.cli import hil_options
from vpp_fmu.cli.options import number, whole
from vpp_fmu.cli.output import add_output, as_json, say_written
from vpp_fmu.errors import VppError
from vpp_fmu.files import OutputFolder
from vpp_fmu.report import Page

EXAMPLE = "vpp hil selftest --seconds 60 --load 2 -o selftest"


class SelfTestFailed(VppError):
    """A check was not passed."""


def configure(parser):
    hil_options.add_rig(parser)
    parser.add_argument(
        "--seconds", type=number(1.0, 3600.0, "s"), default=10.0, metavar="S", help="how long the loop runs (default: 10)"
    )
    text = "so many busy processes beside the loop (2 without a number)"
    parser.add_argument("--load", nargs="?", type=whole(0, 64), const=2, default=0, metavar="N", help=text)
    add_output(parser)


def run(options):
    setup, folder = hil_options.setup_of(options, turning=False), OutputFolder(options.output)
    found = selftest(setup, options.seconds, folder.path, options.load)
    told = found.session.told()
    told |= {"load": options.load, "checks": [{"what": c.what, "good": c.good, "found": c.found} for c in found.checks]}
    folder.write("hil.json", as_json(told))
    folder.write("report.html", _page(found, told, options).html())
    if found.session.timing:
        print(f"loop: {told['real_time']}; {options.load} busy processes beside it\n{found.session.timing.text()}")
    for check in found.checks:
        print(f"{'good' if check.good else 'BAD '}  {check.what}: {check.found}")
    say_written(folder)
    bad = [check.what for check in found.checks if not check.good]
    if bad:
        raise SelfTestFailed(f"not good: {', '.join(bad)}")


def _page(found, told, options) -> Page:
    page = Page(
        "Self-test of the rig", f"{options.seconds:g} s at the idle pulse, {options.load} busy processes beside the loop."
    )
    good = sum(check.good for check in found.checks)
    page.tiles([("checks passed", f"{good} of {len(found.checks)}", "see the table")])
    if found.session.timing:
        add_timing(page, found.session.timing, f"The loop had: {told['real_time']}.")
    rows = [(check.what, "good" if check.good else "not good", check.found) for check in found.checks]
    page.table(("what", "verdict", "found"), rows, "What was looked at.")
    add_counts(page, told["counters"], [(t["time"], t["state"], t["why"]) for t in told["transitions"]])
    return page
