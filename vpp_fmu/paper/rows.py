"""The comparison: every number of the paper, ours on the emulated rig and on the paper's model, and why they differ."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass

from vpp_fmu.paper import published
from vpp_fmu.paper.control_rows import control_rows
from vpp_fmu.paper.counterpart import Counterpart, shown
from vpp_fmu.paper.dynamic_rows import dynamic_rows
from vpp_fmu.paper.published import Published
from vpp_fmu.paper.setup_rows import setup_rows
from vpp_fmu.paper.static_rows import static_rows
from vpp_fmu.paper.study import Study

KEY = (
    "r2_adjusted",
    *(f"averaged.tau_{lag}" for lag in ("omega_1", "omega_2", "beta_1", "beta_2")),
    *(f"fine_tuned.tau_{lag}" for lag in ("omega_1", "omega_2", "beta_1", "beta_2")),
    *("overshoots", "cost_fall", "improved", "reached", "overshoot", "up", "down"),
)
"""What a reader wants to know first."""


@dataclass(frozen=True)
class Row:
    """A number of the paper with its counterpart."""

    published: Published
    ours: Counterpart

    def summary(self) -> dict:
        """For paper.json."""
        return asdict(self.published) | asdict(self.ours)

    def cells(self) -> tuple:
        """For a table with COLUMNS."""
        paper, ours = self.published, self.ours
        what = f"{paper.what} [{paper.unit}]" if paper.unit else paper.what
        place = paper.place.replace("section ", "§ ").replace("figures", "fig.").replace("figure", "fig.")
        return what, place, shown(paper.value), ours.shown, shown(ours.model), ours.why


COLUMNS = ("what", "place", "paper", "ours, rig", "ours, paper's model", "why they differ")


def compared(study: Study) -> Mapping[str, Row]:
    """All rows by name, in the paper's order. KeyError: a number without a counterpart."""
    ours = setup_rows(study) | static_rows(study) | dynamic_rows(study) | control_rows(study)
    return {name: Row(paper, ours[name]) for name, paper in published.NUMBERS.items()}
