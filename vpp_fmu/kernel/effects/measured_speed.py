"""The rotor speed is known from its readings: it replaces the speed of the model in a fit of thrust alone.

    omega(t_k + u) = speed_at_row + (speed_at_next_row - speed_at_row) (u - ahead) / (t_(k+1) - t_k)
    ahead = speed_ahead speed_instant_within

A sensor does not tell the instants of its readings exactly: the known speed may lead by a part of `speed_instant_within`.

Not part of a plant: a diagnosis places it behind the speed channel. A speed below 0 is unknown: then the model's is kept.
"""

from vpp_fmu.kernel.types import INSTANT, Effect, Parameter, Signal, State

AHEAD, WITHIN = "speed_ahead", "speed_instant_within"


def _step(ops, s, x, p, dt):
    since = x.since + dt
    row = ops.maximum(s.row_time, INSTANT)
    known = s.speed_at_row + (s.speed_at_next_row - s.speed_at_row) * ops.minimum(since / row, 1.0)
    ahead = ops.where(since - s.row_time > -INSTANT, 0.0, since)
    rate = (s.speed_at_next_row - s.speed_at_row) / row
    known = known - rate * p.speed_ahead * s.speed_instant_within
    unknown, values = s.speed_at_row < 0.0, {"omega": known, "omega_rate": rate, "omega_to_go": s.omega_ref - known}
    return {name: ops.where(unknown, getattr(s, name), value) for name, value in values.items()}, {"since": ahead}


EFFECT = Effect(
    "measured_speed",
    "the rotor speed is known from its readings",
    _step,
    parameters=(
        Parameter(AHEAD, "1", 0.0, -1.0, 1.0, "lead of the known speed, as a share of the uncertainty of its instants"),
    ),
    states=(State("since", "s", "time since the row began", lambda ops, s, p: 0.0),),
    inputs=(
        Signal("speed_at_row", "rpm", "rotor speed at the row's time", -1.0, 2e5, 6000.0, start=-1.0),
        Signal("speed_at_next_row", "rpm", "rotor speed at the next row's time", -1.0, 2e5, 6000.0, start=-1.0),
        Signal(WITHIN, "s", "uncertainty of the instants of the speed readings", 0.0, 1e4, 0.01),
        Signal("row_time", "s", "time from the row to the next", 0.0, 1e4, 0.01, clock=True),
    ),
)
