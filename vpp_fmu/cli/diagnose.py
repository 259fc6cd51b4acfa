"""Trace a campaign's residual to what the model lacks, add it, and report the error before and after."""

from tqdm import tqdm

from identification.diagnose.diagnose import diagnose
from identification.diagnose.report import diagnosis_page, headline, key_figures
from identification.diagnose.summary import summary
from vpp_fmu.campaign import read_campaign
from vpp_fmu.cli.output import add_output, as_json, say_written
from vpp_fmu.files import OutputFolder
from vpp_fmu.parameters import to_json
from vpp_fmu.record import write_record

EXAMPLE = "vpp diagnose campaigns/monday -o out"


def configure(parser):
    parser.add_argument("campaign", metavar="CAMPAIGN", help="folder of the campaign")
    parser.add_argument("--workers", type=int, default=2, metavar="N", help="fits that run side by side (default: %(default)s)")
    parser.add_argument("--seed", type=int, default=0, metavar="N", help="of random starts (default: %(default)s)")
    add_output(parser)


def run(options):
    folder = OutputFolder(options.output)
    with tqdm(disable=None, leave=False, bar_format="{desc} {elapsed}") as bar:
        found = diagnose(
            read_campaign(options.campaign),
            workers=options.workers,
            seed=options.seed,
            stage=bar.set_description,
        )
    write_diagnosis(folder, found)
    print(headline(found))
    for label, value, note in key_figures(found):
        print(f"{label}: {value} ({note})" if note else f"{label}: {value}")
    say_written(folder)


def write_diagnosis(folder, found):
    """All files of a diagnosis but the page's neighbours."""
    folder.write("diagnosis.json", as_json(summary(found)))
    folder.write("parameters_base.json", to_json(found.parameters(found.base)))
    folder.write("parameters.json", to_json(found.parameters(found.final)))
    write_record(folder, "next_experiment.csv", found.experiment)
    folder.write("report.html", diagnosis_page(found).html())
