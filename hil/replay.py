"""Replay a recorded run through a controller, and compare its commands with the recorded ones."""

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import isclose
from pathlib import Path

import numpy as np

from vpp_fmu.digits import number
from vpp_fmu.errors import BadInput
from vpp_fmu.plants import COMMANDS, Controller
from vpp_fmu.record import Record
from vpp_fmu.structured import read_object

SHOWN = 3
"""Number of different settings that a comparison names."""

WANTED = {"omega_ref": "omega_wanted", "beta_ref": "beta_wanted"}
"""Columns of a rig's run with the controller's commands; `omega_ref` and `beta_ref` are those after the limits."""


@dataclass(frozen=True, eq=False)
class Replay:
    """`record`: the run with the replayed commands as `omega_ref`, `beta_ref` (rows,); `recorded`: those of the run."""

    record: Record
    recorded: dict[str, np.ndarray]

    @property
    def first_difference(self) -> int | None:
        """The first row in which a bit differs."""
        differs = np.any([self.record[name] != was for name, was in self.recorded.items()], axis=0)
        return int(np.argmax(differs)) if differs.any() else None

    @property
    def largest(self) -> dict[str, float]:
        """The largest difference of each command [rpm, deg]."""
        return {name: float(np.max(np.abs(self.record[name] - was))) for name, was in self.recorded.items()}

    def summary(self) -> dict:
        """The content of replay.json."""
        row = self.first_difference
        return {
            "format": "vpp-replay/1",
            "rows": len(self.record),
            "same_to_the_bit": row is None,
            "first_difference": None if row is None else float(self.record.time[row]),
            "largest": self.largest,
        }

    def said(self, other: Sequence[str] = ()) -> str:
        """The comparison in words; `other`: settings that differ from the run's, as from `other_settings`."""
        row = self.first_difference
        if row is None:
            return "the same commands to the bit"
        if other:
            shown = ", ".join(other[:SHOWN]) + (f" and {len(other) - SHOWN} more" if len(other) > SHOWN else "")
            return f"not the run's controller: {shown}. Its commands differ from {self.record.time[row]:.3f} s on"
        omega, beta = self.largest.values()
        return f"other commands from {self.record.time[row]:.3f} s on, at most {omega:.3g} rpm and {beta:.3g} deg off"


def other_settings(run: str | os.PathLike, settings: Mapping[str, float]) -> list[str]:
    """Each of a controller's `settings`, by name, that differs from the one in the hil.json beside `run`; none if unknown."""
    path = Path(run).with_name("hil.json")
    try:
        controller = read_object(path, "vpp-hil/1").get("controller", {}) if path.is_file() else {}
    except BadInput:
        return []
    recorded = controller.get("parameters", {})
    return [
        f"{name} {number(recorded[name])} in the run, {number(value)} here"
        for name, value in settings.items()
        if name in recorded and not isclose(recorded[name], value, rel_tol=1e-9, abs_tol=1e-12)
    ]


def replay(run: Record, controller: Controller) -> Replay:
    """Feed the set-point and the thrust of each row of `run` to `controller`, and record its commands."""
    wanted, thrust = run["thrust_set"].tolist(), run["thrust"].tolist()
    controller.start(wanted[0], thrust[0])
    commands = np.array([controller.step(*row) for row in zip(wanted, thrust, strict=True)])
    recorded = {name: run[WANTED[name] if WANTED[name] in run else name] for name in COMMANDS}
    return Replay(run.with_columns(**dict(zip(COMMANDS, commands.T, strict=True))), recorded)
