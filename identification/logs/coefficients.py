"""Convert a table of thrust coefficients, as wind tunnels publish them, to steady points.

    T = CT rho n^2 D^4   (N; n in rev/s, D the diameter in m)

This is the propeller's definition, not the helicopter's by tip speed and disc area.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from identification.static.static_map import DENSITY
from vpp_fmu.errors import BadInput


@dataclass(frozen=True)
class Propeller:
    """`diameter` [m], None if unknown, and air `density` [kg/m^3]."""

    diameter: float | None = None
    density: float = DENSITY


def thrust_of(columns: Mapping[str, np.ndarray], propeller: Propeller, source: str) -> tuple[dict[str, np.ndarray], list[str]]:
    """(columns (n,) with `thrust` [N] for `ct`, without rows of advance ratio above 0; messages). BadInput without a diameter
    or a static row."""
    if propeller.diameter is None:
        allowed, hint = "the rotor's diameter: T = CT rho n^2 D^4", "--diameter D in m"
        raise BadInput(source, "ct", "thrust coefficients and no diameter", allowed, hint)
    advance = columns.get("advance_ratio", np.zeros(len(columns["ct"])))
    static = ~(advance > 0.0)
    if not static.any():
        raise BadInput(source, "advance_ratio", f"above 0 in all {len(advance)} rows", "rows at no airspeed: static points")
    kept = {name: column[static] for name, column in columns.items() if name != "advance_ratio"}
    turns = kept.get("omega", kept.get("omega_ref")) / 60.0
    kept["thrust"] = kept.pop("ct") * propeller.density * turns**2 * propeller.diameter**4
    notes = [f"thrust: CT rho n^2 D^4 with D = {propeller.diameter:g} m and rho = {propeller.density:g} kg/m^3"]
    if not static.all():
        notes.append(f"advance ratio: {int((~static).sum())} rows above 0 are not static, left out")
    return kept, notes
