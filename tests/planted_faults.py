"""Faults planted in good campaigns of three sizes of rigs, and the gate's findings on them.

The campaigns are the model's own response with noise and a tachometer of one mark, on rigs drawn about three sizes: 1.2 N at
20 000 rpm and 500 Hz, 15 N at 6000 rpm and 250 Hz, 180 N at 2500 rpm and 100 Hz. They are written to files and read like a
user's.
"""

import json
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from identification.gate.finding import ERROR, Finding
from identification.gate.gate import look
from identification.gate.synthetic import SyntheticRig, varied, write_campaign
from identification.identify import identify
from vpp_fmu.campaign import Campaign, read_campaign
from vpp_fmu.errors import VppError
from vpp_fmu.files import OutputFolder
from vpp_fmu.kernel.scales import Scales
from vpp_fmu.record import Record

SIZES = {
    "1.2 N": SyntheticRig(
        scales=Scales(20000.0, 15.0, 5.0, 1.2),
        speed=(7000.0, 20000.0),
        pitch=(-5.0, 10.0),
        row=0.002,
        hold=(0.3, 0.8),
        section=8.0,
        noise=0.012,
        digit=0.00024,
        values={"tau_omega_1": 0.06, "tau_omega_2": 0.02, "tau_beta_1": 0.05, "tau_beta_2": 0.03},
    ),
    "15 N": SyntheticRig(
        scales=Scales(),
        speed=(2000.0, 6000.0),
        pitch=(-5.0, 10.0),
        row=0.004,
        hold=(1.0, 2.5),
        section=16.0,
        noise=0.13,
        digit=0.003,
        values={"tau_beta_1": 0.374, "tau_beta_2": 0.207},
    ),
    "180 N": SyntheticRig(
        scales=Scales(2500.0, 12.0, -2.0, 180.0),
        speed=(800.0, 2500.0),
        pitch=(2.0, 14.0),
        row=0.01,
        hold=(2.0, 5.0),
        section=40.0,
        noise=1.5,
        digit=0.036,
        values={"tau_omega_1": 0.5, "tau_omega_2": 0.2, "tau_beta_1": 0.4, "tau_beta_2": 0.25},
    ),
}
"""Centres about which rigs are drawn, by their largest thrust."""

SPREAD = 0.2
"""Share by which a drawn rig's lags and coefficients differ from its size's."""

Change = Callable[[Campaign, np.random.Generator], Campaign]


def records(campaign: Campaign, change: Callable[[Record], Record], steps: bool = True) -> Campaign:
    """A campaign with every record changed."""
    names = [n for n in ("open_loop", "repeat", "validation") if getattr(campaign, n) is not None]
    changed = {n: change(getattr(campaign, n)) for n in names}
    return replace(campaign, **changed, steps=tuple(map(change, campaign.steps)) if steps else campaign.steps)


def column(campaign: Campaign, name: str, change: Callable[[np.ndarray], np.ndarray], static: bool = True) -> Campaign:
    """A campaign with a column of every record changed, and of the steady points."""
    found = records(campaign, lambda r: r.with_columns(**{name: change(r[name])}))
    if static and campaign.static is not None and hasattr(campaign.static, name):
        found = replace(found, static=replace(campaign.static, **{name: change(getattr(campaign.static, name))}))
    return found


def scaled(name: str, factor: float, static: bool = True) -> Change:
    """A column in another unit."""
    return lambda c, rng: column(c, name, lambda x: x * factor, static)


def both_in_rad(c: Campaign, rng) -> Campaign:
    """Commanded and measured speed in rad/s."""
    return column(column(c, "omega", lambda x: x * np.pi / 30.0), "omega_ref", lambda x: x * np.pi / 30.0)


def thinned(c: Campaign, rng) -> Campaign:
    """Every n-th row, such that rows are half the fastest lag apart."""
    row, lag = float(np.median(c.open_loop.steps)), min(SIZES[c.folder.name].values.get("tau_omega_2", 0.053), 1.0)
    every = max(2, round(0.5 * lag / row))

    def slower(record: Record) -> Record:
        return record.part(slice(None, None, every))

    return replace(records(c, slower, steps=False), steps=())


def spiked(c: Campaign, rng) -> Campaign:
    """One reading in a thousand is off by a third of the largest."""

    def change(record: Record) -> Record:
        thrust = record["thrust"].copy()
        rows = rng.choice(len(thrust), max(1, len(thrust) // 1000), replace=False)
        thrust[rows] += rng.choice([-1.0, 1.0], len(rows)) * 0.33 * np.ptp(thrust)
        return record.with_columns(thrust=thrust)

    return records(c, change, steps=False)


def offset(share: float, static: bool) -> Change:
    """A tare that is off by a share of the largest thrust."""
    return lambda c, rng: column(c, "thrust", lambda x: x + share * c.open_loop["thrust"].max(), static)


def clipped(c: Campaign, rng) -> Campaign:
    """Thrust clipped at 70 % of its largest value."""
    limit = 0.7 * float(c.open_loop["thrust"].max())
    return column(c, "thrust", lambda x: np.minimum(x, limit), static=False)


def frozen(name: str) -> Change:
    """A column that is constant over a twentieth of the open-loop record."""

    def change(c: Campaign, rng) -> Campaign:
        values, rows = c.open_loop[name].copy(), len(c.open_loop)
        values[rows // 8 : rows // 8 + rows // 20] = values[rows // 8]
        return replace(c, open_loop=c.open_loop.with_columns(**{name: values}))

    return change


def doubled(c: Campaign, rng) -> Campaign:
    """A speed of twice the marks over a twentieth of the open-loop record, three times."""
    part = np.arange(len(c.open_loop)) / len(c.open_loop)
    wrong = np.any([(part > start) & (part < start + 0.05) for start in (0.1, 0.4, 0.8)], axis=0)
    return replace(c, open_loop=c.open_loop.with_columns(omega=np.where(wrong, 2.0, 1.0) * c.open_loop["omega"]))


def dead(name: str) -> Change:
    """A sensor without a signal."""
    return lambda c, rng: column(c, name, lambda x: np.full(len(x), 0.0), static=False)


def gaps(c: Campaign, rng) -> Campaign:
    """Three times 2 % of the rows are missing."""

    def change(record: Record) -> Record:
        rows = np.arange(len(record))
        lost = np.zeros(len(rows), bool)
        for share in (0.2, 0.45, 0.8):
            lost |= (rows > share * len(rows)) & (rows < (share + 0.02) * len(rows))
        return record.part(~lost)

    return records(c, change, steps=False)


def late_commands(c: Campaign, rng) -> Campaign:
    """Commands that are logged late by the lag of the speed."""
    rows = max(2, round(SIZES[c.folder.name].values.get("tau_omega_1", 0.172) / float(np.median(c.open_loop.steps))))

    def change(record: Record) -> Record:
        late = {n: np.append(np.full(rows, record[n][0]), record[n][:-rows]) for n in ("omega_ref", "beta_ref")}
        return record.with_columns(**late)

    return records(c, change, steps=False)


def unrelated(c: Campaign, rng) -> Campaign:
    """Thrust that runs backwards in time."""
    return replace(records(c, lambda r: r.with_columns(thrust=r["thrust"][::-1].copy()), steps=False), static=None, steps=())


@dataclass(frozen=True)
class Planted:
    """A fault: its change, the code of the required finding, and the contents of a rig.json beside it. `fit`: only a fit shows
    the fault."""

    change: Change
    code: str
    rig: Callable[[Campaign], Mapping] | None = None
    fit: bool = False


FAULTS = {
    "thrust with its sign flipped": Planted(scaled("thrust", -1.0), "thrust_sign"),
    "pitch with its sign flipped": Planted(scaled("beta_ref", -1.0), "pitch_sign"),
    "time in ms": Planted(scaled("time", 1e3), "time_unit"),
    "measured speed in rad/s": Planted(scaled("omega", np.pi / 30.0), "speed_unit"),
    "both speeds in rad/s": Planted(both_in_rad, "speed_unit"),
    "pitch in rad": Planted(scaled("beta_ref", np.pi / 180.0), "pitch_unit"),
    "records' thrust in gf": Planted(scaled("thrust", 101.972, False), "thrust_unit"),
    "records' thrust in kgf": Planted(scaled("thrust", 0.101972, False), "thrust_unit"),
    "records' thrust in lbf": Planted(scaled("thrust", 0.224809, False), "thrust_unit"),
    "all thrust in gf, rig.json in N": Planted(
        scaled("thrust", 101.972),
        "thrust_unit",
        lambda c: {"thrust": {"min": 0.0, "max": SIZES[c.folder.name].scales.thrust_scale, "unit": "N"}},
    ),
    "rows half the fastest lag apart": Planted(thinned, "slow_sampling", fit=True),
    "spikes": Planted(spiked, "spikes"),
    "tare off by 5 %": Planted(offset(0.05, True), "tare"),
    "tare off by 5 % in the records": Planted(offset(0.05, False), "tare", fit=True),
    "few moves": Planted(
        lambda c, rng: replace(
            c, static=None, steps=(), repeat=None, open_loop=c.open_loop.part(slice(0, len(c.open_loop) // 6))
        ),
        "thin",
        fit=True,
    ),
    "thrust clipped": Planted(clipped, "clipped"),
    "thrust frozen": Planted(frozen("thrust"), "frozen"),
    "measured speed frozen": Planted(frozen("omega"), "frozen"),
    "thrust dead": Planted(dead("thrust"), "thrust_dead"),
    "measured speed dead": Planted(dead("omega"), "speed_dead"),
    "rows missing": Planted(gaps, "gap"),
    "commands logged late": Planted(late_commands, "early"),
    "another record's speed": Planted(
        lambda c, rng: replace(c, open_loop=c.open_loop.with_columns(omega=c.validation["omega"][: len(c.open_loop)])),
        "speed_off",
    ),
    "speed command not logged": Planted(
        lambda c, rng: records(c, lambda r: r.with_columns(omega_ref=np.full(len(r), np.median(r["omega_ref"]))), steps=False),
        "not_logged",
    ),
    "repeat is a copy": Planted(lambda c, rng: replace(c, repeat=replace(c.open_loop, source="repeat.csv")), "copied"),
    "beyond rig.json": Planted(
        lambda c, rng: c,
        "beyond_rig",
        lambda c: {"speed": {"min": 0.0, "max": 0.8 * float(c.open_loop["omega_ref"].max()), "unit": "rpm"}},
    ),
    "a scale of another rig": Planted(
        lambda c, rng: c,
        "on_bound",
        lambda c: {"scales": {"thrust_scale": 0.02 * SIZES[c.folder.name].scales.thrust_scale}},
        fit=True,
    ),
    "thrust of another time": Planted(unrelated, "poor_fit", fit=True),
    "speed doubled for a while": Planted(doubled, "speed_multiple"),
    "validation repeats open_loop": Planted(
        lambda c, rng: replace(c, validation=replace(c.repeat, source="validation.csv"), repeat=None), "seen_commands"
    ),
}


def good(size: str, seed: int, section: float | None = None) -> Campaign:
    """A campaign of a rig drawn about a size; `section` s of each kind of move (default: the size's)."""
    rng = np.random.default_rng([seed, len(size)])
    rig = replace(SIZES[size], section=section or SIZES[size].section)
    return varied(rig, rng, SPREAD).campaign(rng, Path(size))


def written(campaign: Campaign, folder: Path, rig: Mapping | None = None) -> Campaign:
    """The campaign, written to files and read again."""
    write_campaign(OutputFolder(folder), campaign)
    if rig is not None:
        (folder / "rig.json").write_text(json.dumps({"format": "vpp-rig/1", **rig}))
    return read_campaign(folder)


def said(campaign: Campaign, fit: bool) -> tuple[Finding, ...]:
    """Findings of the gate on the files and, unless one of them is an error, on the fit."""
    findings = look(campaign).findings
    if not fit or any(f.level == ERROR for f in findings):
        return findings
    try:
        return identify(campaign, starts=1).quality
    except VppError as error:
        return (*findings, Finding("no_fit", str(campaign.folder), "fit", 0.0, "1", str(error), "see above"))


def planted(fault: str, campaign: Campaign, seed: int = 0) -> tuple[Finding, ...]:
    """Findings on a good campaign with a fault inserted."""
    plan, rng = FAULTS[fault], np.random.default_rng([seed, 1])
    with tempfile.TemporaryDirectory() as folder:
        measured = written(plan.change(campaign, rng), Path(folder), plan.rig and plan.rig(campaign))
        return said(measured, plan.fit)
