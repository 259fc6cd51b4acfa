"""The report of an allocation: least power over thrust, and the pairs on the map of power."""

from typing import Any

import numpy as np

from identification.fit.uncertainty import NORMAL_95
from identification.power.allocation import Allocation, allocated_controller
from vpp_fmu.app.report import style
from vpp_fmu.app.report.canvas import panels
from vpp_fmu.app.report.page import Page
from vpp_fmu.app.report.result import Result
from vpp_fmu.app.report.sentences import size
from vpp_fmu.digits import number
from vpp_fmu.files import OutputFolder
from vpp_fmu.parameters import ParameterSet, to_json

FORMAT = "vpp-allocation/1"


class AllocateResult(Result):
    """The pair of speed and pitch of least power for each thrust. `found`: the whole allocation."""

    verb = "allocate"
    writes = ("allocation.json", "report.html")
    title = "Speed and pitch for each thrust"
    found: Allocation

    @property
    def pairs(self) -> dict[str, np.ndarray]:
        """Columns of allocation.csv, (thrusts,) each: `thrust` [N], `omega` [rpm], `beta` [deg], `power` [W], 95 % limits."""
        return self.found.columns

    @property
    def gains(self) -> ParameterSet:
        """The controller that rests on these pairs (mode 2), for export_fmu and run_loop."""
        return allocated_controller(self.found, self._parameters)

    def headline(self) -> str:
        found = self.found
        verb = "save" if found.saving >= 0.0 else "cost"
        ends = f"{number(found.thrust[0])} to {number(found.thrust[-1])} N"
        share = f"{100.0 * abs(found.saving):.1f} % of the {found.model.kind} power over {ends}"
        return f"The pairs of speed and pitch {verb} {share}, against the best fixed pitch of {size(found.fixed_beta, 'deg')}."

    def key_figures(self) -> list[tuple[str, str, str]]:
        found = self.found
        low, high = (number(float(extreme(found.beta)), 3) for extreme in (np.min, np.max))
        share = float(np.max(NORMAL_95 * found.power_std / found.power))
        return [
            (
                "power saved",
                f"{100.0 * found.saving:.1f} %",
                f"mean, against the best fixed pitch of the same range of thrust, {found.fixed_beta:.3g} deg",
            ),
            ("best pitch", f"{low} to {high} deg", f"at {number(found.thrust[0], 3)} to {number(found.thrust[-1], 3)} N"),
            (
                f"{found.model.kind} power",
                f"± {100.0 * share:.2g} %",
                "largest half width of its 95 % interval along the pairs",
            ),
            ("reserve of pitch alone", f"{number(float(np.min(found.reserve)), 2)} N", "the least over all thrusts, both ways"),
        ]

    def to_dict(self) -> dict[str, Any]:
        found, rig = self.found, self._parameters.rig
        limits = {"speed": (rig.speed, "rpm"), "pitch": (rig.pitch, "deg")}
        return {
            "format": FORMAT,
            "weight": found.weight,
            "limits": {name: {"min": low, "max": high, "unit": unit} for name, ((low, high), unit) in limits.items()},
            "kind": found.model.kind,
            "best_fixed_pitch": {"value": found.fixed_beta, "unit": "deg"},
            "saving": found.saving,
        }

    def write(self, folder: OutputFolder) -> None:
        rows = [",".join(self.pairs), *(",".join(f"{v:.7g}" for v in row) for row in zip(*self.pairs.values(), strict=True))]
        folder.write("allocation.csv", "\n".join(rows) + "\n")
        folder.write("allocation.h", as_c(self.found))
        folder.write("gains.json", to_json(self._dated(self.gains)))
        super().write(folder)

    def fill(self, page: Page) -> None:
        found = self.found
        goal = "the least power" if found.weight == 0.0 else f"power and reserve of thrust at a weight of {found.weight:g}"
        page.section("The pairs", f"For each thrust the pair of speed and pitch of {goal}, within the rig's limits.")
        title, of = self.headline().removesuffix("."), self.pairs
        fig = panels(title, ["power [W]", "speed [rpm]", "pitch [deg]"], [260, 130, 130], "thrust [N]")
        fig.envelope(found.thrust, of["power_low"], of["power_high"], "95 % interval", style.NOISE)
        fixed = f"best fixed pitch, {found.fixed_beta:.3g} deg"
        fig.line(found.thrust, found.fixed, fixed, style.BEFORE, 1.6, dash="dash")
        for panel, values in enumerate((found.power, found.omega, found.beta)):
            fig.line(found.thrust, values, "best pairs", style.AFTER, 2.2, panel)
        page.figure(fig, "95 % interval: of the power's parameters; the choice of a map's terms is not part of it.")
        bands = [f"{low:.3g} to {high:.3g}" for low, high in found.beta_band]
        cells = found.thrust, found.omega, found.beta, bands, found.power, of["power_high"] - found.power, found.reserve
        rows = [tuple(map(number, row, (4, 5, 3, 4, 4, 2, 3))) for row in zip(*cells, strict=True)]
        columns = ("thrust [N]", "speed [rpm]", "pitch [deg]", "pitch, 95 % [deg]", "power [W]", "± 95 % [W]", "reserve [N]")
        page.table(columns, rows[:: max(1, len(rows) // 20)], "Pairs; allocation.csv has all of them.")


def as_c(found: Allocation) -> str:
    """The pairs as a C header: a table on a uniform grid of thrust and a function that interpolates it."""
    thrust = found.thrust
    omega, beta = (", ".join(f"{v:.6e}f" for v in values) for values in (found.omega, found.beta))
    return f"""\
/* Pairs of speed [rpm] and pitch [deg] for {len(thrust)} thrusts [N], weight {found.weight:g} (0: least power). */
#ifndef VPP_ALLOCATION_H
#define VPP_ALLOCATION_H

#define VPP_PAIRS {len(thrust)}
static const float vpp_thrust_first = {thrust[0]:.7g}f, vpp_thrust_step = {thrust[1] - thrust[0]:.7g}f;
static const float vpp_omega[VPP_PAIRS] = {{{omega}}};
static const float vpp_beta[VPP_PAIRS] = {{{beta}}};

/* The pair of a thrust, interpolated; that of the first or last thrust outside. */
static void vpp_pair(float thrust, float *omega, float *beta)
{{
    float at = (thrust - vpp_thrust_first) / vpp_thrust_step;
    int k;
    if (!(at > 0.0f)) at = 0.0f;
    if (at > VPP_PAIRS - 1.0f) at = VPP_PAIRS - 1.0f;
    k = (int)at;
    if (k > VPP_PAIRS - 2) k = VPP_PAIRS - 2;
    at -= (float)k;
    *omega = vpp_omega[k] + at * (vpp_omega[k + 1] - vpp_omega[k]);
    *beta = vpp_beta[k] + at * (vpp_beta[k + 1] - vpp_beta[k]);
}}

#endif
"""
