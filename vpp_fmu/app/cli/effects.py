"""List the effects of the library: equations, parameters and responses, from their declarations."""

from pathlib import Path

from vpp_fmu.app.cli.output import add_effects_from
from vpp_fmu.app.report.pages.effects import effects_page
from vpp_fmu.files import OutputFolder
from vpp_fmu.own_effects import library_with

EXAMPLE = "vpp effects --html effects.html"


def configure(parser):
    parser.add_argument("--html", metavar="FILE", help="write a page with each effect's equation, parameters and response")
    add_effects_from(parser)


def run(options):
    library = library_with(options.effects_from)
    effects = [e for e in library if e.off is not None]
    width = max(len(e.name) for e in effects)
    for effect in effects:
        print(f"{effect.name:{width}}  {effect.description}")
    if options.html:
        path = Path(options.html)
        print(f"written to {OutputFolder(path.parent).write(path.name, effects_page(effects, library).html())}")
