from pythonfmu import Fmi2Causality, Fmi2Slave, Fmi2Variability, Real


class VanDerPolTwin(Fmi2Slave):
    """Van der Pol's oscillator, as pythonfmu has it."""

    largest_step = 0.01

    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.mu, self.force, self.x, self.v = 1.0, 0.0, 2.0, 0.0
        self.register_variable(Real("force", causality=Fmi2Causality.input))
        self.register_variable(Real("mu", causality=Fmi2Causality.parameter, variability=Fmi2Variability.tunable))
        self.register_variable(Real("x", causality=Fmi2Causality.output))
        self.register_variable(Real("v", causality=Fmi2Causality.output))

    def derivative(self, x, v):
        return v, self.mu * (1.0 - x * x) * v - x + self.force

    def do_step(self, current_time, step_size):
        n = max(1, round(step_size / self.largest_step + 0.499999))
        h = step_size / n
        for _ in range(n):
            x, v = self.x, self.v
            a1, b1 = self.derivative(x, v)
            a2, b2 = self.derivative(x + 0.5 * h * a1, v + 0.5 * h * b1)
            a3, b3 = self.derivative(x + 0.5 * h * a2, v + 0.5 * h * b2)
            a4, b4 = self.derivative(x + h * a3, v + h * b3)
            self.x = x + h / 6.0 * (a1 + 2.0 * (a2 + a3) + a4)
            self.v = v + h / 6.0 * (b1 + 2.0 * (b2 + b3) + b4)
        return True
