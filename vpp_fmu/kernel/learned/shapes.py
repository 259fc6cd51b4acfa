"""Shapes of a term over its driver v: f(v), with or without states.

    curve       straight between knots, flat beyond the first and the last
    line        gain v
    square      gain v |v|
    hinge       gain max(side (v - knee), 0)
    threshold   gain where v > level
    saturation  gain clip(v, -limit, limit)
    sign        gain tanh(v / width)
    play        gain (driven - v),   driven <- clip(driven, v - half_gap, v + half_gap)
    hold        gain (held - v),     held <- v where |v - held| > half_width
    relay       gain from v > upper on until v < lower
    sine        in_phase sin(2 pi frequency t) + quadrature cos(2 pi frequency t), t since the record's start

A sine needs no driver.
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from itertools import pairwise

from vpp_fmu.kernel.types import Parameter

TURN = 6.283185307179586


@dataclass(frozen=True)
class Sizes:
    """Data for the declaration of a shape's parameters: units of term and driver, the largest term, the driver's range."""

    unit: str
    driver_unit: str
    limit: float
    low: float
    high: float

    @property
    def span(self) -> float:
        """Width of the driver's range."""
        return self.high - self.low

    def gain(self, name: str, text: str, power: int = 0) -> Parameter:
        """A parameter for the size of the term, per power of the driver."""
        unit, limit = self.unit, self.limit
        for _ in range(power):
            unit, limit = _per(unit, self.driver_unit), 3.0 * limit / self.span
        return Parameter(name, unit, 0.0, -limit, limit, text, nominal=0.1 * limit)

    def level(self, name: str, at: float, text: str) -> Parameter:
        """A parameter that is a value of the driver."""
        return Parameter(name, self.driver_unit, at, self.low, self.high, text, nominal=0.1 * self.span)

    def width(self, name: str, at: float, text: str, share: float = 0.5) -> Parameter:
        """A parameter that is a distance along the driver."""
        return Parameter(name, self.driver_unit, at, 1e-4 * self.span, share * self.span, text, nominal=0.1 * self.span)


def _per(unit: str, other: str) -> str:
    """A unit divided by another: "deg/s" per "rpm/s" is "deg.s/s/rpm"."""
    (above, *below), (over, *under) = unit.split("/"), other.split("/")
    factors = [symbol for symbol in (above, *under) if symbol != "1"] or ["1"]
    return "/".join([".".join(factors), *below, over])


@dataclass(frozen=True)
class Shape:
    """A shape. `equation`: f over the driver v; `declared(sizes, values)`: its parameters, at `values`; `value(ops, x, p, v,
    dt)`: (f, its next states).

    `off(values)`: the parameters that switch it off at 0; `memory`: its states by name, each (unit, "" for the driver's; what
    it is; its start from the settled driver: start(ops, p, v)). `driven`: it has a driver; else it depends
    on time only.
    """

    name: str
    equation: str
    declared: Callable[[Sizes, Mapping[str, float]], tuple[Parameter, ...]]
    value: Callable
    off: Callable[[Mapping[str, float]], tuple[str, ...]] = lambda values: ("gain",)
    memory: Mapping[str, tuple[str, str, Callable]] = field(default_factory=dict)
    driven: bool = True


def knots(names: Iterable[str]) -> int:
    """Number of knots of a curve with parameters of these names."""
    return sum(name.startswith("at_") for name in names)


def _curve_declared(sizes, values):
    at = [values[f"at_{k + 1}"] for k in range(knots(values))]
    # A knot may move a third of the way to its neighbours: they can't meet.
    gaps = [b - a for a, b in pairwise(at)]
    below, above = [gaps[0], *gaps], [*gaps, gaps[-1]]
    places = (
        Parameter(
            f"at_{k + 1}",
            sizes.driver_unit,
            v,
            v - below[k] / 3.0,
            v + above[k] / 3.0,
            f"knot {k + 1} of the curve",
            nominal=above[k],
            choices=(v,),
        )
        for k, v in enumerate(at)
    )
    return (*places, *(sizes.gain(f"value_{k + 1}", f"the curve at its knot {k + 1}") for k in range(len(at))))


def _curve(ops, x, p, v, dt):
    count = knots(vars(p))
    at, value = ([getattr(p, f"{part}_{k + 1}") for k in range(count)] for part in ("at", "value"))
    f = value[0]
    for k in range(count - 1):
        gap = at[k + 1] - at[k]
        f = f + (value[k + 1] - value[k]) * (ops.clip(v - at[k], 0.0, gap) / gap)
    return f, {}


def _play(ops, x, p, v, dt):
    driven = ops.clip(x.driven, v - p.half_gap, v + p.half_gap)
    return p.gain * (driven - v), {"driven": driven}


def _hold(ops, x, p, v, dt):
    held = ops.where(ops.abs(v - x.held) > p.half_width, v, x.held)
    return p.gain * (held - v), {"held": held}


def _relay(ops, x, p, v, dt):
    on = ops.where(v > p.upper, 1.0, ops.where(v < p.lower, 0.0, x.on))
    return p.gain * on, {"on": on}


def _sine(ops, x, p, v, dt):
    turn = TURN * p.frequency * dt
    c, s = ops.cos(turn), ops.sin(turn)
    sine, cosine = x.sine * c + x.cosine * s, x.cosine * c - x.sine * s
    return p.in_phase * sine + p.quadrature * cosine, {"sine": sine, "cosine": cosine}


def _line_declared(z, v):
    return (z.gain("gain", "term per driver", 1),)


def _square_declared(z, v):
    return (z.gain("gain", "term per driver's square", 2),)


def _hinge_declared(z, v):
    side = Parameter("side", "1", 1.0, -1.0, 1.0, "1: acts above the knee; -1: below", choices=(1.0, -1.0))
    return z.gain("gain", "term per driver beyond the knee", 1), z.level("knee", v["knee"], "driver from which it acts"), side


def _threshold_declared(z, v):
    return z.gain("gain", "the term above the level"), z.level("level", v["level"], "driver above which it acts")


def _saturation_declared(z, v):
    limit = z.width("limit", v["limit"], "driver beyond which it grows no more", 1.0)
    return z.gain("gain", "term per driver below the limit", 1), limit


def _sign_declared(z, v):
    width = z.width("width", v["width"], "driver at which three quarters of it are there", 0.2)
    return z.gain("gain", "the term far from 0"), width


def _play_declared(z, v):
    gap = z.width("half_gap", v["half_gap"], "half of what is lost when the driver turns round")
    return z.gain("gain", "term per driver that is lost", 1), gap


def _hold_declared(z, v):
    width = z.width("half_width", v["half_width"], "largest change of the driver that is ignored")
    return z.gain("gain", "term per driver that is ignored", 1), width


def _relay_declared(z, v):
    upper = z.level("upper", v["upper"], "driver above which it switches on")
    lower = z.level("lower", v["lower"], "driver below which it switches off")
    return z.gain("gain", "the term while it is on"), upper, lower


def _sine_declared(z, v):
    f = v["frequency"]
    frequency = Parameter("frequency", "Hz", f, 0.5 * f, 2.0 * f, "frequency", nominal=f)
    return z.gain("in_phase", "sine's part"), z.gain("quadrature", "cosine's part"), frequency


_FOLLOWS = lambda ops, p, v: v  # noqa: E731
_SWITCHED = {"on": ("1", "1 while it is on", lambda ops, p, v: ops.where(v > p.upper, 1.0, 0.0))}
_TURNS = {
    "sine": ("1", "sine of the phase", lambda ops, p, v: 0.0),
    "cosine": ("1", "cosine of the phase", lambda ops, p, v: 1.0),
}

SHAPES = {
    shape.name: shape
    for shape in (
        Shape(
            "curve",
            "straight between knots, flat beyond",
            _curve_declared,
            _curve,
            lambda v: tuple(f"value_{k + 1}" for k in range(knots(v))),
        ),
        Shape("line", "gain v", _line_declared, lambda ops, x, p, v, dt: (p.gain * v, {})),
        Shape("square", "gain v |v|", _square_declared, lambda ops, x, p, v, dt: (p.gain * v * ops.abs(v), {})),
        Shape(
            "hinge",
            "gain max(side (v - knee), 0)",
            _hinge_declared,
            lambda ops, x, p, v, dt: (p.gain * ops.maximum(p.side * (v - p.knee), 0.0), {}),
        ),
        Shape(
            "threshold",
            "gain where v > level",
            _threshold_declared,
            lambda ops, x, p, v, dt: (p.gain * ops.where(v > p.level, 1.0, 0.0), {}),
        ),
        Shape(
            "saturation",
            "gain clip(v, -limit, limit)",
            _saturation_declared,
            lambda ops, x, p, v, dt: (p.gain * ops.clip(v, -p.limit, p.limit), {}),
        ),
        Shape("sign", "gain tanh(v / width)", _sign_declared, lambda ops, x, p, v, dt: (p.gain * ops.tanh(v / p.width), {})),
        Shape(
            "play",
            "gain (driven - v), driven <- clip(driven, v - half_gap, v + half_gap)",
            _play_declared,
            _play,
            memory={"driven": ("", "the driver behind the play", _FOLLOWS)},
        ),
        Shape(
            "hold",
            "gain (held - v), held <- v where |v - held| > half_width",
            _hold_declared,
            _hold,
            memory={"held": ("", "the driver that is held", _FOLLOWS)},
        ),
        Shape("relay", "gain from v > upper on until v < lower", _relay_declared, _relay, memory=_SWITCHED),
        Shape(
            "sine",
            "in_phase sin(2 pi frequency t) + quadrature cos(2 pi frequency t)",
            _sine_declared,
            _sine,
            lambda v: ("in_phase", "quadrature"),
            _TURNS,
            driven=False,
        ),
    )
}
"""All shapes by name."""

LAWS = ("line", "square", "hinge", "threshold", "saturation", "sign", "relay")
"""Parametric shapes that may replace a curve, in words."""
