"""Identify the model's parameters from a measured campaign (a folder with open_loop.csv, static.csv, ...)."""

from pathlib import Path

from tqdm import tqdm

from identification.fit.refine import METHODS
from identification.identify import Identification, identify
from vpp_fmu.app.cli.answer import Answer
from vpp_fmu.app.cli.options import SEED, whole
from vpp_fmu.app.cli.output import add_accept, add_output, dated, written
from vpp_fmu.app.report.pages.identification import headline, identification_page, key_figures, not_identifiable, remarks
from vpp_fmu.campaign import NAMES, NEED, read_campaign
from vpp_fmu.files import OutputFolder
from vpp_fmu.outputs import OutputSet
from vpp_fmu.parameters import to_json, to_ssv
from vpp_fmu.record import Record, read_record
from vpp_fmu.structured import as_json

EXAMPLE = "vpp identify campaigns/monday -o out"


def configure(parser):
    parser.add_argument("campaign", metavar="CAMPAIGN", help="folder of the campaign")
    parser.add_argument("--record", action="append", default=[], metavar="FILE", help="fit this record too; may be repeated")
    parser.add_argument("--method", choices=METHODS, default=METHODS[0], help="how to search (default: %(default)s)")
    parser.add_argument(
        "--starts", type=whole(1, 1000), default=8, metavar="N", help="starts of the search (default: %(default)s)"
    )
    parser.add_argument("--seed", type=SEED, default=0, metavar="N", help="of the random starts (default: %(default)s)")
    add_accept(parser)
    add_output(parser)


def run(options):
    folder = OutputSet(options.output, "identify")
    with tqdm(disable=None, leave=False, bar_format="{desc} {elapsed}") as bar:
        bar.set_description("read")
        campaign, records = read_campaign(options.campaign), named_records(options.record)
        found = identify(
            campaign,
            method=options.method,
            starts=options.starts,
            seed=options.seed,
            records=records,
            accept=options.accept,
            stage=bar.set_description,
        )
        bar.set_description("report")
        write_identification(folder, found)
    lines = [*(finding.text for finding in found.quality), *remarks(found), *not_identifiable(found)]
    lines += [f"your logger: {line}" for line in found.logger.lines]
    place = written(options, folder, found.parameters)
    return Answer(headline(found), found.summary(), lines, key_figures(found), written=place)


def write_identification(folder: OutputFolder, found: Identification) -> None:
    """All files of an identification."""
    folder.write("parameters.json", to_json(dated(found.parameters)))
    folder.write("parameters.ssv", to_ssv(found.parameters, "parameters"))
    folder.write("identification.json", as_json(found.summary()))
    folder.write("report.html", identification_page(found).html())


def named_records(paths: list[str]) -> dict[str, Record]:
    """Records by the file's name, or by its path if the name occurs twice."""
    records = {}
    for path in paths:
        name = Path(path).name.removesuffix(".gz").removesuffix(".csv")
        taken = {*NAMES, *records}
        records[path if name in taken else name] = read_record(path, NEED, holes=("thrust",))
    return records
