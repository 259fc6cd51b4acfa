"""A small campaign as a template: every file, every column, and their meaning."""

import json

import numpy as np

from identification.gate.synthetic import SyntheticRig, write_campaign
from vpp_fmu.campaign import GRID
from vpp_fmu.files import OutputFolder
from vpp_fmu.kernel.scales import Scales
from vpp_fmu.record import QUANTITIES
from vpp_fmu.rig import FILE, FORMAT, Rig

TEMPLATE_RIG = SyntheticRig(
    scales=Scales(1500.0, 10.0, -2.0, 80.0),
    speed=(500.0, 1500.0),
    pitch=(2.0, 12.0),
    row=0.05,
    hold=(1.0, 3.0),
    section=8.0,
    noise=0.3,
    digit=0.01,
    values={"tau_omega_1": 0.5, "tau_omega_2": 0.3, "tau_beta_1": 0.45, "tau_beta_2": 0.3},
    grid=5,
)
"""A large, slow rotor: few rows identify its lags."""

COLUMNS = {
    "time": "from 0, increasing; periods may differ. In steps.csv each run has its own time from 0",
    "omega_ref": "commanded speed: the value of a row acts from its time to that of the next row",
    "beta_ref": "commanded pitch, in the same way; a rig of fixed pitch writes its pitch in every row",
    "omega": "measured speed that the sensor shows at the row's time, before the row's command acts; optional",
    "thrust": "measured thrust, tared at rest, sampled as the speed is; upwards is positive; an empty cell without a reading",
    "beta": "measured pitch; optional",
    "voltage": "supply voltage; optional, required by effects of the supply",
    "current": "supply current; optional",
    "torque": "torque of the rotor; optional",
    "power": "electrical power; optional",
    "run": "of steps.csv only: number of the run; each run has one step of one command, and its rows are contiguous",
    "thrust_std": "of static.csv only: standard deviation of the single readings at the point, not of their mean",
    "samples": "of static.csv only: number of independent readings of the mean",
}
"""Meaning of every column of a campaign."""

FILES = {
    "static.csv": "steady points, one a row: both commands, means of settled speed and thrust",
    "steps.csv": "single steps, one a run: up and down, of speed and of pitch",
    "open_loop.csv": "the record that the model is fitted to: a minute or more of moves of speed, of pitch, and of both",
    "repeat.csv": "the same commands again: the difference is noise",
    "validation.csv": "other commands of the same kind: the hold-out record, never fitted",
    FILE: "limits of the rig. Every entry is optional; missing ones are inferred from the files",
}
"""Content of every file of a campaign."""


def write_template(folder: OutputFolder) -> None:
    """Write the files of a synthetic campaign with noise, and a README.md that explains them."""
    campaign = TEMPLATE_RIG.campaign(np.random.default_rng(1), folder.path)
    write_campaign(folder, campaign)
    rig = Rig(
        "template", TEMPLATE_RIG.speed, TEMPLATE_RIG.pitch, (0.0, TEMPLATE_RIG.scales.thrust_scale), scales=TEMPLATE_RIG.scales
    ).summary()
    declared = {name: rig[name] for name in ("name", "speed", "pitch", "thrust")}
    folder.write(FILE, json.dumps({"format": FORMAT, **declared}, indent=2) + "\n")
    folder.write("README.md", explanation())


def explanation() -> str:
    """The README.md of the template."""
    units = {name: signal.unit for name, signal in QUANTITIES.items()} | {
        "time": "s",
        "run": "1",
        "thrust_std": "N",
        "samples": "1",
    }
    files = "\n".join(f"- `{name}`: {text}." for name, text in FILES.items())
    columns = "\n".join(f"| `{name}` | {units[name]} | {text} |" for name, text in COLUMNS.items())
    return f"""# A campaign

Synthetic data of a rotor of {TEMPLATE_RIG.speed[1]:g} rpm and {TEMPLATE_RIG.scales.thrust_scale:g} N. Replace them by your
measurements, delete columns and files that you did not measure, and run `vpp check` on the folder. One record is enough; all
other files are optional. Files may be gzipped.

{files}

A file is a CSV with these columns, by these names, in any order; other columns are kept and listed.

| column | unit | meaning |
| --- | --- | --- |
{columns}

`static.csv` has {", ".join(f"`{n}`" for n in GRID)}; for `vpp allocate` it, or the record, also
has `power`, or `voltage` and `current`, or `torque`. A record needs `time`, `omega_ref`, `beta_ref` and `thrust`; to
identify a lag, the sampling period must be at most a fifth of it.

`{FILE}`: `speed`, `pitch` and `thrust` are ranges (least, greatest) of the commands and of the thrust sensor. Commands that
this project writes stay within them. Two more entries are optional:

- `"slew": {{"speed": 20000, "pitch": 60}}`: maximum rates of the commands [rpm/s, deg/s]; without it they may jump.
- `"scales": {{"omega_scale": 1500, "beta_scale": 10, "beta_offset": -2, "thrust_scale": 80}}` [rpm, deg, deg, N]: units
  of the model's normalised quantities; without it they are round numbers of the measured ranges.
"""
