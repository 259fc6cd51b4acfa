"""The result of a verb: its finding, key figures, numbers, report and files, for Python and for the command line."""

import os
from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar

from plotly import graph_objects as go

from identification.fit.problem import Prior
from vpp_fmu import __version__
from vpp_fmu.app.report.page import Page
from vpp_fmu.date import now
from vpp_fmu.errors import BadInput, VppError
from vpp_fmu.files import OutputFolder
from vpp_fmu.notebook import table_html
from vpp_fmu.outputs import OutputSet
from vpp_fmu.parameters import ParameterSet
from vpp_fmu.structured import as_json


@dataclass(frozen=True, eq=False)
class Knowledge:
    """Uncertainty of a plant's parameters: `prior`, and the factor `inflation` by which autocorrelated residuals widen it.
    `noise`: (standard deviation of a thrust reading [N], its source). None: unknown."""

    prior: Prior | None = None
    inflation: float = 1.0
    noise: tuple[float, str] | None = None


class Result(ABC):
    """The result of a verb: answer, files and report are made of `headline`, `key_figures`, `to_dict` and `fill`. `found`: all
    of it; `save` writes its files.

    `verb`: its name; `writes`: its files that hold `to_dict` (.json) and the report (.html). `title`, `source`: of the report;
    the latter is the measurement and its date."""

    verb: ClassVar[str]
    writes: ClassVar[tuple[str, ...]] = ("report.html",)
    title = ""

    def __init__(
        self,
        found: Any,
        parameters: ParameterSet | None = None,
        file: str | os.PathLike[str] | None = None,
        source: str = "",
    ):
        """`parameters`: those of the plant in its files; `file`: that they were read from, if any."""
        self.found, self._parameters, self._file = found, parameters, file
        self._source = source or (parameters.label if parameters else "")

    @abstractmethod
    def headline(self) -> str:
        """The finding in a sentence."""

    def key_figures(self) -> list[tuple[str, str, str]]:
        """Key figures (label, value, note)."""
        return []

    def to_dict(self) -> dict[str, Any]:
        """All numbers, as the verb's JSON file holds them; strictly valid JSON."""
        content: dict[str, Any] = self.found.summary()
        return content

    @abstractmethod
    def fill(self, page: Page) -> None:
        """Add figures and tables to the report, below the headline and the tiles."""

    @property
    def source(self) -> str:
        """The measurement and its date, above the report."""
        return self._source

    def tiles(self) -> list[tuple[str, str, str]]:
        """Key figures on top of the report."""
        return self.key_figures()

    def page(self) -> Page:
        """The report."""
        page = Page(self.title, self.headline(), self.source)
        page.tiles(self.tiles())
        self.fill(page)
        return page

    def write(self, folder: OutputFolder) -> None:
        """Write the verb's files."""
        for name in self.writes:
            folder.write(name, self.page().html() if name.endswith(".html") else as_json(self.to_dict()))

    def lines(self) -> list[str]:
        """Warnings and other important lines."""
        return []

    @property
    def failure(self) -> VppError | None:
        """An error that is reported after the answer."""
        return None

    def details(self) -> list[str]:
        """Lines for --verbose only."""
        return []

    @property
    def identity(self) -> str | None:
        """Identity of the parameters in the files."""
        return self._parameters.identity if self._parameters else None

    def _dated(self, own: ParameterSet) -> ParameterSet:
        """A set of the result with its version, date and identity, and the parameters that it was made from."""
        return dated(own, parameters=(self._file, self._parameters) if self._file and self._parameters else None)

    def save(self, folder: str | os.PathLike[str]) -> Path:
        """Write the files of `vpp VERB -o folder`, and return the folder. An earlier run's files of the same model are removed,
        other files stay. BadInput if it can't be written."""
        target = OutputSet(folder, self.verb)
        self.write(target)
        target.finish(self.identity)
        return target.path

    def plot(self, figure: int = 1) -> go.Figure:
        """A figure of the report by its number, from 1. BadInput if it has no such figure."""
        figures = self.page().figures
        if not 1 <= figure <= len(figures):
            allowed = f"1 to {len(figures)}" if figures else "none, there is nothing to draw"
            raise BadInput(type(self).__name__, "figure", figure, allowed)
        return figures[figure - 1].plotly()

    def __repr__(self) -> str:
        return f"{type(self).__name__}({'; '.join(f'{label}: {value}' for label, value, _ in self.key_figures())})"

    def _repr_html_(self) -> str:
        return table_html(type(self).__name__, ("what", "value", "note"), self.key_figures())


def dated(parameters: ParameterSet, /, **parents: tuple[str | os.PathLike[str], ParameterSet] | None) -> ParameterSet:
    """The set with version, date and identity in its source, and its inputs: `parents`, (file, its content) by role."""
    came = {role: {"file": Path(p[0]).name, "identity": p[1].identity} for role, p in parents.items() if p}
    own = {"version": __version__, "date": now(), "identity": parameters.identity}
    return replace(parameters, source={**parameters.source, **own, **came})


def write_report(result: Result, path: str | os.PathLike[str]) -> Path:
    """Write a result's report, a self-contained HTML file; returns its path. BadInput.

    >>> vpp.write_report(vpp.check(vpp.example_campaign()), "check.html").name
    'check.html'
    """
    target = Path(path)
    return OutputFolder(target.parent).write(target.name, result.page().html())
