"""A model as a class with `do_step`, the form of pythonfmu: its attributes are the variables.

    class Heater(Slave):
        "A body that is heated: C dT/dt = power - k (T - 20)."

        inputs = (Signal("power", "W", "of the heater"),)
        outputs = (Signal("T", "degC", "temperature", start=20.0),)
        parameters = (Parameter("C", "J/K", 500.0, 1.0, 1e6, "heat capacity"), Parameter("k", "W/K", 2.0, 0.0, 1e3, "loss"))
        largest_step = 1.0

        def do_step(self, ops, dt):
            self.T = self.T + dt / self.C * (self.power - self.k * (self.T - 20.0))

Outputs and `states` keep their values from step to step, and begin at their start values. As in every effect, `do_step` is run
once on symbols: `ops` has what to write in place of `if` and `math`.
"""

from collections.abc import Mapping
from inspect import signature
from types import MappingProxyType
from typing import Any

from vpp_fmu.kernel.types import Effect, Model, State


class Slave:
    """Base of such a class; `model()` is what is exported. `about`: further fields of its Model, such as its author.

    >>> class Counter(vpp.Slave):
    ...     "Counts its steps."
    ...     outputs = (vpp.Signal("count", "1", "steps so far"),)
    ...     largest_step = 0.1
    ...     def do_step(self, ops, dt):
    ...         self.count = self.count + 1.0
    >>> Counter.model().name
    'Counter'
    """

    inputs: tuple = ()
    outputs: tuple = ()
    parameters: tuple = ()
    states: tuple = ()
    largest_step: float | None = None
    sample_time: str | None = None
    about: Mapping[str, Any] = MappingProxyType({})

    def do_step(self, ops: Any, dt: Any) -> None:
        """Change outputs and states to their values after dt s."""
        raise NotImplementedError

    @classmethod
    def model(cls) -> Model:
        """The class as a Model of one effect."""
        shown = tuple(State(y.name, y.unit, y.description, y.start, nominal=y.nominal, size=y.size) for y in cls.outputs)
        states, description = (*cls.states, *shown), " ".join((cls.__doc__ or cls.__name__).split())
        moving = {x.name for x in states}

        def step(ops, s, x, p, dt):
            given = {**{u.name: getattr(s, u.name) for u in cls.inputs}, **vars(x), **vars(p)}
            slave = cls.__new__(cls)
            vars(slave).update(given)
            slave.do_step(ops, dt)
            for name, value in vars(slave).items():
                if name not in moving and given.get(name, slave) is not value:
                    raise AttributeError(
                        f"self.{name} set by do_step; it may set outputs and states: {', '.join(sorted(moving))}"
                    )
            return {name: getattr(slave, name) for name in moving}

        vars(step).update(__signature__=signature(step), __wrapped__=cls.do_step)  # its file's text documents it
        name = f"{cls.__name__.lower()}_step"
        effect = Effect(name, description, step, cls.parameters, states, largest_step=cls.largest_step)
        return Model(cls.__name__, description, cls.inputs, cls.outputs, (effect,), sample_time=cls.sample_time, **cls.about)
