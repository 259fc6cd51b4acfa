"""A learned term as an effect.

    term = times * shape(driver through its lag),   port <- port + term, or port * (1 + term)

The factor of a rate is at least 0.

`placed` puts it at its port in a library.
"""

from collections.abc import Mapping

from vpp_fmu.kernel.effects.stage import WHICH_LAG
from vpp_fmu.kernel.learned.drivers import DRIVERS
from vpp_fmu.kernel.learned.ports import PORTS
from vpp_fmu.kernel.learned.shapes import LAWS, SHAPES, Sizes
from vpp_fmu.kernel.scales import PAPER, Scales
from vpp_fmu.kernel.types import Effect, Parameter, State

LAGS = (0.002, 300.0)
"""Range of the lag between driver and term, s; smaller ones count as none."""

TIMES = {"": "", "speed_squared": "the square of speed, 1 at full speed"}
"""Possible factors of a term."""


def learned(
    name: str,
    port: str,
    driver: str,
    shape: str,
    values: Mapping[str, float],
    span: tuple[float, float],
    lag: float | None = None,
    times: str = "",
    form: float = 2.0,
    scales: Scales = PAPER,
) -> Effect:
    """The effect of a term. KeyError names an unknown port, driver or shape.

    `values`: of the shape's parameters, a plausible size; `span`: the range of the driver in which it was learned; `lag` [s]:
    None for none. `times`: of TIMES; behind the rotor only. `form`: the lag of the channel that a rate's port changes, 1 inner,
    2 outer. `scales`: of the rig, for the bounds.
    """
    place, cause, look = PORTS[port], DRIVERS[driver], SHAPES[shape]
    sizes = Sizes(place.unit, cause.unit, place.limit * scales.absolute(1.0, place.scale), *span)
    lagged = () if lag is None else (Parameter("lag", "s", lag, *LAGS, f"lag behind {cause.words}", nominal=lag),)
    staged = (WHICH_LAG,) if place.staged else ()
    parameters = (*look.declared(sizes, values), *lagged, *staged)

    def start(ops, s, p):
        return cause.settled(s, p, place)

    def step(ops, s, x, p, dt):
        before, after, moved = cause.course(ops, s, x, p, dt, place) if look.driven else (0.0, 0.0, {})
        if lag is not None:
            last = x.lagged
            before, after = last, ops.lag_ramp(last, before, after, p.lag, dt)
            moved["lagged"] = after
        if lag is None and not place.whole and not cause.known(place):
            after = before  # in a loop without a lag the extrapolation would oscillate
        at = 0.5 * (before + after) if place.whole else after
        at = ops.clip(at, *span) if shape in LAWS else at  # like a curve, constant beyond the learned range
        f, memory = look.value(ops, x, p, at, dt)
        if times:
            w = s.omega / s.omega_scale
            f = f * w * w
        return place.adds(ops, s, p, f, dt), {**moved, **memory}

    memory = tuple(
        State(n, unit or cause.unit, text, lambda ops, s, p, first=first: first(ops, p, start(ops, s, p)))
        for n, (unit, text, first) in look.memory.items()
    )
    follows = (State("lagged", cause.unit, f"{cause.words} through the lag", start),) if lag is not None else ()
    off = look.off(values)
    probe = {p.name: float(values[p.name]) for p in parameters if p.name in values}
    probe |= {} if lag is None else {"lag": lag}
    probe |= {"form": form} if place.staged else {}
    return Effect(
        name,
        f"learned: {place.words}, driven by {cause.words}",
        step,
        parameters=parameters,
        states=(*(cause.states(place) if look.driven else ()), *follows, *memory),
        off=dict.fromkeys(off, 0.0),
        probe=probe,
        largest_step=0.002,
        channels=(place.channel,) if place.channel else (),
        reading=place.reading,
        ahead=cause.ahead(place),
    )
