"""A logger writes rows of earlier readings: thrust and speed of a row are those of `age` rows earlier.

    reading(t_k) = signal(t_j - share (t_j - t_(j-1))),   age = (k - j) + share

A logger that reads, waits for its frames and then stamps the row is late by a share of a row. One that writes the readings of
the cycle before is late by one row and more. With rows of equal length this equals a dead time of all readings or, if only one
command moves, of that command. Rows of unequal length distinguish it from both, two commanded channels from a delayed motor.

`row_time` is the row's length, which a simulation of a record sets; without it, as in a co-simulation, nothing is delayed.
The reading is held between the ends of rows. Signals are linear over a step.
"""

from vpp_fmu.kernel.types import INSTANT, Effect, Parameter, Signal, State

OLDEST = 3
"""Maximum age of a reading, in rows."""

READINGS = {"thrust": "N", "omega": "rpm"}


def _step(ops, s, x, p, dt):
    logged = ops.where(p.age > 0.0, s.row_time, 0.0) > 0.0
    over = x.since + dt - s.row_time
    ends = over > -INSTANT
    since = ops.where(ends, ops.clip(over, 0.0, s.row_time), x.since + dt)
    whole = sum(ops.where(p.age > float(k), 1.0, 0.0) for k in range(1, OLDEST))
    ahead_of_reading = (1.0 - (p.age - whole)) * s.row_time - x.since
    reads = ops.where(ahead_of_reading > -INSTANT, dt + INSTANT - ahead_of_reading, 0.0) > 0.0
    signals, ahead = {}, {"since": since}
    for name in READINGS:
        now, before = getattr(s, name), getattr(x, f"{name}_before")
        read = now - (dt - ahead_of_reading) * ((now - before) / dt)
        rows = [ops.where(reads, read, getattr(x, f"{name}_0")), *(getattr(x, f"{name}_{k}") for k in range(1, OLDEST))]
        value = rows[0]
        for k in range(1, OLDEST):
            value = ops.where(whole > k - 0.5, rows[k], value)
        shown = ops.where(ends, value, getattr(x, f"{name}_shown"))
        signals[name] = ops.where(logged, shown, now)
        ahead |= {f"{name}_before": now, f"{name}_shown": ops.where(logged, shown, now), f"{name}_0": rows[0]}
        ahead |= {f"{name}_{k}": ops.where(ends, rows[k - 1], rows[k]) for k in range(1, OLDEST)}
    return signals, ahead


def _states(name: str, unit: str) -> tuple[State, ...]:
    def settled(ops, s, p):
        return getattr(s, name)

    return (
        State(f"{name}_before", unit, f"{name} at the start of the step", settled),
        State(f"{name}_shown", unit, f"{name} as the last row has it", settled),
        *(State(f"{name}_{k}", unit, f"{name} as it was last read, {k} rows' ends ago", settled) for k in range(OLDEST)),
    )


EFFECT = Effect(
    "row_clock",
    "rows of the log hold what was read before",
    _step,
    parameters=(Parameter("age", "1", 0.0, 0.0, float(OLDEST), "rows by which thrust and speed are older than their row"),),
    states=(
        State("since", "s", "time since the row began", lambda ops, s, p: 0.0),
        *(x for name, unit in READINGS.items() for x in _states(name, unit)),
    ),
    off={"age": 0.0},
    probe={"age": 0.6},
    inputs=(Signal("row_time", "s", "time from the row to the next", 0.0, 1e4, 0.01, clock=True),),
    largest_step=0.001,
    reading="thrust and speed",
    says="rows of the log hold readings that are {age} rows old",
)
