"""A bouncing ball: free fall, and at the floor v -> -e v; the instant of each impact is solved for."""

from vpp_fmu import Effect, Model, Parameter, Signal, State


def step(ops, s, x, p, dt):
    impact = ops.sqrt(ops.maximum(x.v**2 + 2.0 * p.g * x.h, 0.0))  # speed at the floor
    after = ops.maximum(dt - (x.v + impact) / p.g, 0.0)  # time since the impact, if there was one
    hit = after > 0.0
    h = ops.where(hit, p.e * impact * after - 0.5 * p.g * after**2, x.h + x.v * dt - 0.5 * p.g * dt**2)
    v = ops.where(hit, p.e * impact - p.g * after, x.v - p.g * dt)
    flies = ops.where(hit & (h <= 0.0), 0.0, 1.0)  # two impacts within a step: it lies
    return {"h": flies * h, "v": flies * v, "bounces": x.bounces + flies * ops.where(hit, 1.0, 0.0)}


BALL = Effect(
    "ball",
    "free fall and impacts",
    step,
    (Parameter("g", "m/s2", 9.81, 0.1, 100.0, "gravity"), Parameter("e", "1", 0.8, 0.0, 1.0, "restitution")),
    (State("h", "m", "height", 1.0), State("v", "m/s", "speed", 0.0), State("bounces", "1", "impacts so far", 0.0)),
    largest_step=0.01,
)
OUTPUTS = Signal("h", "m", "height"), Signal("v", "m/s", "speed"), Signal("bounces", "1", "impacts", kind="Integer")
MODEL = Model("Ball", "A bouncing ball", (), OUTPUTS, (BALL,))
