"""The controller: the paper's dual PID as a sampled model."""

from collections.abc import Mapping

from vpp_fmu.kernel.effects.dual_pid import DUAL_PID
from vpp_fmu.kernel.effects.dual_pid import SPEED_ONLY as SPEED_MODE
from vpp_fmu.kernel.plant import OURS
from vpp_fmu.kernel.scales import PAPER
from vpp_fmu.kernel.signals import BETA_REF, OMEGA_REF, THRUST
from vpp_fmu.kernel.types import Model, Signal

DUAL = {"kp_omega": 9.82, "ki_omega": 115.3, "kd_omega": 0.318, "kp_beta": 9.0, "ki_beta": 70.44, "kd_beta": 0.25}
"""Published gains, both actuators (paper, section 4.3); also the defaults."""

SPEED_ONLY = {"kp_omega": 7.47, "ki_omega": 67.7, "kd_omega": 0.15, "speed_only": 1.0, "beta_fixed": 10.0}
"""Published gains, speed alone at the highest pitch."""

CONTROLLER = Model(
    "VppController",
    "Dual PID: thrust error to speed and pitch commands",
    inputs=(Signal("thrust_set", "N", "wanted thrust", THRUST.minimum, THRUST.maximum, 15.0, scale="thrust"), THRUST),
    outputs=(OMEGA_REF, BETA_REF),
    effects=(DUAL_PID,),
    sample_time="sample_time",
    sets={"dual": DUAL, "speed_only": SPEED_ONLY},
    **OURS,
).sized(PAPER)


def speed_alone(values: Mapping[str, float]) -> bool:
    """Whether a controller of these values commands speed alone (mode 1)."""
    return values.get("speed_only", 0.0) > 0.5 or values.get("mode", 0.0) == SPEED_MODE
