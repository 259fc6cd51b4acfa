"""The objective of a tuning: the paper's cost (eq. 21) on the nominal plant or on many drawn plants, with limits as penalties.

    J = integral of ((thrust_set - thrust) / thrust_scale)^2 dt + alpha |gains|^2

in normalised gains. The cost alone has its minimum close to instability: on the paper's plant, the best gains for a step to 0.8
are unstable a little above it. Gains that follow most of a step quickly and then creep also cost less than gains that settle.
So penalties limit the nominal loop's overshoot, its largest sensitivity at the operating points (`linear`, `margins`), and the
settling and ringing of each step, to those of the initial gains.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property

import numpy as np

from identification.tune.linear import CHANNELS, chain_response, controller_response, plant_response, pulse_response
from identification.tune.margins import frequencies, holds
from vpp_fmu.kernel.controller import CONTROLLER, speed_alone
from vpp_fmu.kernel.effects.dual_pid import ALLOCATED
from vpp_fmu.kernel.plant import plant
from vpp_fmu.native.closed_loop import ROW, ClosedLoop, Course
from vpp_fmu.own_effects import library_with
from vpp_fmu.record import Record
from vpp_fmu.response import BAND, Step, steps, swing

ALPHA = 1e-8
"""Chosen; the paper gives no value. The cost's gradient along the logarithms of the published gains is smallest at 3e-8 for
speed alone and at 2e-9 to 6e-9 for both actuators. Published gains are a minimum for no alpha."""

PENALTY = 10.0
"""Penalty, as a factor on the cost, of a limit that is exceeded by 100 %."""

SLACK = 1.01
"""A limit counts as kept within this factor. Limits with a sharp edge, such as the band of settling, are tightened by it in a
search."""

EVERY = 5
"""A search uses one in EVERY frequencies of a response."""

UNSTABLE = 100.0
"""Least value that replaces the sensitivity of an unstable loop."""


@cache
def closed_loop(effects: tuple[str, ...], effects_from: tuple[str, ...] = ()) -> ClosedLoop:
    """The closed loop of a plant with these effects, some of which may be from these files; compiled once per process."""
    return ClosedLoop(plant(effects, library_with(effects_from)))


@dataclass(frozen=True)
class Point:
    """An operating point: thrust [N], its commands [rpm, deg], and the channels that are not at a limit."""

    thrust: float
    commands: tuple[float, float]
    channels: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class Objective:
    """The cost of a controller's gains; plain data that can be sent to another process.

    `effects`: of the plant, also from the files `effects_from`; `plants` (count, parameters): its values, the nominal plant
    first. `settings`: all of the controller's values; `chain`: all of the measurement chain's; `time_scale` s: the rig's.
    `over`: "worst" or "mean" of the plants. Limits on the nominal loop: `overshoot` (share of a step), and `sensitivity` at
    `points`. `reference`: steps under the initial gains, whose settling and ringing are limits; (): no such limit.
    """

    effects: tuple[str, ...]
    plants: np.ndarray
    settings: Mapping[str, float]
    chain: Mapping[str, float]
    course: Course
    time_scale: float
    alpha: float = ALPHA
    over: str = "worst"
    overshoot: float = 0.01
    sensitivity: float = 2.0
    points: tuple[Point, ...] = ()
    reference: tuple[Step, ...] = ()
    effects_from: tuple[str, ...] = ()

    @property
    def loop(self) -> ClosedLoop:
        return closed_loop(self.effects, self.effects_from)

    @property
    def channels(self) -> tuple[str, ...]:
        """The active channels: those with a range between their limits; speed alone if the controller has no pitch."""
        room = {u: self.settings[f"{u}_min"] < self.settings[f"{u}_max"] for u in CHANNELS}
        return tuple(u for u in CHANNELS if room[u] and (u == "omega" or not speed_alone(self.settings)))

    @property
    def allocated(self) -> bool:
        """Whether the law is that of mode 2, in which speed integrates pitch."""
        return self.settings.get("mode") == ALLOCATED

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the gains of the active channels: proportional, then integral, then derivative."""
        names = (f"{kind}_{channel}" for kind in ("kp", "ki", "kd") for channel in self.channels)
        return tuple("k_mid" if self.allocated and name == "ki_omega" else name for name in names)

    def integrators(self, point: "Point") -> int:
        """Integrators in a row in the open loop at a point."""
        return 2 if self.allocated and "omega" in point.channels else 1

    @property
    def gains(self) -> np.ndarray:
        """The gains (n,) of `settings`."""
        return np.array([self.settings[name] for name in self.names])

    @property
    def nominal(self) -> "Objective":
        """The objective for the nominal plant alone."""
        return replace(self, plants=self.plants[:1])

    def with_gains(self, gains: np.ndarray) -> dict[str, float]:
        """The controller's values with these gains (n,)."""
        return {**self.settings, **dict(zip(self.names, gains.tolist(), strict=True))}

    def merits(self, gains: np.ndarray) -> np.ndarray:
        """Integral of the squared error [s] and overshoot, for each plant (count, 2)."""
        return self.loop.merits((self.plants, self._chain, self._controller(gains)), self.course)

    def costs(self, gains: np.ndarray) -> np.ndarray:
        """The paper's cost for each plant (count,)."""
        return self.merits(gains)[:, 0] + self.alpha * float(gains @ gains)

    def cost(self, gains: np.ndarray) -> float:
        """The paper's cost, worst or mean over the plants."""
        return self._over(self.costs(gains))

    @cached_property
    def quiet(self) -> Course:
        """The course without measurement noise, on which limits of steps are evaluated."""
        return replace(self.course, noise=np.zeros_like(self.course.noise)) if self.course.noise.any() else self.course

    def penalised(self, gains: np.ndarray) -> float:
        """The cost with a penalty for each limit that the nominal loop exceeds."""
        loop, controller = self.loop, self._controller(gains)
        (error, overshoot), rows = loop.rows((self.plants[:1], self._chain, controller), self.quiet)
        # Without noise, the quiet run is also the nominal plant's run.
        done = 1 if self.quiet is self.course else 0
        errors = np.full(done, error)
        if len(self.plants) > done:
            errors = np.r_[errors, loop.merits((self.plants[done:], self._chain, controller), self.course)[:, 0]]
        cost = self._over(errors + self.alpha * float(gains @ gains))
        if not np.isfinite(cost):
            return np.inf
        excess = max(0.0, overshoot / self.overshoot - 1.0)
        excess += max(0.0, self.largest_sensitivity(gains) / self.sensitivity - 1.0)
        # The logarithm, because the error at the beginning of a step is fifty times the band of settling.
        shares = self._shares_of_limits(rows[:, ROW.index("thrust")])
        excess += sum(max(0.0, float(np.log(SLACK * share))) for share in shares if share > 0.0)
        return cost * (1.0 + PENALTY * excess)

    def _shares_of_limits(self, thrust: np.ndarray) -> Iterator[float]:
        """For each step of the reference and a nominal response (points,) N: the largest error, from one sample after the
        reference has settled, over the band; and the largest swing over its limit."""
        for step, (first, settled, last) in zip(self.reference, self._rows, strict=True):
            missing = (step.after - thrust[first:last]) / (step.after - step.before)
            if settled + 1 < last:
                yield float(np.max(np.abs(missing[settled + 1 - first :]))) / BAND
            yield swing(missing) / max(self.overshoot, step.ringing / 100.0)

    @cached_property
    def _rows(self) -> list[tuple[int, int, int]]:
        """(first row, row at which the reference has settled, or the end if it has not, end) of each step of the reference."""
        dt, wanted, found = self.course.dt, self.course.wanted, []
        changes = np.r_[np.flatnonzero(np.diff(wanted)) + 1, len(wanted)]
        for step in self.reference:
            first = round(step.time / dt)
            end = int(changes[np.searchsorted(changes, first, side="right")])
            found.append((first, end if step.settling is None else first + round(step.settling / dt), end))
        return found

    def run(self, gains: np.ndarray, row: int = 0) -> Record:
        """The loop's record for one plant."""
        return self.loop.run((self.plants[row], self._chain, self._controller(gains)), self.course)

    def steps(self, gains: np.ndarray) -> tuple[Step, ...]:
        """Steps of the nominal loop without noise; changes of the wanted thrust below `course.jump` are left out."""
        run = replace(self, course=self.quiet).run(gains)
        return tuple(s for s in steps(run) if abs(s.after - s.before) >= self.course.jump)

    def largest_sensitivity(self, gains: np.ndarray) -> float:
        """Largest sensitivity of the nominal loop at `points`; 0 without points; at least UNSTABLE if a loop is unstable."""
        if not self.points:
            return 0.0
        loop = self.open_loops(gains, self._omega, self._paths)
        stable = holds(loop, np.array([self.integrators(point) for point in self.points]))
        return float(1.0 / np.abs(1.0 + loop).min()) if stable else float(UNSTABLE + np.abs(loop).max())

    @cached_property
    def _omega(self) -> np.ndarray:
        """Frequencies (m,) [rad/s] of a search."""
        return frequencies(self.course.dt, self.time_scale)[::EVERY]

    @cached_property
    def _paths(self) -> dict[str, np.ndarray]:
        return self.paths(self.points, self._omega)

    def open_loops(self, gains: np.ndarray, omega: np.ndarray, paths: Mapping[str, np.ndarray]) -> np.ndarray:
        """Open-loop responses (points, m) of chain, controller and nominal plant; `paths` as of `paths`."""
        settings = self.with_gains(gains)
        return sum(controller_response(settings, u, omega) * path for u, path in paths.items())

    def paths(self, points: Sequence[Point], omega: np.ndarray) -> dict[str, np.ndarray]:
        """By channel the response (points, m) at `omega` (m,) [rad/s] from its command to the thrust reading; 0 at points where
        it is at a limit."""
        model, dt = self.loop.models[0], self.course.dt
        values = dict(zip((p.name for p in model.parameters), self.plants[0].tolist(), strict=True))
        found = {u: np.zeros((len(points), len(omega)), complex) for u in self.channels}
        chain = chain_response(self.chain, omega, dt)
        for k, point in enumerate(points):
            for u in point.channels:
                pulse = pulse_response(model, values, point.commands, u, dt, self.time_scale)
                found[u][k] = chain * plant_response(pulse, omega, dt)
        return found

    @cached_property
    def _chain(self) -> np.ndarray:
        return np.array(list(self.chain.values()))

    def _controller(self, gains: np.ndarray) -> np.ndarray:
        return np.array(list(CONTROLLER.values(self.with_gains(gains)).values()))

    def _over(self, costs: np.ndarray) -> float:
        return float(costs.max() if self.over == "worst" else costs.mean())
