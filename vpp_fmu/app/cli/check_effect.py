"""Check a user-defined effect before it is fitted: all invariants of the library's effects.

The file defines EFFECT, a vpp_fmu.Effect, and optionally its place in the chain, PORT or BEFORE; see README.md."""

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
    trial, broken = Trial(effect, library), {}
    print(f"{effect.name}: {effect.description}")
    for name, invariant in INVARIANTS.items():
        try:
            result = f"yes  {invariant(trial)}"
        except Broken as why:
            broken[name] = str(why)
            result = f"NO   {why}"
        except Exception as error:  # foreign code may raise any exception; a traced `if` is a TypeError
            broken[name] = " ".join(f"{type(error).__name__}: {error}".split())
            result = f"NO   {broken[name]}"
        print(f"  {name:32} {result}")
    if broken:
        first, why = next(iter(broken.items()))
        more = f" (and {len(broken) - 1} more)" if len(broken) > 1 else ""
        raise BadInput(options.file, f"EFFECT {effect.name}: {first}", f"{why}{more}", "an effect that passes all checks above")
