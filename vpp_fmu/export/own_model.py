"""A user's model: found by the name of its module or file, in either form, checked before it is exported."""

import importlib
import importlib.util
import sys
from pathlib import Path

from vpp_fmu.errors import BadInput
from vpp_fmu.export.checks import at_line, check_model
from vpp_fmu.export.description import Experiment
from vpp_fmu.export.trial import expected
from vpp_fmu.kernel.slave import Slave
from vpp_fmu.kernel.types import Model

FORM = "package.module:NAME or path/file.py:NAME of a kernel Model or Slave"


def find_model(where: str) -> Model:
    """The model `package.module:NAME` or `path/file.py:NAME`; modules are also found in the current folder.
    BadInput: an invalid module, or a declaration that can't become an FMU."""
    module, _, name = where.rpartition(":")
    try:
        found = getattr(_imported(module), name)
    except Exception as error:  # a user's module may raise any exception
        field, said = at_line("--model", error), " ".join(str(error).split())
        raise BadInput("vpp export", field, f"{where} ({said})", FORM) from error
    return as_model(where, found)


def _imported(name: str):
    if not name.endswith(".py"):
        if str(Path.cwd()) not in sys.path:
            sys.path.insert(0, str(Path.cwd()))
        return importlib.import_module(name)
    path = Path(name).resolve()
    if str(path.parent) not in sys.path:  # its own imports
        sys.path.insert(0, str(path.parent))
    spec = importlib.util.spec_from_file_location(path.stem, path)
    module = importlib.util.module_from_spec(spec)
    sys.modules[path.stem] = module  # as the import of a module does; dataclasses need it
    spec.loader.exec_module(module)
    return module


def as_model(where: str, found: object) -> Model:
    """A Model, or a Slave's, that can become an FMU. `where`: its name for messages. BadInput."""
    if isinstance(found, type) and issubclass(found, Slave):
        found = found.model()
    if not isinstance(found, Model):
        raise BadInput(where, "model", f"a {type(found).__name__}", "a kernel Model or Slave")
    check_model(where, found)
    expected(where, found, found.values(), Experiment())
    return found
