"""An actuator executes its command in steps, while the log holds the fine command.

    executed = step round(command / step)

Multiples count from 0 of the command's unit; ties round to even. A servo's pulse has steps of 0.25 deg and more, a speed
controller's frame of 10 rpm and more. At a fixed multiple k the executed command is k step, with the derivative k.
"""

from vpp_fmu.kernel.types import Effect, Parameter


def _resolution(channel: str, scale: str, unit: str, largest: float, plausible: float) -> Effect:
    """The resolution of a `channel`'s command, in its `unit`; sizes are shares of the rig's `scale`."""
    command = f"{channel}_ref"

    def step(ops, s, x, p, dt):
        fine, coarse = getattr(s, command), p.step > 0.0
        size = ops.where(coarse, p.step, 1.0)
        return {command: ops.where(coarse, size * ops.whole(fine / size), fine)}, {}

    return Effect(
        f"{scale}_command_resolution",
        f"the {scale} command is executed in steps",
        step,
        parameters=(
            Parameter(
                "step", unit, 0.0, 0.0, largest, f"step of the executed {scale} command; 0: none", plausible, scale=scale
            ),
        ),
        off={"step": 0.0},
        probe={"step": plausible},
        rounds={command: "step"},
        channels=(channel,),
        says=f"the {scale} command is executed in steps of {{step}}",
    )


PITCH = _resolution("beta", "pitch", "deg", 0.15, 0.04)
"""Of the paper's span of 15 deg: up to 2.25 deg."""

SPEED = _resolution("omega", "speed", "rpm", 0.05, 0.008)
"""Of the paper's 6000 rpm: up to 300 rpm."""
