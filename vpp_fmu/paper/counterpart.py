"""What stands beside a number of the paper."""

from dataclasses import dataclass

from vpp_fmu.paper.published import NUMBERS


@dataclass(frozen=True)
class Counterpart:
    """Ours on the emulated `rig`, with its standard deviation where it is an estimate, and on the paper's `model`, in the
    paper's unit; None: there is none. `why` they differ from the paper's, or why there is none."""

    rig: float | str | None
    model: float | str | None
    why: str
    std: float | None = None

    @property
    def shown(self) -> str | None:
        """The rig's value with its uncertainty."""
        return shown(self.rig) if self.std is None else f"{shown(self.rig)} ± {self.std:.1g}"


def shown(value: float | str | None) -> str | None:
    """A value as a cell: exact numbers stay short, others get four digits."""
    return value if value is None or isinstance(value, str) else f"{value:.4g}"


def of_setup(name: str, rig: float | str, model: float | str | None = None, note: str = "") -> Counterpart:
    """Of the set-up, where nothing is estimated: what the rig has and, in words, whether the paper has the same."""
    same = "as the paper" if shown(rig) == shown(NUMBERS[name].value) else "not as the paper"
    return Counterpart(rig, model, f"{same}; {note}" if note else same)
