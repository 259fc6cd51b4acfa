"""A learned law as a model: the controller's variables, a flag for the fallback, and the speed if it is observed."""

from vpp_fmu.kernel.controller import CONTROLLER
from vpp_fmu.kernel.effects.policy import Law, policy_effect
from vpp_fmu.kernel.plant import OURS
from vpp_fmu.kernel.scales import PAPER, Scales
from vpp_fmu.kernel.signals import OMEGA
from vpp_fmu.kernel.types import BOOLEAN, Model, Signal

NAME = "VppPolicy"

FALLBACK = Signal("fallback", "1", "the dual PID acts in place of the learned law", 0.0, 1.0, kind=BOOLEAN)


def policy_model(law: Law, scales: Scales = PAPER, outputs: int = 3) -> Model:
    """The law's model for a rig of these scales. `outputs`: 2 omits the flag for the fallback, as a controller has no
    such output."""
    return Model(
        NAME,
        "Learned law: thrust error to speed and pitch commands, with a dual PID to fall back on",
        inputs=(*CONTROLLER.inputs, *([OMEGA] if "omega" in law.observe else [])),
        outputs=(*CONTROLLER.outputs, FALLBACK)[:outputs],
        effects=(policy_effect(law),),
        sample_time="sample_time",
        **OURS,
    ).sized(scales)
