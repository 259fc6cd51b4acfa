"""Controller FMUs that fail during a run: the paper's controller in C with a fault in its step."""

import zipfile
from pathlib import Path

from vpp_fmu.export.native_flavour import native_fmu
from vpp_fmu.kernel.controller import CONTROLLER
from vpp_fmu.native.compiler import compiled

HOW = {
    "hangs": "for (;;) { }",
    "exits": "exit(3);",
    "crashes": "*(volatile int *)0 = 1;",
    "errs": "return fmi2Error;",
    "slow": "{ struct timespec t = {0, 6000000}; nanosleep(&t, NULL); }",
}
"""C statement of each fault, which replaces a step."""

_STEP = 'return (fmi2Status)do_step(c, "fmi2DoStep", time, size);'


def stubborn(folder: Path, how: str, after: int | Path) -> Path:
    """Make the FMU in `folder`. Its first `after` steps are good, counted over all instances, also in a rehearsal; if `after`
    is a path, steps are good until that file exists."""
    good = folder / "good.fmu"
    good.write_bytes(native_fmu(CONTROLLER))
    with zipfile.ZipFile(good) as archive:
        files = {name: archive.read(name) for name in archive.namelist()}
    (source,) = (text.decode() for name, text in files.items() if name.endswith(".c"))
    assert source.count(_STEP) == 1
    when = f'!access("{after}", F_OK)' if isinstance(after, Path) else f"steps++ >= {after}"
    sabotage = f"static long steps; (void)steps; if ({when}) {HOW[how]}\n  {_STEP}"
    library = compiled("#include <stdlib.h>\n#include <time.h>\n#include <unistd.h>\n" + source.replace(_STEP, sabotage))
    made = folder / f"{how}.fmu"
    with zipfile.ZipFile(made, "w") as archive:
        for name, content in files.items():
            archive.writestr(name, Path(library._name).read_bytes() if name.startswith("binaries/") else content)
    return made
