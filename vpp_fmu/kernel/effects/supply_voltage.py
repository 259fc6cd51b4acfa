"""The measured supply voltage changes the speed: without a speed loop, speed is proportional to voltage.

    u = omega_ref (1 + share (voltage / nominal - 1))

A duty cycle commands a share of the supply (paper, eq. 4: u V_in); the command is scaled for the nominal one. A speed loop
compensates the change in part or wholly: share 1 is no speed loop, 0 a perfect one. A load makes the share smaller; no motor
gains more speed, in proportion, than voltage. So share 1 is the largest: a fit of transients without this bound exceeds it.
"""

from vpp_fmu.kernel.types import Effect, Parameter, Signal


def _step(ops, s, x, p, dt):
    return {"omega_ref": s.omega_ref * (1.0 + p.share * (s.voltage / p.nominal - 1.0))}, {}


EFFECT = Effect(
    "supply_voltage",
    "speed follows the supply voltage",
    _step,
    parameters=(
        Parameter("share", "1", 0.0, 0.0, 1.0, "relative change of speed over relative change of voltage"),
        Parameter("nominal", "V", 24.0, 1.0, 1000.0, "voltage at which speed is as commanded", 24.0),
    ),
    off={"share": 0.0},
    probe={"share": 0.5},
    inputs=(Signal("voltage", "V", "supply voltage", 0.0, 1000.0, 24.0, start=24.0),),
    channels=("omega",),
    says="the rotor speed follows the supply voltage by a share of {share}",
)
