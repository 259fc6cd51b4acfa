"""Find for each thrust the pair of speed and pitch of least power, from parameters with torque or power.

gains.json is a controller that comes to rest on these pairs (mode 2), for vpp export --gains and vpp cosim."""

import os

from identification.power.allocation import COLUMNS, Allocation, allocate, allocated_controller, table
from identification.power.model import PowerModel
from vpp_fmu.app.cli.answer import Answer
from vpp_fmu.app.cli.inputs import add_plant, read_plant
from vpp_fmu.app.cli.options import SEED, Number, whole
from vpp_fmu.app.cli.output import add_output, dated, written
from vpp_fmu.app.report.pages.allocation import allocation_page, headline, key_figures
from vpp_fmu.files import OutputFolder
from vpp_fmu.outputs import OutputSet
from vpp_fmu.parameters import ParameterSet, beside, to_json
from vpp_fmu.structured import as_json

EXAMPLE = "vpp allocate --parameters out/parameters.json -o pairs"

FORMAT = "vpp-allocation/1"

POINTS = whole(2, 1000)
"""Number of rows of the table."""


def configure(parser):
    add_plant(parser, ", identified from a campaign with torque, power, or voltage and current", required=True)
    text = "0: least power; 1: largest reserve of thrust that pitch alone, the fast actuator, can add and remove; between: both"
    parser.add_argument("--weight", type=Number(0.0, 1.0, "1"), default=0.0, metavar="W", help=f"{text} (default: 0)")
    parser.add_argument("--points", type=POINTS, default=41, metavar="N", help="number of thrusts (default: %(default)s)")
    parser.add_argument("--seed", type=SEED, default=0, metavar="N", help="of the draws for the bands (default: %(default)s)")
    add_output(parser)


def run(options):
    parameters = read_plant(options)
    power = PowerModel.of(parameters, beside(options.parameters))
    found = allocate(parameters, power, options.weight, options.points, options.seed)
    folder = OutputSet(options.output, "allocate")
    write_allocation(folder, found, parameters=(options.parameters, parameters))
    return Answer(headline(found), summary(found), figures=key_figures(found), written=written(options, folder, parameters))


def write_allocation(folder: OutputFolder, found: Allocation, **came: tuple[str | os.PathLike[str], ParameterSet]) -> None:
    """All files of an allocation. `came`: (file, its content) of the plant's parameters."""
    parameters = found.model.parameters
    rows = [",".join(COLUMNS), *(",".join(f"{v:.7g}" for v in row) for row in table(found))]
    folder.write("allocation.csv", "\n".join(rows) + "\n")
    folder.write("allocation.h", as_c(found))
    folder.write("gains.json", to_json(dated(allocated_controller(found, parameters), **came)))
    folder.write("allocation.json", as_json(summary(found)))
    folder.write("report.html", allocation_page(found).html())


def summary(found: Allocation) -> dict:
    """The content of allocation.json."""
    limits = {
        name: {"min": low, "max": high}
        for name, (low, high) in (("speed", found.surface.speed), ("pitch", found.surface.pitch))
    }
    return {
        "format": FORMAT,
        "weight": found.weight,
        "limits": {"speed": limits["speed"] | {"unit": "rpm"}, "pitch": limits["pitch"] | {"unit": "deg"}},
        "kind": found.model.kind,
        "best_fixed_pitch": {"value": found.fixed_beta, "unit": "deg"},
        "saving": found.saving,
    }


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
