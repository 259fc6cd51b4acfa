"""Find the effects that the model lacks from a campaign's residual, add them, and report the error before and after.

Of several campaigns, a fleet, each is diagnosed alone into its own folder, and a table summarises all.
"""

import traceback
from collections.abc import Sequence
from pathlib import Path

from identification.workers import spread
from vpp_fmu.app.api.diagnose import candidates, diagnose
from vpp_fmu.app.cli.answer import Answer
from vpp_fmu.app.cli.options import SEED, WORKERS, Number, add_accept, add_effects_from, add_output, add_records
from vpp_fmu.app.cli.output import answer, answered, called, output, stages
from vpp_fmu.app.report.pages.fleet import Entry, FleetResult, compared, entry, refusal
from vpp_fmu.errors import BadInput, VppError
from vpp_fmu.parameters import parameters_file

EXAMPLE = "vpp diagnose campaigns/monday -o out"


def configure(parser):
    text = "folder of the campaign; of several, each is diagnosed alone, and a table summarises all"
    parser.add_argument("campaigns", metavar="CAMPAIGN", nargs="+", help=text)
    text = "initial and reference model, with its effects (default: identify the campaign first)"
    parser.add_argument("--parameters", type=parameters_file, metavar="F", help=text)
    parser.add_argument("--effects", metavar="A,B", help="candidates (default: the whole library)")
    add_effects_from(parser)
    add_records(parser)
    text = "minimum size of interest: rms change of the thrust by an effect (default: a small share of the noise)"
    parser.add_argument("--smallest", type=Number(0.0, 1e5, "N"), metavar="N", help=text)
    text = "minimum size of interest of the speed, rms (default: the uncertainty of the sensor's readings)"
    parser.add_argument("--smallest-speed", type=Number(0.0, 1e5, "rpm"), metavar="RPM", help=text)
    text = "number of parallel fits; for several campaigns, of parallel campaigns (default: %(default)s)"
    parser.add_argument("--workers", type=WORKERS, default=2, metavar="N", help=text)
    text = "time after which no further step of a search begins; what was not tried is named (default: no limit)"
    parser.add_argument("--budget", type=Number(0.0, 1e6, "s"), metavar="S", help=text)
    text = "Dask scheduler for several campaigns instead; its workers read the same folders"
    parser.add_argument("--scheduler", metavar="ADDRESS", help=text)
    parser.add_argument("--seed", type=SEED, default=0, metavar="N", help="of random starts (default: %(default)s)")
    add_accept(parser)
    add_output(parser)


def run(options):
    if options.effects is not None:
        options.effects = [name for part in options.effects.split(",") if (name := part.strip())] or [""]
    if len(options.campaigns) > 1:
        return _fleet(options)
    if options.scheduler:
        raise BadInput("command line", "--scheduler", "one campaign", "two or more campaigns, which it distributes")
    with stages("vpp diagnose", options.quiet) as stage:
        return answer(options, diagnose, campaign=options.campaigns[0], stage=stage, progress=stage.progress)


def _of_fleet(job: tuple) -> Entry:
    """Diagnose one campaign of a fleet into its own folder, which is complete even if others fail. A refused campaign does not
    stop the others."""
    options, name, campaign, own = job
    try:
        found = called(diagnose, options, campaign=campaign, workers=1)
        found.save(own)
    except VppError as error:
        return refusal(name, campaign, str(error))
    except Exception as error:
        where = traceback.extract_tb(error.__traceback__)[-1]
        return refusal(name, campaign, f"{type(error).__name__} in {Path(where.filename).name}, line {where.lineno}: {error}")
    return entry(name, found.found)


def _fleet(options) -> Answer:
    """Diagnose each campaign into a folder of its name, and write a table of all. A refused campaign is a failure."""
    if options.records:
        raise BadInput(
            "command line", "--record", f"{len(options.campaigns)} campaigns", "one campaign to which the record belongs"
        )
    called(candidates, options)  # errors common to all campaigns are reported once
    there = [Path(campaign).resolve() for campaign in options.campaigns]  # a worker of Dask may have another working folder
    jobs = [
        (options, name, str(own), str(Path(options.output, name).resolve()))
        for name, own in zip(_folders(there), there, strict=True)
    ]
    with output(options, " several") as folder:
        entries = compared(spread(_of_fleet, jobs, options.workers, options.scheduler, "campaigns"))
        return answered(options, folder, FleetResult(entries))


def _folders(campaigns: Sequence[Path]) -> list[str]:
    """A folder's name for each campaign: its own, with a number if another campaign has it."""
    found: list[str] = []
    for campaign in campaigns:
        own = campaign.name or "campaign"
        free = (name for name in (own, *(f"{own}-{k}" for k in range(2, len(campaigns) + 2))) if name not in found)
        found.append(next(free))
    return found
