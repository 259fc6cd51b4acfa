"""A rig's day: model and controller improve each other round by round, during operation.

Each round runs the rig over random thrust levels, a mission, beside the twin, and diagnoses the mission's record from the
present model on: its parameters are fitted anew, and missing effects are added. The gains are tuned on this model, and compared
with the present ones by the measured cost on the rig; they are used next if they are better. On the real rig each flight waits
for the operator's consent."""

from dataclasses import replace
from pathlib import Path
from statistics import mean

from hil.loop.session import Setup
from hil.twin.band import Band, read_band
from identification.tune.controllers import controllers
from vpp_fmu.app.api.objects import as_gains, as_parameters
from vpp_fmu.app.api.rounds import MODEL_BASED, POLICIES, Rig, gains_of, new_day, next_round
from vpp_fmu.app.cli import hil
from vpp_fmu.app.cli.answer import Answer, Lines
from vpp_fmu.app.cli.hil import allowed_words
from vpp_fmu.app.cli.options import WORKERS, add_gains, whole
from vpp_fmu.app.cli.output import stages, written
from vpp_fmu.app.day import GAINS, Day, Round
from vpp_fmu.app.report.pages.day import day_page
from vpp_fmu.app.report.result import dated
from vpp_fmu.app.report.sentences import change
from vpp_fmu.errors import BadInput
from vpp_fmu.files import OutputFolder
from vpp_fmu.parameters import beside, check_same_model, parameters_file, to_json
from vpp_fmu.structured import as_json

EXAMPLE = "vpp twin monday --virtual --rounds 4 --parameters out/parameters.json --hide load_cell_gain=0.85"


def configure(parser):
    parser.add_argument("day", metavar="DAY", help="folder of the day, which must not exist")
    parser.add_argument("--rounds", type=whole(1, 50), default=4, metavar="N", help="(default: %(default)s)")
    text = "the initial model; its band is in the identification.json beside it"
    parser.add_argument("--parameters", type=parameters_file, metavar="F", required=True, help=text)
    text = "the controller's that fly first (default: the published ones, at the pace of the parameters' rig)"
    add_gains(parser, text)
    text = "source of new gains (default: %(default)s, tuned on the model; fixed: none)"
    parser.add_argument("--policy", choices=POLICIES, default=MODEL_BASED, help=text)
    text = "of the emulated rig: first round with the effects of --hide (default: %(default)s)"
    parser.add_argument("--hidden-from", type=whole(1, 50), default=2, metavar="K", help=text)
    text = "number of parallel fits of a diagnosis (default: %(default)s)"
    parser.add_argument("--workers", type=WORKERS, default=2, help=text)
    hil.add_rig(parser)


def run(options):
    _check_new(options.day)
    setup, parameters = hil.setup_of(options), as_parameters(options.parameters)
    given = as_gains(options.gains)
    settings = controllers(parameters, given, hil.tick_of(given), options.gains or "gains").settings
    if "dual" not in settings:
        raise BadInput(options.parameters, "rig", "one moving channel", "speed and pitch: a day tunes both")
    known_in = beside(options.parameters)
    band = read_band(known_in)
    check_same_model(known_in, parameters, options.parameters)
    setup = replace(setup, plant=parameters.values)
    day, rig = new_day(parameters, settings["dual"]), _rig(options, setup)
    folder = OutputFolder(options.day)
    with Lines(options) as shown:
        shown(allowed_words(setup.allowed))
        for number in range(1, options.rounds + 1):
            content = _round(options, day, rig, band, number, folder, shown)
    return Answer(headline(day), content, shown, written=written(options, folder))


def _round(options, day: Day, rig: Rig, band: Band, number: int, folder: OutputFolder, shown: Lines) -> dict:
    """Fly a round and write its files; returns the content of day.json so far."""
    own = OutputFolder(folder.path / f"round_{number}")
    with stages("vpp twin", options.quiet) as stage:
        done = next_round(day, rig, band, options.policy, own.path, options.seed, options.workers, stage)
    day.rounds.append(done)
    for line in said(done):
        shown(line)
    return _write(folder, own, day, done)


def headline(day: Day) -> str:
    """The day in a sentence: error and cost at its begin and end."""
    error = change(day.rounds[0].before, day.rounds[-1].after, "N")
    return (
        f"{len(day.rounds)} rounds, {day.alarms} with an alarm: thrust error {error}, cost on the "
        f"rig {change(*day.cost, '1')}; effects added: {', '.join(day.added) or 'none'}."
    )


def _check_new(path: str) -> None:
    there = Path(path)
    if there.exists() and (not there.is_dir() or any(there.iterdir())):
        found = f"{path}, which holds files" if there.is_dir() else f"{path}, a file"
        raise BadInput("command line", "DAY", found, "a new or empty folder")


def _rig(options, setup: Setup) -> Rig:
    """The rig of the options. Hidden effects of the emulated rig appear in a later round; each flight has its own noise."""

    def flown(number: int, flight: int, what: str) -> Setup:
        hil.confirm(setup, [what])
        if setup.emulated is None:
            return setup
        own = setup.emulated if number >= options.hidden_from else replace(setup.emulated, parameters={}, hidden=())
        return replace(setup, emulated=replace(own, seed=100_000 * (options.seed + 1) + 1000 * number + flight))

    return flown


def said(done: Round) -> list[str]:
    alarms = [f"alarm after {one.time:.0f} s, {one.cause}" for one in done.alarms]
    lines = [f"round {done.number}: {'; '.join(alarms) or 'no alarm'}"]
    lines.append(f"  diagnosis of the mission: {done.verdict}{''.join(f' {name}' for name in done.named)}")
    lines.append(f"  error of the thrust in the mission: {done.before:.4f} N before, {done.after:.4f} N fitted anew")
    costs = ", ".join(f"{name} {mean(c):.4f}" for name, c in done.costs.items())
    cheapest = min(done.costs, key=lambda name: sum(done.costs[name]))
    doubt = "" if cheapest == done.winner else f", {cheapest} may be no cheaper"
    lines.append(f"  cost on the rig: {costs}; {done.winner} flies next{doubt}")
    return lines


def _write(folder: OutputFolder, own: OutputFolder, day: Day, done: Round) -> dict:
    """Files after a round: its model and gains, and the day so far; returns the content of day.json."""
    source = {"made_by": "vpp twin", "round": done.number}
    gains = replace(gains_of(done.settings), source=source)
    model = replace(done.parameters, source=done.parameters.source | source)
    for where in (own, folder):
        where.write("parameters.json", to_json(dated(model)))
        where.write("gains.json", to_json(dated(gains)))
    content = {"format": "vpp-day/2", "rounds": [summary(one) for one in day.rounds]}
    folder.write("day.json", as_json(content))
    folder.write("report.html", day_page(day).html())
    return content


def summary(done: Round) -> dict:
    """A round for day.json."""
    return {
        "round": done.number,
        "hidden": list(done.hidden),
        "alarms": [one._asdict() for one in done.alarms],
        "verdict": done.verdict,
        "named": list(done.named),
        "error": {"before": done.before, "after": done.after, "unit": "N"},
        "costs": {name: list(each) for name, each in done.costs.items()},
        "flies_next": done.winner,
        "gains": {name: done.settings[name] for name in GAINS},
    }
