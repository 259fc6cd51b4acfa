"""The whole error tree. Everything a caller may catch stands here; the command line turns each into one line and exit 2."""


class VppError(Exception):
    """Base of all errors this project raises on purpose. `code`: what the command line then exits with."""

    code = 2


class BadInput(VppError):
    """A file, folder or option holds something that is not allowed.

    The message is one line: which file, which field, what was found, what is allowed.
    """

    def __init__(self, where: object, field: str, found: object, allowed: str):
        self.where, self.field, self.found, self.allowed = str(where), field, str(found), allowed
        super().__init__(f"{where}: {field}: found {found}, allowed is {allowed}")

    def __reduce__(self) -> tuple[type, tuple[str, str, str, str]]:  # from a worker process it must arrive as what it is
        return type(self), (self.where, self.field, self.found, self.allowed)


class SimulationFailed(VppError):
    """A model or FMU could not take a step: the message says which, when, and with what inputs."""


class NotIdentifiable(VppError):
    """The data hold no information on what was asked for."""


class CompilerMissing(VppError):
    """No C compiler was found where one is needed."""


class WorkerLost(VppError):
    """A process that shared the work has died before it was done."""


class ExtraMissing(VppError):
    """An optional library is needed that is not installed; the message says which, and how to get it."""
