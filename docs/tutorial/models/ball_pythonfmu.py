from math import sqrt

from pythonfmu import Fmi2Causality, Fmi2Slave, Fmi2Variability, Integer, Real


class BallTwin(Fmi2Slave):
    """A bouncing ball, as pythonfmu has it."""

    largest_step = 0.01

    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.g, self.e, self.h, self.v, self.bounces = 9.81, 0.8, 1.0, 0.0, 0
        for name in ("g", "e"):
            self.register_variable(Real(name, causality=Fmi2Causality.parameter, variability=Fmi2Variability.tunable))
        for name in ("h", "v"):
            self.register_variable(Real(name, causality=Fmi2Causality.output))
        self.register_variable(Integer("bounces", causality=Fmi2Causality.output, variability=Fmi2Variability.discrete))

    def do_step(self, current_time, step_size):
        n = max(1, round(step_size / self.largest_step + 0.499999))
        dt = step_size / n
        for _ in range(n):
            impact = sqrt(max(self.v**2 + 2.0 * self.g * self.h, 0.0))
            after = dt - (self.v + impact) / self.g
            if after > 0.0:
                self.h = self.e * impact * after - 0.5 * self.g * after**2
                self.v = self.e * impact - self.g * after
                if self.h <= 0.0:
                    self.h = self.v = 0.0
                else:
                    self.bounces += 1
            else:
                self.h += self.v * dt - 0.5 * self.g * dt**2
                self.v -= self.g * dt
        return True
