"""All errors that a caller may catch, and the warning. The command line prints an error as one line and exits with code 2."""

import difflib
from collections.abc import Iterable

ARGUMENT = "argument"
"""Where a `BadInput` is, if it is about an argument of a verb's function. The command line names its own option instead."""


class VppError(Exception):
    """Base of all errors this project raises on purpose. `code`: the command line's exit code."""

    code = 2

    @property
    def parts(self) -> dict[str, str | None]:
        """The error's parts, as --json prints them; None for an unknown one."""
        return {"file": None, "field": None, "found": str(self), "expected": None, "try": None}


class BadInput(VppError):
    """A file, folder or option holds something that is not allowed.

    The message is one line: "FILE: FIELD: found X, expected Y. Try: Z". `found` and `allowed` are nouns of the same kind;
    `hint` is what the user may do or type next, if `allowed` does not say it.
    """

    def __init__(self, where: object, field: str, found: object, allowed: str, hint: str = ""):
        self.where, self.field, self.found, self.allowed, self.hint = str(where), field, str(found), allowed, hint
        super().__init__(f"{where}: {field}: found {found}, expected {allowed}" + (f". Try: {hint}" if hint else ""))

    @property
    def parts(self) -> dict[str, str | None]:
        return {
            "file": self.where,
            "field": self.field,
            "found": self.found,
            "expected": self.allowed,
            "try": self.hint or None,
        }

    def __reduce__(self) -> tuple[type, tuple[str, str, str, str, str]]:  # pickled by worker processes
        return type(self), (self.where, self.field, self.found, self.allowed, self.hint)


class SimulationFailed(VppError):
    """A model or FMU could not take a step: the message says which, when, and with what inputs."""


class NotIdentifiable(VppError):
    """The data hold no information on a requested quantity."""


class CompilerMissing(VppError):
    """No C compiler was found where one is needed."""


class WorkerLost(VppError):
    """A worker process died before its work was done."""


class ExtraMissing(VppError):
    """A required optional library is not installed; the message names it and the command that installs it."""


class RecordWarning(UserWarning):
    """A file holds columns that are kept but not used."""


def near(word: str, known: Iterable[str]) -> str:
    """The end of a message about an unknown word: the most similar known word; "" without one."""
    folded = {name.casefold(): name for name in known}
    found = difflib.get_close_matches(word.casefold(), folded)
    return f". Did you mean {' or '.join(folded[name] for name in found)}?" if found else ""
