"""A commanded channel: two first-order lags in series (paper, eqs. 13-15). Other effects may act between its stages.

    tau_2 dx/dt = u_ref - x        (the inner stage)
    tau_1 du/dt = x - u            (the outer stage: rotor speed, or blade pitch)

A channel is four effects, so that others can act between them: the input error of the inner stage, the inner stage's change,
the outer stage's change, and its final value. All are exact for a command held over the step, also for equal time constants.
The paper's deviations from the operating point are absolute values here; the equations are linear, so nothing else changes.
"""

from vpp_fmu.kernel.types import Effect, Parameter, State

TIME_CONSTANTS = (0.001, 30.0)
"""Range of a time constant, s: smaller ones are invisible to a logger, larger ones are not plausible."""


def channel(u: str, title: str, unit: str, tau_1: float, tau_2: float) -> tuple[Effect, ...]:
    """The stages of channel `u` ("omega" or "beta"), commanded by the signal `<u>_ref`.

    Signals: `<u>_inner` and `<u>_outer` are the stages' values before the step, `<u>_move` and `<u>_travel` their changes in
    the step. `<u>_error` is the inner stage's input error; `tau_<u>_1` and `tau_<u>_2` are the time constants. The last effect
    sets `<u>`, its mean rate in the step `<u>_rate` and its remaining error `<u>_to_go`. If an effect has set `<u>_lowest` or
    `<u>_highest`, the outer stage stops there.
    """
    ref, error = f"{u}_ref", f"{u}_error"
    inner, move, inner_ahead = f"{u}_inner", f"{u}_move", f"{u}_inner_ahead"
    outer, travel, outer_ahead = f"{u}_outer", f"{u}_travel", f"{u}_outer_ahead"
    slow, fast = f"tau_{u}_1", f"tau_{u}_2"
    lowest, highest = f"{u}_lowest", f"{u}_highest"

    def drive(ops, s, x, p, dt):
        value = getattr(x, inner)
        return {inner: value, error: getattr(s, ref) - value, slow: getattr(p, slow), fast: getattr(p, fast)}, {}

    def first_lag(ops, s, x, p, dt):
        return {move: ops.gain(getattr(s, fast), dt) * getattr(s, error)}, {}

    def second_lag(ops, s, x, p, dt):
        # Within the step the inner stage relaxes towards its next value with its own time constant. The response of the
        # outer stage is the step response of two lags, divided by the gain of the inner lag.
        tau_1, tau_2, value = getattr(s, slow), getattr(s, fast), getattr(x, outer)
        carried = ops.two_lag_step(tau_1, tau_2, dt) / ops.gain(tau_2, dt)
        covered = ops.gain(tau_1, dt) * (getattr(s, inner) - value) + carried * getattr(s, move)
        return {outer: value, travel: covered}, {}

    def reach(ops, s, x, p, dt):
        reached = getattr(s, outer) + getattr(s, travel)
        if hasattr(s, lowest):
            reached = ops.maximum(reached, getattr(s, lowest))
        if hasattr(s, highest):
            reached = ops.minimum(reached, getattr(s, highest))
        published = {f"{u}_rate": (reached - getattr(s, outer)) / dt, f"{u}_to_go": getattr(s, ref) - reached}
        return {u: reached, outer_ahead: reached, inner_ahead: getattr(s, inner) + getattr(s, move), **published}, {}

    def constant(name, default, stage):
        text = f"time constant of the {stage} lag between commanded and reached {title}"
        return Parameter(name, "s", default, *TIME_CONSTANTS, text, nominal=0.1)

    def at_command(ops, s, p):
        return getattr(s, ref)

    def at_inner(ops, s, p):
        return getattr(s, inner)

    constants = constant(slow, tau_1, "outer"), constant(fast, tau_2, "inner")
    first = State(inner, unit, f"{title} after the inner lag", at_command, closed_by=inner_ahead)
    second = State(outer, unit, f"{title} after the outer lag", at_inner, closed_by=outer_ahead)
    return (
        Effect(f"{u}_drive", f"what drives the {title} channel", drive, constants, (first,)),
        Effect(f"{u}_first_lag", f"inner lag of the {title} channel", first_lag),
        Effect(f"{u}_second_lag", f"outer lag of the {title} channel", second_lag, states=(second,)),
        Effect(f"{u}_reach", f"where the {title} channel ends", reach),
    )


SPEED = channel("omega", "rotor speed", "rpm", 0.172, 0.053)
PITCH = channel("beta", "blade pitch", "deg", 0.207, 0.374)
