"""Run a model's functions in Python: the reference for generated code."""

from collections.abc import Mapping

from vpp_fmu.kernel.ops import NUMBERS
from vpp_fmu.kernel.schedule import DelayLine, next_sample, run_held, run_sampled
from vpp_fmu.kernel.types import Model, largest_step, show, start, step


class Simulation:
    """A model with its parameter values, its states and its place in the schedule.

    `parameters`: changes to the defaults, by full name (KeyError names an unknown one).
    """

    def __init__(self, model: Model, parameters: Mapping[str, float] | None = None):
        self.model = model
        self.parameters = model.values(parameters)
        self._names = tuple(s.name for s in model.inputs)
        self._delays = [None] * len(self._names)
        for name, parameter in model.delays:
            self._delays[self._names.index(name)] = self.parameters[parameter]
        self._largest = largest_step(model, NUMBERS, self.parameters)
        self.start({s.name: s.start for s in model.inputs})

    def start(self, inputs: Mapping[str, float], states: Mapping[str, float] | None = None) -> dict[str, float]:
        """Settle on `inputs`, by name; measured ones may be missing. Returns the outputs.

        `states`: initial values that replace settled ones, by full name; the outputs are then those at these states.
        """
        self.inputs = self._complete(inputs)
        self._lines = [
            None if delay is None else DelayLine(u) for delay, u in zip(self._delays, self.inputs.values(), strict=True)
        ]
        self._wait = 0.0
        if self.model.black_box is not None:
            self.signals, self.states, self._memory = {y.name: y.start for y in self.model.outputs}, {}, {}
            return self.outputs
        self.signals, self.states = start(self.model, NUMBERS, self.inputs, self.parameters)
        if states:
            self.states |= states
            if self.model.sample_time is None:
                self.signals = show(self.model, NUMBERS, self.inputs, self.states, self.parameters)
        return self.outputs

    def advance(self, inputs: Mapping[str, float], dt: float) -> dict[str, float]:
        """Hold `inputs` for one communication step of dt seconds; returns the outputs at its end."""
        self.inputs = self._complete(inputs)
        values = list(self.inputs.values())
        if self.model.black_box is not None:
            self.signals = self.model.black_box(self._memory, {**self.inputs, **self.parameters}, dt)
        elif self.model.sample_time is None:
            run_held(self._lines, self._delays, values, dt, self._largest, self._step, due=self._due)
        else:
            period = self.parameters[self.model.sample_time]
            self._wait = run_sampled(self._wait, period, dt, lambda period: self._step(values, period))
        return self.outputs

    @property
    def outputs(self) -> dict[str, float]:
        return {s.name: self.signals[s.name] for s in self.model.outputs}

    def _due(self) -> list[float]:
        return [next_sample(self.states[wait], self.parameters[period]) for wait, period in self.model.sampled]

    def _complete(self, inputs: Mapping[str, float]) -> dict[str, float]:
        given = self.model.measured_inputs | dict(inputs)
        return {name: float(given[name]) for name in self._names}

    def _step(self, values: list[float], dt: float) -> None:
        inputs = dict(zip(self._names, values, strict=True))
        self.signals, self.states = step(self.model, NUMBERS, inputs, self.states, self.parameters, dt)
