"""The Python FMU's slave: a traced model under pythonfmu's calls.

An export is one file: schedule.py, this text, the generated functions and a class that names them (`vpp_fmu.export`). It
travels alone, so it may import nothing but the standard library and pythonfmu, which travels with it; the one import of
this project below is dropped on the way, since schedule.py then stands in the same file.

All values live in one list `v`, in the order of the value references: inputs, outputs, parameters, states.
"""

from math import inf, isfinite

from pythonfmu.fmi2slave import Fmi2Slave

from vpp_fmu.kernel.schedule import DelayLine, run_held, run_sampled


class Refused(ValueError):
    """A call that can't be carried out. pythonfmu logs the repr, so that is the message."""

    def __repr__(self):
        return str(self)


class TracedSlave(Fmi2Slave):
    """One instance of a traced model. A generated subclass brings what is declared here, and a way to step from below."""

    NAME = ""
    VARIABLES = ()  # name of each value
    START = ()  # each value at instantiation
    RANGES = ()  # (minimum, maximum, unit) of each parameter
    N_INPUTS = N_OUTPUTS = N_PARAMETERS = 0
    DELAYS = ()  # (position of the input, position of its delay)
    SAMPLE_TIME = None  # position of the period of a sampled model
    start = prepare = step = largest_step = None  # as vpp_fmu.tracer.emit.python_source says

    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.modelName = self.NAME
        self.v = list(self.START)
        self.first_parameter = self.N_INPUTS + self.N_OUTPUTS
        self.first_state = self.first_parameter + self.N_PARAMETERS
        self.initialised = self.settled = False
        self.prepared_for = self.constants = None
        self.lines, self.largest, self.wait = [], inf, 0.0

    def set_real(self, vrs, values):
        v, n = self.v, self.N_INPUTS
        for vr, value in zip(vrs, values, strict=True):
            if vr >= n:
                self._set_parameter(vr, value)
            elif value - value == 0.0:  # finite, without the price of a call
                v[vr] = value
            else:
                raise Refused(f"{self.NAME}: {self.VARIABLES[vr]} can't be set to {value}, a finite number is needed")
        self.settled = False

    def get_real(self, vrs):
        if not (self.initialised or self.settled):
            self._settle()
        v = self.v
        try:
            return [v[vr] for vr in vrs]
        except IndexError:
            raise self._unknown(max(vrs)) from None

    def exit_initialization_mode(self):
        """Start at rest on the inputs that stand now."""
        for i, (low, high, unit) in enumerate(self.RANGES, self.first_parameter):
            if not low <= self.v[i] <= high:
                raise Refused(f"{self.NAME}: {self.VARIABLES[i]} is {self.v[i]} {unit}, allowed is {low} to {high} {unit}")
        self._settle()
        self._schedule()
        self.initialised = True

    def _settle(self):
        self.start(self.v, None)
        self.settled = True

    def _schedule(self):
        """What a way to step derives from the parameters before its first step."""

    def _prepare(self, dt):
        self.prepared_for, self.constants = dt, self.prepare(self.v, dt, ())

    def _check_step(self, step_size):
        if not (step_size > 0.0 and isfinite(step_size)):
            raise Refused(f"{self.NAME}: communication step is {step_size} s, a positive number is needed")

    def _set_parameter(self, vr, value):
        if vr >= len(self.v):
            raise self._unknown(vr)
        name = self.VARIABLES[vr]
        if not self.first_parameter <= vr < self.first_state:
            raise Refused(f"{self.NAME}: {name} is computed, it can't be set")
        if self.initialised:
            raise Refused(f"{self.NAME}: {name} is fixed, it can't be set after initialisation")
        if not isfinite(value):
            raise Refused(f"{self.NAME}: {name} can't be set to {value}, a finite number is needed")
        self.v[vr] = value

    def _unknown(self, vr):
        return Refused(f"{self.NAME}: value reference {vr} is unknown, allowed is 0 to {len(self.v) - 1}")

    def _get_fmu_state(self):
        lines = [None if line is None else dict(vars(line), waits=[*line.waits], values=[*line.values]) for line in self.lines]
        return {"v": [*self.v], "lines": lines, "wait": self.wait, "initialised": self.initialised}

    def _set_fmu_state(self, state):
        self.v[:] = state["v"]
        self.wait, self.initialised, self.settled = state["wait"], state["initialised"], False
        self.prepared_for = None
        if self.initialised:
            self._schedule()
            for line, kept in zip(self.lines, state["lines"], strict=True):
                if line is not None:
                    vars(line).update(kept, waits=[*kept["waits"]], values=[*kept["values"]])


class Exact:
    """Steps of a model that is exact for held inputs: one step of the chain is one communication step."""

    def do_step(self, current_time, step_size):
        if step_size != self.prepared_for:
            self._check_step(step_size)
            self._prepare(step_size)
        self.step(self.v, self.constants, None)
        return True


class Scheduled:
    """Steps of a model with delays, or with a largest step."""

    def _schedule(self):
        self.lines = [None] * self.N_INPUTS
        for i, _ in self.DELAYS:
            self.lines[i] = DelayLine(self.v[i])
        self.delays = [None] * self.N_INPUTS
        for i, delay in self.DELAYS:
            self.delays[i] = self.v[delay]
        self.largest = self.largest_step(self.v)

    def do_step(self, current_time, step_size):
        self._check_step(step_size)
        n = self.N_INPUTS
        held = self.v[:n]
        run_held(self.lines, self.delays, held, step_size, self.largest, self._piece)
        self.v[:n] = held
        return True

    def _piece(self, acting, dt):
        if dt != self.prepared_for:
            self._prepare(dt)
        self.v[: self.N_INPUTS] = acting
        self.step(self.v, self.constants, None)


class Sampled:
    """Steps of a sampled law: it runs when a sample is due, whatever the communication step."""

    def _schedule(self):
        self._prepare(self.v[self.SAMPLE_TIME])

    def do_step(self, current_time, step_size):
        self._check_step(step_size)
        self.wait = run_sampled(self.wait, self.prepared_for, step_size, self._sample)
        return True

    def _sample(self, period):
        self.step(self.v, self.constants, None)
