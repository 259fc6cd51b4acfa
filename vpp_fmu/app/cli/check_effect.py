"""Check a user-defined effect before it is fitted: all invariants of the library's effects.

The file defines EFFECT, a vpp_fmu.Effect, and optionally its place in the chain, PORT or BEFORE; see README.md."""

from vpp_fmu.app.cli.answer import Answer
from vpp_fmu.errors import BadInput
from vpp_fmu.invariants import INVARIANTS, Broken, Trial
from vpp_fmu.own_effects import library_with

EXAMPLE = "vpp check-effect my_effect.py"


def configure(parser):
    parser.add_argument("file", metavar="FILE.py", help="the file, as --effects-from takes it; it runs its author's code")


def run(options):
    before = {e.name for e in library_with(())}
    library = library_with([options.file])
    (effect,) = (e for e in library if e.name not in before)
    trial, broken, lines, checks = Trial(effect, library), {}, [], {}
    for name, invariant in INVARIANTS.items():
        try:
            found = str(invariant(trial))
        except Broken as why:
            found = broken[name] = str(why)
        except Exception as error:  # foreign code may raise any exception
            found = broken[name] = " ".join(f"{type(error).__name__}: {error}".split())
        checks[name] = {"holds": name not in broken, "found": found}
        lines.append(f"  {name:32} {'NO ' if name in broken else 'yes'}  {found}")
    text = f"{effect.name} ({effect.description}) passes {len(checks) - len(broken)} of {len(checks)} checks."
    content = {"format": "vpp-check-effect/1", "effect": effect.name, "checks": checks}
    return Answer(text, content, lines, failure=_failure(options.file, effect.name, broken))


def _failure(file: str, name: str, broken: dict[str, str]) -> BadInput | None:
    if not broken:
        return None
    first, why = next(iter(broken.items()))
    more = f" (and {len(broken) - 1} more)" if len(broken) > 1 else ""
    return BadInput(file, f"EFFECT {name}: {first}", f"{why}{more}", "an effect that passes all checks above")
