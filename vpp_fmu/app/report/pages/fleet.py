"""Diagnoses of several campaigns: a table with one line each, and a page with the effects found over the dates."""

import csv
import io
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np

from identification.diagnose.diagnosis import Diagnosis
from identification.fit.uncertainty import NORMAL_95
from identification.static.static_map import TERMS, design
from vpp_fmu.app.report import style
from vpp_fmu.app.report.canvas import Figure, panels
from vpp_fmu.app.report.page import Link, Page
from vpp_fmu.app.report.pages.diagnosis import DiagnoseResult
from vpp_fmu.app.report.result import Result
from vpp_fmu.app.report.sentences import titled, words
from vpp_fmu.app.report.summary import summary
from vpp_fmu.campaign import measured_on
from vpp_fmu.digits import TABLE, number
from vpp_fmu.errors import BadInput
from vpp_fmu.files import OutputFolder


@dataclass(frozen=True)
class ThrustMap:
    """A rig's fitted map: `values` and `covariance` of TERMS, normalised by `scales`, and its commands' ranges [rpm], [deg]."""

    values: list[float]
    covariance: list[list[float]]
    scales: Mapping[str, float]
    speed: tuple[float, float]
    pitch: tuple[float, float]

    def thrust(self, omega: float, beta: float) -> tuple[float, float, str]:
        """Thrust [N] at rest at a speed [rpm] and a pitch [deg], its standard error, and the unit."""
        slopes = design(np.array([omega]), np.array([beta]), self.scales)[0] * self.scales["thrust_scale"]
        return float(slopes @ self.values), float(np.sqrt(slopes @ np.array(self.covariance) @ slopes)), "N"


@dataclass(frozen=True)
class Entry:
    """One campaign in the table of a fleet.

    `date`: ISO 8601, "" if unknown. `error_before`, `error_after`, `noise` [N]: held-out thrust error of the base and of the
    exported model, and the noise of one reading. `sizes`: (value, standard error or None, unit) of each parameter found, by
    full name, without those of learned terms, which differ from campaign to campaign. `refused`: why there is no diagnosis,
    else "". `map`: None if refused.
    """

    name: str
    campaign: str
    date: str
    verdict: str = ""
    effects: tuple[str, ...] = ()
    error_before: float | None = None
    error_after: float | None = None
    noise: float | None = None
    sizes: Mapping[str, tuple[float, float | None, str]] = field(default_factory=dict)
    warnings: int = 0
    refused: str = ""
    said: str = ""
    map: ThrustMap | None = None

    @property
    def line(self) -> str:
        """The line that the command prints."""
        return f"{self.name}: refused: {self.refused}" if self.refused else f"{self.name}: {self.verdict}. {self.said}"


def entry(name: str, found: Diagnosis) -> Entry:
    content, folder = summary(found), found.campaign.folder
    (before, _), (after, _) = found.errors(found.base), found.errors(found.final)
    sizes = {
        f"{effect['name']}.{parameter}": (p["value"], p["std"], p["unit"])
        for effect in content["effects"]
        for parameter, p in effect["parameters"].items()
        if parameter != "form" and not (found.learned and effect["name"] == found.learned.term.effect.name)
    }
    return Entry(
        name,
        str(folder),
        measured_on(folder),
        found.verdict,
        (*found.final.effects, *found.left_out),
        before,
        after,
        found.noise.floor,
        sizes,
        len(found.quality),
        said=DiagnoseResult(found).headline(),
        map=_map(found),
    )


def _map(found: Diagnosis) -> ThrustMap:
    values, known = found.parameters(found.final).values, found.final.uncertainty
    chosen = np.array([[name == own for own in known.names] for name in TERMS], float)
    scales = {name: values[name] for name in ("omega_scale", "beta_scale", "beta_offset", "thrust_scale")}
    covariance = (chosen @ known.covariance @ chosen.T).tolist()
    return ThrustMap([values[name] for name in TERMS], covariance, scales, found.rig.speed, found.rig.pitch)


def compared(entries: Sequence[Entry]) -> list[Entry]:
    """The entries; if all rigs have a common range of commands, with each map's thrust at its middle among the sizes."""
    maps = [e.map for e in entries if e.map]
    ranges = [m.speed for m in maps], [m.pitch for m in maps]
    shared = [(max(low for low, _ in own), min(high for _, high in own)) for own in ranges if own]
    if len(maps) < 2 or any(low > high for low, high in shared):
        return list(entries)
    omega, beta = (float(f"{0.5 * (low + high):.3g}") for low, high in shared)
    name = f"thrust_at_{omega:g}_rpm_{beta:g}_deg"
    return [replace(e, sizes={**e.sizes, name: e.map.thrust(omega, beta)}) if e.map else e for e in entries]


def refusal(name: str, campaign: str, why: str) -> Entry:
    """The line of a campaign that cannot be diagnosed."""
    return Entry(name, campaign, measured_on(Path(campaign)), refused=why)


def columns(entries: Sequence[Entry]) -> dict[str, list]:
    """The table by column: the common ones, then each parameter that any campaign has, with its standard error."""
    found = {
        "name": [e.name for e in entries],
        "campaign": [e.campaign for e in entries],
        "date": [e.date for e in entries],
        "verdict": [e.verdict or "refused" for e in entries],
        "effects": [" + ".join(e.effects) for e in entries],
        "error_before_N": [e.error_before for e in entries],
        "error_after_N": [e.error_after for e in entries],
        "noise_N": [e.noise for e in entries],
        "warnings": [e.warnings for e in entries],
        "refused": [e.refused for e in entries],
    }
    for name in parameters(entries):
        own = [e.sizes.get(name, (None, None, "")) for e in entries]
        found |= {name: [value for value, _, _ in own], f"{name}_std": [std for _, std, _ in own]}
    return found


def parameters(entries: Sequence[Entry]) -> list[str]:
    """Full names of all parameters found, in the order of their first campaign."""
    return list(dict.fromkeys(name for e in entries for name in e.sizes))


def as_csv(entries: Sequence[Entry]) -> str:
    """The table as CSV; a cell without value is empty."""
    text, table = io.StringIO(), columns(entries)
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(table)
    writer.writerows(zip(*table.values(), strict=True))
    return text.getvalue()


def as_parquet(entries: Sequence[Entry]) -> bytes | None:
    """The table as Parquet; None if the extra `import` is not installed."""
    try:
        import pyarrow as pa  # noqa: PLC0415  (an extra)
        from pyarrow import parquet  # noqa: PLC0415
    except ImportError:
        return None
    table = columns(entries)
    texts = {"name", "campaign", "date", "verdict", "effects", "refused"}
    kinds = {name: pa.string() if name in texts else pa.int64() if name == "warnings" else pa.float64() for name in table}
    packed = io.BytesIO()
    parquet.write_table(pa.table({name: pa.array(own, kinds[name]) for name, own in table.items()}), packed)
    return packed.getvalue()


class FleetResult(Result):
    """Campaigns that were each diagnosed alone. `found`: their entries."""

    verb = "diagnose"
    found: Sequence[Entry]

    @property
    def title(self) -> str:
        return f"Diagnosis of {len(self.found)} campaigns"

    @property
    def source(self) -> str:
        dates = sorted(e.date[:10] for e in self.found if e.date)
        return " to ".join(dict.fromkeys(dates[:1] + dates[-1:]))

    def _verdicts(self) -> list[tuple[str, int]]:
        return Counter(e.verdict or "refused" for e in self.found).most_common()

    def _several(self) -> dict[str, list[Entry]]:
        """The entries by parameter, if more than one has it, by date."""
        done = sorted((e for e in self.found if not e.refused), key=lambda e: e.date)
        return {name: own for name in parameters(done) if len(own := [e for e in done if name in e.sizes]) > 1}

    def headline(self) -> str:
        text = f"{len(self.found)} campaigns: {', '.join(f'{count} {verdict}' for verdict, count in self._verdicts())}."
        apart = "; ".join(said for name, own in self._several().items() if (said := _farthest(name, own)))
        return f"{text} {apart or 'No parameter differs between them by more than its uncertainty'}."

    def tiles(self) -> list[tuple[str, str, str]]:
        return [(word, str(count), f"of {len(self.found)} campaigns") for word, count in self._verdicts()]

    def lines(self) -> list[str]:
        return [one.line for one in self.found]

    def to_dict(self) -> dict[str, Any]:
        return {"format": "vpp-fleet/1", "campaigns": [asdict(e) for e in self.found]}

    @property
    def failure(self) -> BadInput | None:
        if not (refused := [e.name for e in self.found if e.refused]):
            return None
        what = f"{len(refused)} refused: {', '.join(refused)}"
        return BadInput("fleet", "campaigns", what, "campaigns that can be diagnosed", "vpp check on each of them")

    def write(self, folder: OutputFolder) -> None:
        folder.write("fleet.csv", as_csv(self.found))
        if (packed := as_parquet(self.found)) is not None:
            folder.write("fleet.parquet", packed)
        super().write(folder)

    def fill(self, page: Page) -> None:
        rows = []
        for e in sorted(self.found, key=lambda e: e.date):
            linked = e.name if e.refused else Link(e.name, quote(f"{e.name}/report.html"))
            errors = ("" if value is None else number(value, TABLE) for value in (e.error_before, e.error_after, e.noise))
            rows.append((linked, e.date, e.verdict or "refused", " + ".join(e.effects) or e.refused, *errors, e.warnings))
        heads = ("campaign", "date", "verdict", "effects", "before [N]", "after [N]", "noise [N]", "warnings")
        caption = "Held-out thrust error of the base and of the exported model; fleet.csv has the parameters, too."
        page.table(heads, rows, caption)
        if several := self._several():
            text = "Parameters that more than one campaign has, and the thrust of their maps at the same commands."
            page.section("Sizes", text)
            page.figure(_sizes(several), "Bars are 95 % intervals.")


def _farthest(name: str, own: Sequence[Entry]) -> str:
    """In words: the value farthest from the median, or of two the second from the first, if by more than its 95 % interval."""
    values = np.array([e.sizes[name][0] for e in own])
    middle, of = (float(values[0]), own[0].name) if len(own) == 2 else (float(np.median(values)), "the median")
    far = np.abs(values - middle)
    k = int(np.argmax(far))
    if middle == 0.0 or far[k] <= NORMAL_95 * (own[k].sizes[name][1] or 0.0):
        return ""
    way = "below" if abs(values[k]) < abs(middle) else "above"
    return f"{titled(name)}: {own[k].name} is {100.0 * far[k] / abs(middle):.1f} % {way} {of}"


def _sizes(several: Mapping[str, Sequence[Entry]]) -> Figure:
    """A panel for each parameter with its 95 % intervals, over the campaigns by date."""
    units = {name: own[0].sizes[name][2] for name, own in several.items()}
    labels = [words(name) + ("" if unit == "1" else f" [{unit}]") for name, unit in units.items()]
    far = [said for name, own in several.items() if (said := _farthest(name, own))]
    title = "; ".join(far) or "No parameter differs between the campaigns by more than its uncertainty"
    fig = panels(title, labels, [150] * len(labels), "campaign, by date")
    for panel, (name, own) in enumerate(several.items()):
        values, errors = [e.sizes[name][0] for e in own], [NORMAL_95 * (e.sizes[name][1] or 0.0) for e in own]
        fig.points([e.name for e in own], values, words(name), style.AFTER, 8, panel, "sizes", across="y", error=errors)
    return fig
