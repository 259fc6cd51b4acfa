"""The base plant as a slave written by hand: the reference for the generated one."""

from math import exp

from pythonfmu import Fmi2Causality, Fmi2Slave, Fmi2Variability, Real


class FlatPlant(Fmi2Slave):
    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.omega_ref = self.beta_ref = self.thrust = self.omega = self.beta = 0.0
        self.inner_omega = self.inner_beta = 0.0
        self.h = None
        for name in ("omega_ref", "beta_ref"):
            self.register_variable(Real(name, causality=Fmi2Causality.input, variability=Fmi2Variability.continuous))
        for name in ("thrust", "omega", "beta"):
            self.register_variable(Real(name, causality=Fmi2Causality.output, variability=Fmi2Variability.continuous))

    def do_step(self, current_time, step_size):
        if step_size != self.h:
            self.h = step_size
            self.e = [exp(-step_size / tau) for tau in (0.053, 0.172, 0.374, 0.207)]
        a, b, c, d = self.e
        self.inner_omega = self.omega_ref + a * (self.inner_omega - self.omega_ref)
        self.omega = self.inner_omega + b * (self.omega - self.inner_omega)
        self.inner_beta = self.beta_ref + c * (self.inner_beta - self.beta_ref)
        self.beta = self.inner_beta + d * (self.beta - self.inner_beta)
        w, p = self.omega / 6000.0, (self.beta + 5.0) / 15.0
        self.thrust = 15.0 * (0.355 * w * w + 0.064 * w * p + 0.8 * w * w * p - 0.16 * w * p * p - 0.081 * w * w * w)
        return True
