from pythonfmu import Fmi2Causality, Fmi2Slave, Fmi2Variability, Real

PARAMETERS = {"L": 0.01, "R": 1.0, "K": 0.1, "J": 0.001, "b": 0.001, "kp": 0.5, "ki": 5.0}


class MotorPITwin(Fmi2Slave):
    """A motor under a PI law, as pythonfmu has it: its states by Runge-Kutta's method."""

    largest_step = 0.001

    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.wanted, self.load, self.i, self.w, self.e = 0.0, 0.0, 0.0, 0.0, 0.0
        for name, value in PARAMETERS.items():
            setattr(self, name, value)
            self.register_variable(Real(name, causality=Fmi2Causality.parameter, variability=Fmi2Variability.tunable))
        for name in ("wanted", "load"):
            self.register_variable(Real(name, causality=Fmi2Causality.input))
        self.register_variable(Real("w", causality=Fmi2Causality.output))

    def derivative(self, i, w, total):
        e = self.wanted - w
        u = self.kp * e + self.ki * total
        return (u - self.R * i - self.K * w) / self.L, (self.K * i - self.b * w - self.load) / self.J, e

    def do_step(self, current_time, step_size):
        n = max(1, round(step_size / self.largest_step + 0.499999))
        h = step_size / n
        for _ in range(n):
            y = (self.i, self.w, self.e)
            k1 = self.derivative(*y)
            k2 = self.derivative(*(a + 0.5 * h * k for a, k in zip(y, k1, strict=False)))
            k3 = self.derivative(*(a + 0.5 * h * k for a, k in zip(y, k2, strict=False)))
            k4 = self.derivative(*(a + h * k for a, k in zip(y, k3, strict=False)))
            moved = (a + h / 6.0 * (p + 2.0 * (q + r) + s) for a, p, q, r, s in zip(y, k1, k2, k3, k4, strict=False))
            self.i, self.w, self.e = moved
        return True
