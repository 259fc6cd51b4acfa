from pythonfmu import Fmi2Causality, Fmi2Slave, Fmi2Variability, Real

N = 10


class RodTwin(Fmi2Slave):
    """A rod of ten thermal nodes, as pythonfmu has it: it knows no vectors."""

    largest_step = 0.25

    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.hot, self.cold, self.G, self.C, self.T = 20.0, 20.0, 2.0, 10.0, [20.0] * N
        for name in ("hot", "cold"):
            self.register_variable(Real(name, causality=Fmi2Causality.input))
        for name in ("G", "C"):
            self.register_variable(Real(name, causality=Fmi2Causality.parameter, variability=Fmi2Variability.tunable))
        for k in range(N):
            output = {"causality": Fmi2Causality.output, "getter": lambda k=k: self.T[k]}
            self.register_variable(Real(f"T[{k + 1}]", **output))

    def derivative(self, nodes):
        T, g = [self.hot, *nodes, self.cold], self.G / self.C
        return [g * (T[k - 1] - 2.0 * T[k] + T[k + 1]) for k in range(1, N + 1)]

    def do_step(self, current_time, step_size):
        n = max(1, round(step_size / self.largest_step + 0.499999))
        h = step_size / n
        for _ in range(n):
            T = self.T
            k1 = self.derivative(T)
            k2 = self.derivative([a + 0.5 * h * k for a, k in zip(T, k1, strict=False)])
            k3 = self.derivative([a + 0.5 * h * k for a, k in zip(T, k2, strict=False)])
            k4 = self.derivative([a + h * k for a, k in zip(T, k3, strict=False)])
            self.T = [a + h / 6.0 * (p + 2.0 * (q + r) + s) for a, p, q, r, s in zip(T, k1, k2, k3, k4, strict=False)]
        return True
