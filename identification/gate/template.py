"""A small campaign to start from: every file, every column, and what each means."""

import json

import numpy as np

from identification.gate.made import Maker, write_campaign
from vpp_fmu.campaign import GRID
from vpp_fmu.files import OutputFolder
from vpp_fmu.kernel.scales import Scales
from vpp_fmu.record import QUANTITIES
from vpp_fmu.rig import FILE, FORMAT, Rig

MAKER = Maker(
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
"""A large, slow rotor: its lags show in rows that are few enough to read."""

COLUMNS = {
    "time": "from 0, increasing; steps need not be equal. In steps.csv each run has its own time from 0",
    "omega_ref": "commanded speed: the value in a row acts from that row's time on, until the next row",
    "beta_ref": "commanded pitch, in the same way; a rig of fixed pitch writes its pitch in every row",
    "omega": "measured speed, as the sensor shows it at the row's time, before the row's command acts; optional",
    "thrust": "measured thrust, tared at rest, sampled as the speed is; upwards is positive; an empty cell where there is none",
    "beta": "measured pitch; optional",
    "voltage": "supply voltage; optional, effects of the supply need it",
    "current": "supply current; optional",
    "run": "of steps.csv only: number of the run; one single step of one command a run, its rows one after another",
    "thrust_std": "of static.csv only: standard deviation of the single readings at the point, not of their mean",
    "samples": "of static.csv only: how many independent readings the mean is of",
}
"""What every column of a campaign means."""

FILES = {
    "static.csv": "steady points, one a row: both commands, means of speed and thrust once all has settled",
    "steps.csv": "single steps, one a run: up and down, of speed and of pitch",
    "open_loop.csv": "the record that the model is fitted to: a minute or more of moves of speed, of pitch, and of both",
    "repeat.csv": "the same commands once more: what differs is noise",
    "validation.csv": "other commands, of the same kind: never fitted, so its error is an honest one",
    FILE: "what the rig may do. Every entry is optional; what is missing is taken from the files",
}
"""What every file of a campaign is."""


def write_template(folder: OutputFolder) -> None:
    """The files of a campaign that the model made, with noise, and a README.md that explains them."""
    campaign = MAKER.campaign(np.random.default_rng(1), folder.path)
    write_campaign(folder, campaign)
    rig = Rig("template", MAKER.speed, MAKER.pitch, (0.0, MAKER.scales.thrust_scale), scales=MAKER.scales).summary()
    declared = {name: rig[name] for name in ("name", "speed", "pitch", "thrust")}
    folder.write(FILE, json.dumps({"format": FORMAT, **declared}, indent=2) + "\n")
    folder.write("README.md", explanation())


def explanation() -> str:
    """The README.md beside a template."""
    units = {name: signal.unit for name, signal in QUANTITIES.items()} | {
        "time": "s",
        "run": "1",
        "thrust_std": "N",
        "samples": "1",
    }
    files = "\n".join(f"- `{name}`: {text}." for name, text in FILES.items())
    columns = "\n".join(f"| `{name}` | {units[name]} | {text} |" for name, text in COLUMNS.items())
    return f"""# A campaign

Made up, of a rotor of {MAKER.speed[1]:g} rpm and {MAKER.scales.thrust_scale:g} N. Put your own numbers in its place,
delete what you did not measure, and run `vpp check` on the folder. Any file may be missing, down to one record, or be gzipped.

{files}

A file is a CSV with these columns, by these names, in any order; others are kept and named.

| column | unit | meaning |
| --- | --- | --- |
{columns}

`static.csv` has {", ".join(f"`{n}`" for n in GRID)}. A record needs `time`, `omega_ref`, `beta_ref` and `thrust`; a lag is
told by rows that are at most a fifth of it apart.

`{FILE}`: `speed`, `pitch` and `thrust` are the least and the greatest that may be commanded, or that the sensor bears; no
command that this project writes leaves them. Two more entries may stand in it:

- `"slew": {{"speed": 20000, "pitch": 60}}`: how steep commands may be [rpm/s, deg/s]; without it they may jump.
- `"scales": {{"omega_scale": 1500, "beta_scale": 10, "beta_offset": -2, "thrust_scale": 80}}` [rpm, deg, deg, N]: what is 1 in
  the model's normalised quantities; without it they are round numbers for what was measured.
"""
