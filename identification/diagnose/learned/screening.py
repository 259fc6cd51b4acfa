"""Screen terms of every port, driver, lag and shape beside a fit, by group score tests, to choose those for a refit.

Curves are groups of linear B-splines. Plays, holds, relays and sines are single columns, or pairs, over a grid of their
thresholds.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import product

import numpy as np

from identification.diagnose.command_shapes import lagged
from identification.diagnose.judgement import chance_threshold
from identification.diagnose.learned.columns import Course, hats, holds, knots_of, plays, relay
from identification.diagnose.learned.score import Scored, Scores
from identification.diagnose.search.fits import Fit
from identification.fit.linearised import Linearised
from vpp_fmu.kernel.effects.stage import INNER, OUTER
from vpp_fmu.kernel.learned import DRIVERS, PORTS, Port

LAGS = (0.0, 0.2, 0.6, 2.0, 6.0, 20.0, 60.0)
"""Lags of a driver, in the rig's time scale; at most a third of the record."""

WIDTHS = (0.005, 0.01, 0.02, 0.04, 0.08, 0.16)
"""Half widths of plays and holds, as shares of the driver's range."""

LEVELS = (0.15, 0.3, 0.45, 0.6, 0.75, 0.9)
"""Quantiles of a driver that are tried as thresholds of a relay."""

FASTEST = 5.0
"""Highest frequency of sines, Hz."""

FOLLOWED = {
    "pitch_command": "pitch_command",
    "speed_command": "speed_command",
    "effective_pitch": "pitch",
    "rotor_speed": "speed",
    "reading": "thrust",
}
"""Driver of a play, and of a hold, by port: the port's quantity."""

SWITCHED = ("thrust_share", "speed_command_share", "effective_pitch", "pitch_rate_share")
"""Ports of relays."""

FREE_AT_REST = ("speed_command", "speed_command_share", "rotor_speed", "thrust", "reading", "motor_acceleration")
"""Ports at which the base does not absorb a constant: there a curve over an unsigned driver has no pinned knot."""


@dataclass(frozen=True, eq=False)
class Lead:
    """A screened term: its port, driver and shape. `swapped`: the channel's lags in the other order; `values`: of its shape;
    `pinned`: those that are not fitted; `needed`: gain that the best of all `comparisons` reaches by chance."""

    port: str
    driver: str
    shape: str
    lag: float | None
    times: str
    form: float
    swapped: bool
    span: tuple[float, float]
    values: dict[str, float]
    pinned: tuple[str, ...]
    scored: Scored
    comparisons: int = 0
    needed: float = np.inf

    @property
    def kind(self) -> tuple:
        """Key of its port, driver and shape; all lags above 0 are one kind."""
        return self.port, self.driver, self.times, self.shape, self.lag is None

    @property
    def promising(self) -> bool:
        """Whether its gain exceeds that of the best by chance, and the held-out gain is positive."""
        return self.scored.likelihood_gain > self.needed and self.scored.held_out > 0.0


def screened(
    fit: Fit, values: Mapping[str, float] | None = None, spread: Callable = map, channel: str | None = None
) -> list[Lead]:
    """All leads beside a fit, the best held-out score first. `values`: linearise there instead of at the fit; `spread`: maps a
    function over the groups of leads, as `map` does; `channel`: at ports of this channel alone, "" for the thrust."""
    problem, simulator = fit.problem, fit.problem.simulator
    x = fit.solution.value if values is None else problem.coordinates.vector({**fit.values, **values})
    at = {**fit.values, **problem.coordinates.values(x)}
    residual, jacobian = fit.tangent() if values is None else problem.evaluate(x)
    about = Linearised(problem, x, residual, jacobian)
    fitted = problem.experiments[0].channels
    ports = [n for n, place in PORTS.items() if _of_channels(place, fitted) and channel in (None, place.channel)]
    courses = [Course.of(e, at, simulator.simulate(at, *e.record.run)) for e in problem.experiments]
    scores = Scores(about, jacobian[: problem.size], courses, problem.scale, problem.times, ports)
    groups = [*_curves(scores), *_memories(scores), *_relays(scores), *_sines(scores)]
    leads = [lead for some in spread(lambda group: group(), groups) for lead in some]
    found = [replace(lead, needed=chance_threshold(lead.scored.rank, len(leads)), comparisons=len(leads)) for lead in leads]
    return sorted(found, key=lambda lead: -lead.scored.held_out)


def _of_channels(port: Port, channels: Sequence[str]) -> bool:
    """Whether a port acts in the fitted channels: where thrust alone is fitted, the speed is known."""
    return len(channels) > 1 or (port.channel == "omega") == (tuple(channels) == ("omega",))


def _lags(scores: Scores) -> list[float]:
    block = scores.courses[0].step
    scale = block * 30.0
    longest = max(c.drivers["time"][-1] for c in scores.courses) / 3.0
    return [lag * scale for lag in LAGS if lag * scale <= longest]


def forms_of(port: str) -> tuple[tuple[float, bool], ...]:
    """(lag at which a port acts, whether the two lags are in the other order), all combinations."""
    return tuple(product((INNER, OUTER), (False, True))) if PORTS[port].staged else ((OUTER, False),)


def _responses(scores: Scores, port: str, form: tuple[float, bool], terms: list[np.ndarray], times: str = ""):
    courses = scores.courses
    terms = [f * (c.w**2)[:, None] if times else f for c, f in zip(courses, terms, strict=True)]
    return [c.response(port, *form, f) for c, f in zip(courses, terms, strict=True)]


def _span(parts: list[np.ndarray]) -> tuple[float, float]:
    low, high = min(float(p.min()) for p in parts), max(float(p.max()) for p in parts)
    return low, high


Look = Callable[[], list[Lead]]


def _curves(scores: Scores) -> Iterator[Look]:
    for name, driver in DRIVERS.items():
        for lag in _lags(scores) if driver.signal else [0.0]:
            common = [lagged(c.drivers[name], lag, c.step) for c in scores.courses]
            for port, place in ((port, PORTS[port]) for port in scores.ports):
                if port == "reading" and name != "thrust":
                    continue  # before all other effects of the reading it equals the port "thrust"
                own = driver.own_stage(place)
                if own and lag > 0.0:
                    continue  # an actuator's law depends on the present remaining change
                for form in forms_of(port):
                    v = [c.driver(name, port, *form) for c in scores.courses] if own else common
                    for times in ("", "speed_squared") if port == "thrust" else ("",):
                        yield partial(_curve, scores, port, name, lag, form, times, v)


def _curve(scores, port, name, lag, form, times, v) -> list[Lead]:
    driver, together = DRIVERS[name], np.concatenate(v)
    at = knots_of(together, driver.signed)
    if len(at) == 0 or np.any(np.diff(at) <= 1e-9 * max(np.ptp(together), 1e-12)):
        return []
    if driver.signed:
        pinned = [len(at) // 2]
    else:
        pinned = [] if port in FREE_AT_REST else [int(np.argmin(np.abs(at - np.median(together))))]
    kept = [k for k in range(len(at)) if k not in pinned]
    terms = [hats(one, at)[:, kept] for one in v]
    scored = scores.group(*scores.products(_responses(scores, port, form, terms, times)))
    values = {f"at_{k + 1}": float(a) for k, a in enumerate(at)} | {f"value_{k + 1}": 0.0 for k in pinned}
    values |= {f"value_{k + 1}": float(share) for k, share in zip(kept, scored.shares, strict=True)}
    stay = (*(f"at_{k + 1}" for k in range(len(at))), *(f"value_{k + 1}" for k in pinned))
    return [Lead(port, name, "curve", lag or None, times, *form, _span(v), values, stay, scored)]


def _memories(scores: Scores) -> Iterator[Look]:
    """Plays of a port's quantity, and holds of commands."""
    for port, name in ((port, name) for port, name in FOLLOWED.items() if port in scores.ports):
        v = [c.drivers[name] for c in scores.courses]
        low, high = _span(v)
        widths = (high - low) * np.array(WIDTHS)
        for shape, width, columns in (("play", "half_gap", plays), ("hold", "half_width", holds)):
            if shape == "hold" and not name.endswith("command"):
                continue
            terms, points = [columns(one, widths) for one in v], [{width: float(w)} for w in widths]
            yield from (partial(_each, scores, port, name, shape, v, points, terms, 0.0, form) for form in forms_of(port))


def _relays(scores: Scores) -> Iterator[Look]:
    for name in ("thrust", "speed", "pitch"):
        for lag in (0.0, *_lags(scores)[2:3]):
            v = [lagged(c.drivers[name], lag, c.step) for c in scores.courses]
            levels = np.quantile(np.concatenate(v), LEVELS)
            pairs = [(a, b) for k, a in enumerate(levels) for b in levels[k:]]
            terms = [np.stack([relay(one, a, b) for a, b in pairs], axis=1) for one in v]
            points = [{"lower": float(a), "upper": float(b)} for a, b in pairs]
            for port in (port for port in SWITCHED if port in scores.ports):
                yield from (partial(_each, scores, port, name, "relay", v, points, terms, lag, form) for form in forms_of(port))


def _each(scores, port, name, shape, v, points, terms, lag, form) -> list[Lead]:
    """A lead for each single column; all products are computed at once."""
    gram, product = scores.products(_responses(scores, port, form, terms))
    found = []
    for k, point in enumerate(points):
        scored = scores.group(gram[:, k : k + 1, k : k + 1], product[:, k : k + 1])
        values = {**point, "gain": float(scored.shares[0])}
        found.append(Lead(port, name, shape, lag or None, "", *form, _span(v), values, (), scored))
    return found


def _sines(scores: Scores) -> Iterator[Look]:
    """Sines of the thrust at the frequencies at which the longest record resolves them."""
    times = [c.drivers["time"] for c in scores.courses] if "thrust" in scores.ports else []
    if not times:
        return
    seconds = max(t[-1] for t in times)
    count = int(min(FASTEST * seconds, 400))
    frequencies = np.arange(1, count + 1) / seconds
    yield from (partial(_sine, scores, times, seconds, some) for some in np.array_split(frequencies, max(1, count // 20)))


def _sine(scores, times, seconds, frequencies) -> list[Lead]:
    turns = [2.0 * np.pi * t[:, None] * frequencies for t in times]
    gram, product = scores.products([(np.hstack([np.sin(turn), np.cos(turn)]), None) for turn in turns])
    found = []
    for k, frequency in enumerate(frequencies.tolist()):
        pair = [k, k + len(frequencies)]
        scored = scores.group(gram[:, pair][:, :, pair], product[:, pair])
        values = {"in_phase": float(scored.shares[0]), "quadrature": float(scored.shares[1]), "frequency": frequency}
        found.append(Lead("thrust", "time", "sine", None, "", OUTER, False, (0.0, seconds), values, (), scored))
    return found
