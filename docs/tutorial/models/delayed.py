"""A PI law that runs every 50 ms on a reading that is 120 ms old, and the heater that it drives: tau dT/dt = gain u - T."""

from vpp_fmu import Effect, Model, Parameter, Signal, State


def law(ops, s, x, p, dt):
    e = s.wanted - s.reading
    total = x.total + p.ki * p.period * e
    return {"total": total, "u": ops.clip(p.kp * e + total, 0.0, 1.0)}


def heater(ops, s, x, p, dt):
    return {"T": ops.lag(x.T, p.gain * s.u, p.tau, dt)}


SECONDS = Parameter("period", "s", 0.05, 1e-3, 1.0, "of the law"), Parameter("delay", "s", 0.12, 0.0, 1.0, "of the reading")
GAINS = Parameter("kp", "1/K", 0.05, 0.0, 10.0, "gain"), Parameter("ki", "1/K/s", 0.1, 0.0, 10.0, "gain of the integral")
STATES = State("total", "1", "integral", 0.0), State("u", "1", "command", 0.0)
LAW = Effect("law", "a PI law", law, (*SECONDS, *GAINS), STATES, delays={"reading": "delay"}, sample_time="period")
BODY = Parameter("tau", "s", 2.0, 0.1, 1e3, "time constant"), Parameter("gain", "K", 80.0, 0.0, 1e3, "at full power")
HEATER = Effect("heater", "a heater", heater, BODY, (State("T", "K", "above ambient", 0.0),))
INPUTS = Signal("wanted", "K", "wanted temperature", nominal=40.0), Signal("reading", "K", "of the sensor", nominal=40.0)
OUTPUTS = Signal("u", "1", "command"), Signal("T", "K", "temperature above ambient", nominal=40.0)
MODEL = Model("Delayed", "A sampled law with a delay", INPUTS, OUTPUTS, (LAW, HEATER))
