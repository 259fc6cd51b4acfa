from math import exp

from pythonfmu import Fmi2Causality, Fmi2Slave, Fmi2Variability, Real
from scipy.interpolate import PchipInterpolator

CHARGE, OCV = (0.0, 0.05, 0.1, 0.3, 0.6, 0.9, 1.0), (3.0, 3.35, 3.5, 3.65, 3.8, 4.05, 4.2)


class BatteryTwin(Fmi2Slave):
    """A battery cell, as pythonfmu has it; the target needs scipy."""

    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.i, self.R0, self.R1, self.Q, self.tau, self.charge, self.u = 0.0, 0.02, 0.02, 2.5, 20.0, 0.9, 0.0
        self.ocv = PchipInterpolator(CHARGE, OCV)
        self.voltage = float(self.ocv(self.charge))
        self.register_variable(Real("i", causality=Fmi2Causality.input))
        for name in ("R0", "R1", "Q", "tau"):
            self.register_variable(Real(name, causality=Fmi2Causality.parameter, variability=Fmi2Variability.tunable))
        for name in ("voltage", "charge"):
            self.register_variable(Real(name, causality=Fmi2Causality.output))

    def do_step(self, current_time, step_size):
        self.charge -= self.i * step_size / (3600.0 * self.Q)
        self.u += (1.0 - exp(-step_size / self.tau)) * (self.R1 * self.i - self.u)
        self.voltage = float(self.ocv(min(max(self.charge, 0.0), 1.0))) - self.R0 * self.i - self.u
        return True
