"""One of a channel's two lags within a step, for effects that modify it.

An effect that may act in either lag comes after both, gets the one of its `form` from `stage`, and replaces the distance that
the lag covers. `with_distance` passes a changed move of the inner lag to the outer one. Distances and time constants include
earlier effects, so that several can modify one lag.
"""

from typing import Any, NamedTuple

from vpp_fmu.kernel.types import Parameter

INNER, OUTER = 1.0, 2.0
WHICH_LAG = Parameter("form", "1", INNER, INNER, OUTER, "lag in which it acts: 1 inner, 2 outer", choices=(INNER, OUTER))


class Stage(NamedTuple):
    """A lag in one step, in the channel's unit and s."""

    value: Any  # value at the start
    tau: Any  # time constant with which it relaxes in this step
    before: Any  # input less value at the start
    after: Any  # input at the end less value at the start
    distance: Any  # change in the step


class OneOf(NamedTuple):
    """A time constant that is one of two constants, so that derived values need not be computed at every step."""

    condition: Any
    yes: Any
    no: Any


def _constants(s, u: str) -> tuple[Any, Any]:
    """(inner, outer) time constants in this step: those of the channel, or as changed by an effect."""
    return getattr(s, f"{u}_inner_tau", getattr(s, f"tau_{u}_2")), getattr(s, f"{u}_outer_tau", getattr(s, f"tau_{u}_1"))


def stage(ops, s, u: str, form) -> Stage:
    """The lag of channel `u` ("omega" or "beta") that `form` names."""
    inner, outer, error, move = (getattr(s, f"{u}_{part}") for part in ("inner", "outer", "error", "move"))

    def pick(first, second):
        return ops.where(form < 1.5, first, second)

    return Stage(
        value=pick(inner, outer),
        tau=pick(*_constants(s, u)),
        before=pick(error, inner - outer),
        after=pick(error, inner - outer + move),
        distance=pick(move, getattr(s, f"{u}_travel")),
    )


def with_distance(ops, s, u: str, form, distance, dt, tau=None) -> dict[str, Any]:
    """The channel's signals if the lag of `form` covers `distance`, and relaxes with `tau`: a constant, `OneOf` two, or None:
    unchanged."""
    (inner, outer), move, travel = _constants(s, u), getattr(s, f"{u}_move"), getattr(s, f"{u}_travel")

    def carried(constant):  # the outer lag's share of the inner one's change
        return ops.two_lag_step(getattr(s, f"tau_{u}_1"), constant, dt) / ops.gain(constant, dt)

    if isinstance(tau, OneOf):
        share, tau = ops.where(tau.condition, carried(tau.yes), carried(tau.no)), ops.where(*tau)
    else:
        share = carried(inner if tau is None else tau)
    more = share * distance - carried(inner) * move
    signals = {
        f"{u}_move": ops.where(form < 1.5, distance, move),
        f"{u}_travel": ops.where(form < 1.5, travel + more, distance),
    }
    if tau is not None:
        signals[f"{u}_inner_tau"] = ops.where(form < 1.5, tau, inner)
        signals[f"{u}_outer_tau"] = ops.where(form < 1.5, outer, tau)
    return signals
