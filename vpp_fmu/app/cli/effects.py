"""List the effects of the library: equations, parameters and responses, from their declarations."""

from collections.abc import Sequence
from pathlib import Path

from vpp_fmu.app.cli.answer import Answer
from vpp_fmu.app.cli.options import add_effects_from
from vpp_fmu.app.report.pages.effects import effects_page
from vpp_fmu.files import OutputFolder
from vpp_fmu.kernel.types import Effect
from vpp_fmu.own_effects import library_with

EXAMPLE = "vpp effects --html effects.html"


def configure(parser):
    parser.add_argument("--html", metavar="FILE", help="write a page with each effect's equation, parameters and response")
    add_effects_from(parser)


def run(options):
    library = library_with(options.effects_from)
    effects = [e for e in library if e.off is not None]
    width, place = max(len(e.name) for e in effects), []
    if options.html:
        path = Path(options.html)
        place = [f"written to {OutputFolder(path.parent).write(path.name, effects_page(effects, library).html())}"]
    lines = [f"{effect.name:{width}}  {effect.description}" for effect in effects]
    return Answer("\n".join(lines), summary(effects), written=place)


def summary(effects: Sequence[Effect]) -> dict:
    """The object of --json: the declarations."""
    own = ("name", "unit", "default", "minimum", "maximum", "description")
    return {
        "format": "vpp-effects/1",
        "effects": [
            {
                "name": effect.name,
                "description": effect.description,
                "says": effect.says,
                "parameters": [{name: getattr(p, name) for name in own} for p in effect.parameters],
            }
            for effect in effects
        ],
    }
