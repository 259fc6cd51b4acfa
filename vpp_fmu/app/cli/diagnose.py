"""Find the effects that the model lacks from a campaign's residual, add them, and report the error before and after.

Of several campaigns, a fleet, each is diagnosed alone into its own folder, and a table summarises all.
"""

import traceback
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

from threadpoolctl import threadpool_limits

from identification.diagnose.diagnose import Diagnosis, diagnose
from identification.diagnose.learned.description import FILE, source
from identification.workers import spread
from vpp_fmu.app.cli.answer import Answer
from vpp_fmu.app.cli.identify import named_records
from vpp_fmu.app.cli.options import SEED, WORKERS, Number
from vpp_fmu.app.cli.output import add_accept, add_effects_from, add_output, dated, stages, written
from vpp_fmu.app.report.pages.diagnosis import diagnosis_page, headline, key_figures, not_tried
from vpp_fmu.app.report.pages.fleet import Entry, as_csv, as_parquet, compared, entry, fleet_page, refusal
from vpp_fmu.app.report.summary import identification_of, summary
from vpp_fmu.campaign import read_campaign
from vpp_fmu.errors import BadInput, VppError
from vpp_fmu.files import OutputFolder
from vpp_fmu.kernel.plant import plant
from vpp_fmu.outputs import OutputSet
from vpp_fmu.own_effects import library_with, named
from vpp_fmu.parameters import parameters_file, read_parameters, to_json, to_ssv
from vpp_fmu.record import write_record
from vpp_fmu.structured import as_json

EXAMPLE = "vpp diagnose campaigns/monday -o out"


def configure(parser):
    text = "folder of the campaign; of several, each is diagnosed alone, and a table summarises all"
    parser.add_argument("campaigns", metavar="CAMPAIGN", nargs="+", help=text)
    text = "initial and reference model, with its effects (default: identify the campaign first)"
    parser.add_argument("--parameters", type=parameters_file, metavar="F", help=text)
    parser.add_argument("--effects", metavar="A,B", help="candidates (default: the whole library)")
    add_effects_from(parser)
    parser.add_argument("--record", action="append", default=[], metavar="FILE", help="fit this record too; may be repeated")
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
    if len(options.campaigns) > 1:
        return _fleet(options)
    if options.scheduler:
        raise BadInput("command line", "--scheduler", "one campaign", "two or more campaigns, which it distributes")
    return _one(options, options.campaigns[0])


@threadpool_limits.wrap(limits=1)  # the same digits as in a fleet
def _one(options, campaign: str) -> Answer:
    asked = {**_model(options), "records": named_records(options.record), "campaign": read_campaign(campaign)}
    folder = OutputSet(options.output, "diagnose")
    with stages("vpp diagnose", options.quiet) as stage:
        found = diagnose(**asked, workers=options.workers, stage=stage, progress=stage.progress)
        stage("report")
        write_diagnosis(folder, found, options.parameters)
        folder.write("report.html", diagnosis_page(found).html())
    lines = [finding.text for finding in found.quality] + ([text] if (text := not_tried(found)) else [])
    if found.power:
        from vpp_fmu.app.report.pages.power import power_line  # noqa: PLC0415 most campaigns measure no power

        lines.append(power_line(found.power))
    lines += [f"your logger: {line}" for line in found.logger.lines]
    lines.append(f"next_experiment.csv: commands within {', '.join(found.rig.command_lines())}")
    place = written(options, folder, found.parameters(found.final))
    return Answer(headline(found), summary(found), lines, key_figures(found), written=place)


def _model(options) -> dict:
    """The options common to all campaigns, as arguments of `diagnose`. BadInput."""
    whole = library_with(options.effects_from)
    given = read_parameters(options.parameters, lambda names: plant(names, whole)) if options.parameters else None
    asked = None if options.effects is None else [name for part in options.effects.split(",") if (name := part.strip())] or [""]
    library = named(whole, asked, given.model.optional if given else (), "command line", "--effects")
    names = ("seed", "smallest", "smallest_speed", "accept", "budget")
    return {"library": library, "given": given, **{name: getattr(options, name) for name in names}}


def _of_fleet(job: tuple) -> Entry:
    """Diagnose one campaign of a fleet into its own folder, which is complete even if others fail. A refused campaign does not
    stop the others."""
    options, name, campaign, output = job
    try:
        found = diagnose(read_campaign(campaign), workers=1, **_model(options))
        folder = OutputSet(output, "diagnose")
        write_diagnosis(folder, found, options.parameters)
        folder.write("report.html", diagnosis_page(found).html())
        folder.finish(found.parameters(found.final).identity)
    except VppError as error:
        return refusal(name, campaign, str(error))
    except Exception as error:
        where = traceback.extract_tb(error.__traceback__)[-1]
        return refusal(name, campaign, f"{type(error).__name__} in {Path(where.filename).name}, line {where.lineno}: {error}")
    return entry(name, found)


def _fleet(options) -> Answer:
    """Diagnose each campaign into a folder of its name, and write a table of all. A refused campaign is a failure."""
    if options.record:
        raise BadInput(
            "command line", "--record", f"{len(options.campaigns)} campaigns", "one campaign to which the record belongs"
        )
    _model(options)  # errors common to all campaigns are reported once
    folder = OutputSet(options.output, "diagnose several")
    there = [Path(campaign).resolve() for campaign in options.campaigns]  # a worker of Dask may have another working folder
    jobs = [
        (options, name, str(own), str(Path(options.output, name).resolve()))
        for name, own in zip(_names(there), there, strict=True)
    ]
    entries = compared(spread(_of_fleet, jobs, options.workers, options.scheduler, "campaigns"))
    folder.write("fleet.csv", as_csv(entries))
    if (packed := as_parquet(entries)) is not None:
        folder.write("fleet.parquet", packed)
    folder.write("report.html", fleet_page(entries).html())
    refused, failure = [e.name for e in entries if e.refused], None
    if refused:
        found = f"{len(refused)} refused: {', '.join(refused)}"
        failure = BadInput("fleet", "campaigns", found, "campaigns that can be diagnosed", "vpp check on each of them")
    verdicts = Counter(e.verdict or "refused" for e in entries)
    text = f"{len(entries)} campaigns: {', '.join(f'{count} {verdict}' for verdict, count in verdicts.most_common())}."
    content = {"format": "vpp-fleet/1", "campaigns": [asdict(e) for e in entries]}
    return Answer(text, content, [one.line for one in entries], written=written(options, folder), failure=failure)


def _names(campaigns: Sequence[Path]) -> list[str]:
    """A folder's name for each campaign: its own, with a number if another campaign has it."""
    found: list[str] = []
    for campaign in campaigns:
        own = campaign.name or "campaign"
        free = (name for name in (own, *(f"{own}-{k}" for k in range(2, len(campaigns) + 2))) if name not in found)
        found.append(next(free))
    return found


def write_diagnosis(folder: OutputFolder, found: Diagnosis, given: str | None = None) -> None:
    """All files of a diagnosis but its page. `given`: the file that its starting model was read from, if any.

    parameters.json, parameters.ssv and identification.json are of the final model, parameters_base.json and
    identification_base.json of the one without the found effects.
    """
    folder.write("diagnosis.json", as_json(summary(found)))
    parent = {"descends": (given, found.given)} if found.given and given else {}
    for suffix, fit in (("_base", found.base), ("", found.final)):
        folder.write(f"parameters{suffix}.json", to_json(dated(found.parameters(fit), **parent)))
        folder.write(f"identification{suffix}.json", as_json(identification_of(found, fit)))
    folder.write("parameters.ssv", to_ssv(found.parameters(found.final), "parameters"))
    if found.learned:
        folder.write(FILE, source(found.learned.term, found.rig.scales, found.campaign.folder.name))
    write_record(folder, "next_experiment.csv", found.experiment)
