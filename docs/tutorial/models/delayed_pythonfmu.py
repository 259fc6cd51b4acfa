from collections import deque
from math import exp

from pythonfmu import Fmi2Causality, Fmi2Slave, Fmi2Variability, Real

VALUES = {"period": 0.05, "delay": 0.12, "kp": 0.05, "ki": 0.1, "tau": 2.0, "gain": 80.0}


class DelayedTwin(Fmi2Slave):
    """A sampled law with a delay, as pythonfmu has it."""

    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.wanted, self.reading, self.u, self.T, self.total, self.wait, self.acting = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        self.time, self.changes, self.latest = 0.0, deque(), 0.0
        for name, value in VALUES.items():
            setattr(self, name, value)
            self.register_variable(Real(name, causality=Fmi2Causality.parameter, variability=Fmi2Variability.tunable))
        for name in ("wanted", "reading"):
            self.register_variable(Real(name, causality=Fmi2Causality.input))
        for name in ("u", "T"):
            self.register_variable(Real(name, causality=Fmi2Causality.output))

    def do_step(self, current_time, step_size):
        if self.reading != self.latest:
            self.changes.append((self.time + self.delay, self.reading))
            self.latest = self.reading
        left = step_size
        while left > 1e-9:
            while self.changes and self.changes[0][0] <= self.time + 1e-9:
                self.acting = self.changes.popleft()[1]
            if self.wait <= 1e-9:
                e = self.wanted - self.acting
                self.total += self.ki * self.period * e
                self.u = min(max(self.kp * e + self.total, 0.0), 1.0)
                self.wait = self.period
            piece = min(left, self.wait, *(at - self.time for at, _ in list(self.changes)[:1]))
            self.T += (1.0 - exp(-piece / self.tau)) * (self.gain * self.u - self.T)
            self.time, self.wait, left = self.time + piece, self.wait - piece, left - piece
        return True
