"""Trace a campaign's residual to what the model lacks, add it, and report the error before and after."""

from pathlib import Path

from tqdm import tqdm

from identification.diagnose.diagnose import Diagnosis, diagnose
from identification.diagnose.empirical import Empirical, corrected, empirical
from identification.diagnose.report.page import diagnosis_page, headline, key_figures
from identification.diagnose.report.summary import summary
from vpp_fmu.campaign import read_campaign
from vpp_fmu.cli.output import add_accept, add_output, as_json, say_written
from vpp_fmu.errors import BadInput
from vpp_fmu.files import OutputFolder
from vpp_fmu.kernel.plant import LIBRARY, plant
from vpp_fmu.kernel.types import Effect
from vpp_fmu.parameters import read_parameters, to_json
from vpp_fmu.record import write_record

EXAMPLE = "vpp diagnose campaigns/monday -o out"


def configure(parser):
    parser.add_argument("campaign", metavar="CAMPAIGN", help="folder of the campaign")
    text = "a model to start from and to judge against, with the effects it has; else the campaign is identified first"
    parser.add_argument("--parameters", metavar="F", help=text)
    parser.add_argument("--effects", metavar="A,B", help="candidates (default: the whole library)")
    text = "where no effect explains the error: correct it by a linear filter, if unseen data gain; never part of the model"
    parser.add_argument("--empirical", action="store_true", help=text)
    parser.add_argument("--workers", type=int, default=2, metavar="N", help="fits that run side by side (default: %(default)s)")
    parser.add_argument("--seed", type=int, default=0, metavar="N", help="of random starts (default: %(default)s)")
    add_accept(parser)
    add_output(parser)


def run(options):
    if options.workers < 1:
        raise BadInput("command line", "--workers", options.workers, "1 or more")
    given = read_parameters(options.parameters, plant) if options.parameters else None
    library = _library(options.effects, given.model.optional if given else ())
    campaign = read_campaign(options.campaign)
    folder = OutputFolder(options.output)
    with tqdm(disable=None, leave=False, bar_format="{desc} {elapsed}") as bar:
        found = diagnose(campaign, library, options.workers, options.seed, bar.set_description, given, options.accept)
        bar.set_description("report")
        correction = empirical(found) if options.empirical else None
        write_diagnosis(folder, found, correction)
        folder.write("report.html", diagnosis_page(found, correction).html())
    for finding in found.quality:
        print(finding.text)
    print(headline(found))
    for label, value, note in key_figures(found):
        print(f"{label}: {value} ({note})" if note else f"{label}: {value}")
    if options.empirical:
        print(correction.told if correction else "empirical: nothing to correct, an effect explains the error or there is none")
    say_written(folder)


def _library(names: str | None, kept: tuple[str, ...]) -> tuple[Effect, ...]:
    """The effects to choose from: all, or those named, and what the model has already."""
    if names is None:
        return LIBRARY
    chosen = [n.strip() for n in names.split(",") if n.strip()]
    known = [e.name for e in LIBRARY if e.off is not None]
    unknown = [n for n in chosen if n not in known]
    if unknown or not chosen:
        allowed = f"names, parted by commas, of {', '.join(known)}"
        raise BadInput("command line", "--effects", ", ".join(unknown) or "none", allowed)
    return tuple(e for e in LIBRARY if e.off is None or e.name in chosen or e.name in kept)


def write_diagnosis(folder: OutputFolder, found: Diagnosis, correction: Empirical | None = None) -> None:
    """All files of a diagnosis but its page."""
    folder.write("diagnosis.json", as_json(summary(found)))
    folder.write("parameters_base.json", to_json(found.parameters(found.base)))
    folder.write("parameters.json", to_json(found.parameters(found.final)))
    write_record(folder, "next_experiment.csv", found.experiment)
    if correction is not None:
        folder.write("empirical.json", as_json(correction.summary()))
    if correction is not None and correction.accepted:
        for record in found.held:
            name = Path(record.source).name.partition(".")[0]
            write_record(folder, f"{name}_empirical.csv", corrected(found, correction, record))
