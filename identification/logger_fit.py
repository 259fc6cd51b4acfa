"""Estimate the logger of a campaign: the offset of readings to commands, and the kind of speed sensor.

In each row, a logger without an offset reads first and commands then. Others command first, write readings of the previous
loop, or log a command one row late. The offset, in rows, is the delay of a command to the readings of its row. It is estimated
together with the base model and a speed sensor, by maximum likelihood over the kinds of sensor.

Effects of a rig delay its response. There are three delays: from each command to the thrust, and from the speed command to the
measured speed. The smallest is the logger's; the excess of the others belongs to the sensor or the rig. A missing effect of the
thrust delays it from both commands: so the speed readings alone limit the offset.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

from identification.fit.coordinates import slowest
from identification.fit.experiment import Experiment
from identification.fit.least_squares import solve
from identification.fit.noise import independent
from identification.fit.problem import Problem
from identification.fit.uncertainty import uncertainty
from identification.gate.gate import Passed, passed
from identification.logger import FINEST, SIGNIFICANT, Logger
from identification.renewals import renewal_score, renewals, unexplained
from identification.roles import Fitted, roles
from identification.run_in import BLOCKS, run_in
from vpp_fmu.campaign import Campaign
from vpp_fmu.kernel.plant import AVERAGED, FINE_TUNED, LIBRARY, plant, sized
from vpp_fmu.kernel.types import Effect
from vpp_fmu.native import Simulator
from vpp_fmu.record import Record
from vpp_fmu.rig import infer_rig
from vpp_fmu.sensors import ENCODER, MARK, TELEMETRY, UNKNOWN, SpeedSensor

EARLIEST = 3
"""Maximum number of rows by which commands may act before their readings."""

LATEST_ROW = 2.0
"""Maximum offset of a logger, in rows, if a delay of one command explains the record as well. A command waits for the row to be
written, and then for the next loop."""

ROUNDS, QUARTER = 4, 0.25
"""Maximum number of fits that search for run-ins; maximum share of a record that the first of them excludes."""

MARKS = (1, 2, 3, 4)
"""Numbers of pulses per revolution that are tried."""

EVIDENCE = 5.0
"""Minimum evidence (half a BIC difference) for a sensor of more parameters, or another logger: very strong (Kass and Raftery,
1995)."""

NOT_DISTINGUISHED = 2.0 * EVIDENCE
"""Difference of scores within which two sensors are not distinguished: both fits are approximate."""

ENOUGH_ROWS, ENOUGH_MOVES = 12_000, 4
"""A record is used up to this row, or up to this move of each command, if that is later: together they identify the offset to a
hundredth of a row."""

SPLIT = 0.01
"""Maximum time between simulated rows, s: a fifth of the shortest lag of such rigs."""

GROUPS = 10
"""Number of groups of speed readings, by their uncertainty. Each has its own noise variance in a comparison of sensors."""

ROUGH, FULL = (3, 3), (6, 6, 6, 12)
"""Evaluations in each round of a fit that ranks sensors, and of one that estimates."""

NEAR = 100.0
"""Log-likelihood difference within which a rough fit may still be the best one."""

CLOSE = 1e-9
"""Relative change of the cost that ends a fit."""

NUDGE = 0.02
"""Step of the finite difference in a sensor's parameters, in rows."""

LATEST = 0.3
"""Maximum delay and filter time constant of a speed sensor, s."""

FILTER = 0.02
"""Start value of the filter time constant of telemetry, s."""

DELAYS = {"omega": "speed_delay", "beta": "pitch_delay"}
SPEED_DELAY = f"{DELAYS['omega']}.delay"
ALL_DELAYS = tuple(f"{name}.delay" for name in DELAYS.values())


@threadpool_limits.wrap(limits=1)  # threads do not help with ten columns
def as_logged(
    gate: Passed,
    effects: Iterable[str] = (),
    library: Iterable[Effect] = LIBRARY,
    values=None,
    each: Callable = map,
    pinned: Iterable[str] = (),
) -> Passed:
    """The records that passed the gate, corrected for their logger and without run-ins.

    The logger is estimated from the fitted records, beside `effects` of a `library`. They are fitted from `values`, but for
    parameters that are `pinned` there. Without records it has no offset, and run-ins are not searched. `each`: as `map`, for
    fits that may run in parallel."""
    campaign, declared = gate.campaign, gate.campaign.rig.sensor
    if not any((campaign.open_loop, campaign.repeat, campaign.validation, *gate.further.values())):
        found = Logger(sensor=SpeedSensor(**declared) if "kind" in declared else SpeedSensor())
        return replace(gate.changed(found.applied), logger=found)
    values = {**AVERAGED, **(values or {})}
    longest = 0.5 * BLOCKS * slowest(values, values)
    settled = gate.without_run_ins(lambda record: min(longest, QUARTER * float(record.time[-1])))
    for _ in range(ROUNDS):  # wrong lags may explain a run-in: the first fit excludes the start of each record
        groups, _ = roles(settled.campaign, settled.further)
        of = _Estimate(groups, campaign.rig.scales, declared, effects, library, values, pinned)
        values = of.values
        before, settled = settled, gate.without_run_ins(of.run_in)
        if {(f.code, f.where) for f in settled.findings} == {(f.code, f.where) for f in before.findings}:
            break
    found = of.logger(each)
    return replace(settled.changed(found.applied), logger=found)


def mended(record: Record) -> tuple[Record, list[str]]:
    """(the record with its commands shifted by whole rows to the rows in which they act, the change in words). BadInput if the
    gate refuses the record."""
    campaign = Campaign(Path("."), None, (), record, None, None, rig=infer_rig([record], None, {}))
    logger = as_logged(passed(campaign)).logger
    rows = round(logger.rows)
    if not rows:
        return record, ["mend: no shift of the commands by a whole row"]
    way = "down" if rows > 0 else "up"
    words = f"mend: commands shifted {way} by {abs(rows)} row{'s' * (abs(rows) > 1)}: {logger.lines[0]}"
    return record.commands_later(rows), [words]


class _Estimate:
    def __init__(self, groups: Sequence[Sequence[Fitted]], scales, declared, effects, library, values, pinned=()):
        effects = [e for e in effects if e not in DELAYS.values()]
        library = tuple(library)
        delays = (e for e in LIBRARY if e.name in DELAYS.values() and e.name not in {known.name for known in library})
        self._model = plant([*effects, *DELAYS.values()], sized((*library, *delays), scales))
        # A repeat adds no other moments.
        self._first, self._declared = groups[0][0].record, declared
        self._period = self._first.period
        self._groups = [[Fitted(group[0].name, _split(_as_modelled(group[0].record)))] for group in groups]
        moves = {u: any(np.ptp(g[0].record[f"{u}_ref"]) > 0.0 for g in groups) for u in DELAYS}
        own = [e.full(p.name) for e in self._model.effects if e.name in effects for p in e.parameters if not p.choices]
        own = [name for name in own if name not in pinned]
        self._delays = delays = [f"{name}.delay" for u, name in DELAYS.items() if moves[u]]
        lags = [f"tau_{u}_{k}" for u in DELAYS if moves[u] for k in (1, 2)]
        self._names = [n for n in FINE_TUNED if not n.startswith("tau_") or n in lags] + own + delays
        start = {f"{name}.delay": EARLIEST * self._period for name in DELAYS.values()}
        known = {p.name for p in self._model.parameters}
        start = self._model.values({n: v for n, v in {**values, **start}.items() if n in known})
        noise = independent(start["thrust_scale"])
        self._experiments = [Experiment(group, noise) for group in self._groups]
        self._thrust_alone = [Experiment(group, noise, channels=("thrust",)) for group in self._groups]
        self._measured = any(len(e.omega_time) for e in self._experiments)
        # The response of an effect between two lags depends on their order.
        self.slow_first = {u: start[f"tau_{u}_1"] >= start[f"tau_{u}_2"] for u in DELAYS}
        # Delays that are free from the start would replace lags.
        names = [n for n in self._names if n not in delays]
        base = Problem(self._model, self._thrust_alone, start, names, slow_first=self.slow_first)
        self.values = start | base.coordinates.values(base.fit(start).value)

    def run_in(self, record: Record) -> float:
        """Seconds from the record's start until its initial state has decayed."""
        shown = _as_modelled(record)
        outputs = Simulator(self._model).simulate(self.values, *shown.run)
        return run_in(shown, outputs, slowest(self.values, self._names))

    def logger(self, each: Callable = map) -> Logger:
        """The most likely logger.

        Each sensor is fitted roughly with one offset of all readings, the best ones in full. A sensor is rejected if another
        one of no more parameters fits the thrust better. Of those that are not distinguished, those that read samples come
        before those that read means."""
        start = _SensorFit(self, None, (), tied=True).solved(FULL)
        if not self._measured:
            return self._logger_of(start)
        best = self._likeliest(each, start)
        latest = self._latest(best)
        if best.delayed:  # by the rig or the sensor: to be named by a diagnosis
            found = self._logger_of(best) if latest is None else Logger(*latest.rows(self._period), period=self._period)
            return replace(found, sensor=replace(best.sensor, delay=0.0), sensor_std={})
        if latest is None:
            return self._logger_of(best)
        best = self._likeliest(each, start, latest.value / self._period)
        uncertain = {name: best.estimate(name)[1] for name in best.free}
        return Logger(latest.value / self._period, latest.std / self._period, best.sensor, uncertain, self._period)

    def _likeliest(self, each: Callable, start: "_SensorFit", held: float | None = None) -> "_SensorFit":
        """The fit of the most likely sensor, with one offset, or with one `held` in rows."""

        def rough(hypothesis) -> _SensorFit:
            return _SensorFit(self, *hypothesis, start, tied=held is None, held=held).solved(ROUGH)

        fits = list(each(rough, self._hypotheses()))
        scores = _scores(fits)
        if held is None:
            fits += each(rough, self._delayed(fits, scores))
            scores = _scores(fits)
        near = [fit for fit, score in zip(fits, scores, strict=True) if score > max(scores) - NEAR]
        near = list(each(lambda fit: fit.solved(FULL), near))
        near = [fit for fit in near if not any(other.fits_thrust_better_than(fit) for other in near)]
        scores = _scores(near)
        likely = [(s, fit) for s, fit in zip(scores, near, strict=True) if s >= max(scores) - NOT_DISTINGUISHED]
        return min(likely, key=lambda pair: (pair[1].sensor.averaged, pair[1].delayed, -pair[0]))[1]

    def _delayed(self, fits: Sequence["_SensorFit"], scores: Sequence[float]) -> list[tuple]:
        """Hypotheses with a delay of the speed other than that of the thrust. Only telemetry has one else: where the rig delays
        its thrust, or its speed reading, telemetry would explain it, though the renewals are likelier for another sensor."""
        rivals = [fit for fit, score in zip(fits, scores, strict=True) if "delay" in fit.free and score > max(scores) - NEAR]
        least = min((fit.renewed for fit in rivals), default=np.inf) + EVIDENCE
        return [(fit.sensor, fit.with_delay, fit.renewed) for fit in fits if fit.renewed > least and fit.with_delay != fit.free]

    def _latest(self, fit: "_SensorFit") -> "_Delay | None":
        """The offset that the speed readings alone show, if that of a fit of all readings is later: the rest is a delay of the
        thrust. None if it is not later."""
        if SPEED_DELAY not in self._delays or fit.offset.agrees_with(NONE):
            return None
        late_thrust = fit.delayed and fit.reads_ahead
        sensor = replace(fit.sensor, delay=0.0) if late_thrust else fit.sensor
        experiments = [Experiment(g, independent(1.0), channels=("omega",)).measured_by(sensor) for g in self._groups]
        turning = {e.name for e in self._model.effects if e.in_speed}
        names = [n for n in self._names if n.startswith("tau_omega") or n.split(".")[0] in turning]
        shown = []
        for rows in (0.0, fit.offset.value / self._period):
            start = {**fit.values, SPEED_DELAY: (EARLIEST + rows) * self._period}
            problem = Problem(self._model, experiments, start, names, slow_first=self.slow_first)
            found = problem.fit(start)
            problem.weigh(found.residual)
            found = problem.refit(found.value)
            shown.append((problem.score_of(found.residual).deviance, problem, found))
        _, problem, found = min(shown, key=lambda each: each[0])
        spread = uncertainty(problem, found)
        at = spread.names.index(SPEED_DELAY)
        # The delay of telemetry is unknown, too: its readings may be as new as their rows.
        newer = sensor.delay - fit.earliest if "delay" in fit.free and not fit.delayed else 0.0
        value = float(spread.values[at]) - EARLIEST * self._period + newer
        own = _Delay(value, float(spread.std[at]), fit.unknown_instant)
        if not late_thrust and (not own.value < fit.offset.value or own.agrees_with(fit.offset)):
            return None
        near = [v for v in (0.0, round(value / self._period) * self._period) if not own.differs_from(v)]
        return replace(own, value=max(near[0] if near else value, 0.0))

    def _logger_of(self, fit: "_SensorFit") -> Logger:
        """The logger of a fit with one offset, unless further parameters have very strong evidence. An offset of zero or of
        whole rows comes before the estimate if it explains the records as well. An offset at its lower limit counts as zero:
        the rig's response begins faster than that of two lags."""
        if not self._delays:
            return Logger(sensor=fit.sensor, period=self._period)
        shared = fit.offset
        freer = fit.tied or fit.with_delay != fit.free
        loose = _SensorFit(self, fit.sensor, fit.with_delay, fit.renewed, fit).solved(FULL) if freer else fit
        delayed = fit.worse_than(loose)
        if contract := self._one_delay(fit, loose if delayed else fit):
            return contract
        if delayed:  # the rig or the sensor has further delays
            shared = loose.shared()
        rows, std = shared.value / self._period, shared.std / self._period
        if rows < FINEST - EARLIEST:
            rows, std = 0.0, 0.0

        for value in (0.0, float(round(rows)), rows):
            held = _SensorFit(self, fit.sensor, fit.free, fit.renewed, fit, held=value).solved(FULL)
            if abs(rows - value) < FINEST or not (held.worse_than(fit) or held.reads_ahead):
                break
        uncertain = {name: held.estimate(name)[1] for name in held.free}
        return Logger(value, std, held.sensor, uncertain, self._period)

    def _one_delay(self, fit: "_SensorFit", best: "_SensorFit") -> Logger | None:
        """The logger without an offset, if a delay of one command explains the record better than the offset of `fit`, or as
        well if the offset is later than a logger's; and as well as the `best` fit, which may have more delays. Shorter lags of
        the other command hide the difference. No rotor turns before its command: a leading speed is due to the logger."""
        for name in self._delays:
            one = _SensorFit(self, fit.sensor, fit.free, fit.renewed, fit, held=0.0, alone=name).solved(FULL)
            if name == SPEED_DELAY and one.late(name).leads:
                continue
            explains = fit.worse_than(one) or (fit.is_late and not one.worse_than(fit))
            if explains and not one.worse_than(best):
                return Logger(0.0, 0.0, one.sensor, {name: one.estimate(name)[1] for name in one.free}, self._period)
        return None

    def _hypotheses(self) -> list[tuple[SpeedSensor, tuple[str, ...], float]]:
        """(sensor, its free parameters, log-likelihood of its renewal intervals) of the sensors that explain these intervals;
        of all, if none does. Marks and encoders have no delay without very strong evidence."""
        declared = self._declared
        rows, turn, mixed = renewals(self._first)
        kinds = [declared["kind"]] if "kind" in declared else [MARK, ENCODER, TELEMETRY]
        marks = [declared["marks_per_revolution"]] if "marks_per_revolution" in declared else MARKS
        ways = [declared["averaged"]] if "averaged" in declared else [True] if mixed else [False, True]
        every: list[tuple[SpeedSensor, Sequence]] = [
            (SpeedSensor(ENCODER, averaged=averaged), [1.0]) for averaged in ways if ENCODER in kinds
        ]
        for n, averaged in product(marks if MARK in kinds else [], ways):
            held = turn / n  # if means have no mixed rows, a value is held for less than three rows
            expected = [np.where(held < 3.0, held - 1.0, np.inf), 1.0] if averaged and not mixed else [held]
            every.append((SpeedSensor(MARK, n, averaged=averaged), expected))
        # Telemetry that is faster than the rows is renewed in each row: with it, or some time before.
        renewed = {0.0, 1.0, float(rows.mean()) if len(rows) else 1.0} if TELEMETRY in kinds else ()
        for interval, means in product(renewed, ways):
            sensor = SpeedSensor(TELEMETRY, filter=FILTER, refresh=interval * self._period, averaged=means)
            every.append((sensor, [max(interval, 1.0)]))
        known = {k: v for k, v in declared.items() if k in ("filter", "refresh", "delay")}
        explained = [one for one in every if not unexplained(one[0].kind, rows, *one[1])]
        return [
            (
                replace(sensor, **known),
                tuple(sorted({"delay", "filter"} - set(known))) if sensor.kind == TELEMETRY else (),
                renewal_score(rows, *expected) if explained else 0.0,
            )
            for sensor, expected in explained or every
        ]


class _SensorFit:
    """The base model with delays of its commands, fitted with one kind of sensor, whose `free` parameters are fitted, too.

    `sensor` None: fitted to the thrust alone. `tied`: both commands have the same delay. `held`: its fixed value, in rows.
    `alone`: the one delay that is not held.
    `renewed`: log-likelihood of the renewal intervals of the sensor.
    """

    def __init__(
        self,
        of: _Estimate,
        sensor: SpeedSensor | None,
        free: tuple[str, ...],
        renewed: float = 0.0,
        start: "_SensorFit | None" = None,
        tied: bool = False,
        held: float | None = None,
        alone: str = "",
    ):
        self._of, self.free, self.sensor, self.renewed = of, free, sensor or UNKNOWN, renewed
        self._experiments = of._thrust_alone
        if self.sensor.kind:
            self._experiments = [e.measured_by(self.sensor) for e in of._experiments]
        at_rest = {} if held is None else dict.fromkeys(ALL_DELAYS, (EARLIEST + held) * of._period)
        fixed = {n: v for n, v in at_rest.items() if n != alone}
        self._start = {**(of.values if start is None else start.values), **fixed}
        self._names = [n for n in of._names if n not in fixed]
        self._problem = Problem(of._model, self._experiments, self._start, self._names, slow_first=of.slow_first)
        c = self._problem.coordinates
        self._count, self._sensor = len(c.names), self.sensor
        self.tied = tied and len(of._delays) == 2
        self._kept = [k for k, n in enumerate(c.names) if not (self.tied and n == of._delays[1])]
        self._tied = (c.names.index(of._delays[1]), self._kept.index(c.names.index(of._delays[0]))) if self.tied else None
        # Telemetry is assumed half an interval old on average; it cannot be newer than its row.
        self.earliest = -0.5 * min(of._period, self.sensor.refresh) if self.sensor.kind == TELEMETRY else -LATEST
        limits = {"delay": (self.earliest, LATEST), "filter": (0.1 * of._period, LATEST)}
        self._lower, self._upper = (
            np.append(x[self._kept], [limits[n][k] for n in free]) for k, x in enumerate((c.lower, c.upper))
        )
        self._x = np.append(c.vector(self._start)[self._kept], [getattr(self.sensor, n) for n in free])
        if start is not None:
            self._problem.scale = dict(start._problem.scale)
            if not start.sensor.kind and self.sensor.kind:
                self._problem.weigh(self._evaluate(self._x)[0])

    @property
    def with_delay(self) -> tuple[str, ...]:
        """Free parameters if the sensor may have a delay, too."""
        return tuple(sorted({*self.free, "delay"})) if self.sensor.kind and "delay" not in self._of._declared else self.free

    @property
    def delayed(self) -> bool:
        """Whether a mark or an encoder, which have no delay, gets one: before 0, the thrust is late."""
        return self.sensor.kind in (MARK, ENCODER) and "delay" in self.free

    @property
    def reads_ahead(self) -> bool:
        """Whether the sensor's delay is below zero by more than its uncertainty: no sensor reads a future speed, so the offset
        is wrong."""
        return -self.sensor.delay > max(SIGNIFICANT * self.estimate("delay")[1], self.unknown_instant)

    def solved(self, limits: Sequence[int]) -> "_SensorFit":
        """Fit in rounds with `limits` of evaluations; after each round, the channels are weighted by their residuals."""
        for limit in limits:
            found = solve(self._evaluate, self._x, self._lower, self._upper, CLOSE, limit)
            self._x, self._solution = found.value, found
            self._problem.weigh(found.residual)
        self.sensor = self._sensor_at(self._x)
        self.values = self._problem.values | self._problem.coordinates.values(self._whole(self._x))
        problem = self._with(self.sensor)
        self._thrust = -sum(e.sizes["thrust"] for e in problem.experiments) * float(np.log(problem.scale["thrust"]))
        outputs = problem.outputs(self.values)
        readings = [(t, y[:, 1]) for e, y in zip(problem.experiments, outputs, strict=True) for t in e.tachometers]
        self.speed = {
            (k, row): pair
            for k, (t, omega) in enumerate(readings)
            for row, *pair in zip(t.rows.tolist(), (t.shows(omega) - t.measured).tolist(), t.std.tolist(), strict=True)
        }
        return self

    def _whole(self, x: np.ndarray) -> np.ndarray:
        """Coordinates of the problem from those of the search."""
        own = np.empty(self._count)
        own[self._kept] = x[: len(self._kept)]
        if self._tied:
            own[self._tied[0]] = x[self._tied[1]]
        return own

    @property
    def unknown_instant(self) -> float:
        """Half the time span within which the instant of a value is unknown, s."""
        return max((t.unknown for e in self._with(self.sensor).experiments for t in e.tachometers), default=0.0)

    def _with(self, sensor: SpeedSensor) -> Problem:
        if not self.free:
            return self._problem
        experiments = [e.measured_by(sensor) for e in self._experiments]
        found = Problem(self._of._model, experiments, self._start, self._names, slow_first=self._of.slow_first)
        found.scale = self._problem.scale
        return found

    def _sensor_at(self, x: np.ndarray) -> SpeedSensor:
        return replace(self._sensor, **dict(zip(self.free, x[len(self._kept) :].tolist(), strict=True)))

    def _evaluate(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        own, sensor = self._whole(x), self._sensor_at(x)
        problem = self._with(sensor)
        residual, jacobian = problem.evaluate(own)
        if self._tied:
            jacobian[:, self._kept[self._tied[1]]] += jacobian[:, self._tied[0]]
        jacobian = jacobian[:, self._kept]
        if not self.free:
            return residual, jacobian
        outputs = problem.outputs(problem.values | problem.coordinates.values(own))
        first = sum(e.sizes["thrust"] for e in problem.experiments)
        further, step = np.zeros((len(residual), len(self.free))), NUDGE * self._of._period
        for k, name in enumerate(self.free):
            moved = replace(sensor, **{name: getattr(sensor, name) + step})
            with_speed = [(e, y) for e, y in zip(problem.experiments, outputs, strict=True) if len(e.omega_time)]
            other = [e.measured_by(moved).omega_residual(y[:, 1]) for e, y in with_speed]
            further[first:, k] = (np.concatenate(other) / problem.scale["omega"] - residual[first:]) / step
        return residual, np.column_stack([jacobian, further])

    def score(self, rows: Sequence[tuple[int, int]], groups: np.ndarray) -> float:
        """Penalised log-likelihood with unknown noise variances. That of the speed is on `rows` (record, row), with one
        variance in each of their `groups`: uncertainties of a sensor are right up to a factor that depends on acceleration."""
        count = len(self._x) * 0.5 * float(np.log(max(len(rows), len(self._problem.blocks[0].time))))
        total = self._thrust + self.renewed - count
        if not rows:
            return total
        error, std = np.array([self.speed[row] for row in rows]).T
        sizes, squares = np.bincount(groups), np.bincount(groups, (error / std) ** 2)
        return total - float(np.sum(np.log(std)) + 0.5 * np.sum(sizes * np.log(squares / sizes)))

    @property
    def offset(self) -> "_Delay":
        """The offset of a fit with one offset."""
        return self.late(*self._of._delays[:1])

    @property
    def is_late(self) -> bool:
        """Whether the offset exceeds that of a logger by more than its uncertainty."""
        return self.offset.exceeds(LATEST_ROW * self._of._period)

    def worse_than(self, other: "_SensorFit") -> bool:
        """Whether the evidence for another fit is very strong, and that of the thrust is not very strong against it. The model
        of a speed sensor is approximate: a better fit of the speed is no reason to fit the thrust worse."""
        own, its = _scores([self, other], groups=1)
        return its - own > EVIDENCE and other._thrust > self._thrust - EVIDENCE

    def fits_thrust_better_than(self, other: "_SensorFit") -> bool:
        """Whether the thrust alone distinguishes this fit from another one of as many parameters or more. The model of a speed
        sensor is approximate, and a wrong one shifts the thrust."""
        return len(self.free) <= len(other.free) and self._thrust > other._thrust + NOT_DISTINGUISHED

    def estimate(self, *names: str) -> tuple[float, float]:
        """(sum of parameters, its standard error) under white noise; tied delays have the name of the first."""
        every = [*(self._problem.coordinates.names[k] for k in self._kept), *self.free]
        values = self.values | {n: getattr(self.sensor, n) for n in ("delay", "filter")}
        free = [k for k, active in enumerate(self._solution.active) if not active]
        jacobian = self._solution.jacobian[:, free]
        inverse = np.linalg.pinv(jacobian.T @ jacobian, hermitian=True)
        at = [free.index(every.index(n)) for n in names if n in every and every.index(n) in free]
        return sum(values[n] for n in names), float(np.sqrt(inverse[np.ix_(at, at)].sum()))

    def late(self, *names: str, unknown: float = 0.0) -> "_Delay":
        """The sum of delays, minus the shift of the records."""
        value, std = self.estimate(*names)
        return _Delay(value - EARLIEST * self._of._period, std, unknown)

    def shared(self) -> "_Delay":
        """The common part of the delays, of a fit in which each command has a separate delay."""
        thrust = {u: self.late(f"{name}.delay") for u, name in DELAYS.items() if f"{name}.delay" in self._names}
        if not self.sensor.kind or "omega" not in thrust:
            return _offset(thrust, None)
        reading = self.late(SPEED_DELAY, "delay", unknown=self.unknown_instant)
        return _offset(thrust, reading, self.sensor.kind, LATEST_ROW * self._of._period)


@dataclass(frozen=True)
class _Delay:
    """A delay [s] from a command to a reading, its standard error, and half the time span within which the instant of the
    reading is `unknown`."""

    value: float
    std: float
    unknown: float = 0.0

    def rows(self, period: float) -> tuple[float, float]:
        """(value, standard error) in rows."""
        return self.value / period, self.std / period

    def differs_from(self, value: float) -> bool:
        return abs(self.value - value) > SIGNIFICANT * self.std + self.unknown

    def exceeds(self, value: float) -> bool:
        """Whether it is later than a value by more than its uncertainty."""
        return self.value - SIGNIFICANT * self.std > value

    @property
    def leads(self) -> bool:
        """Whether the reading comes before the command acts."""
        return self.value < 0.0 and self.differs_from(0.0)

    def agrees_with(self, other: "_Delay") -> bool:
        return (
            abs(self.value - other.value) <= SIGNIFICANT * float(np.hypot(self.std, other.std)) + self.unknown + other.unknown
        )

    def with_(self, other: "_Delay") -> "_Delay":
        """Mean, weighted by precision."""
        a, b = (1.0 / (one.std + one.unknown + 1e-9) ** 2 for one in (self, other))
        return _Delay((a * self.value + b * other.value) / (a + b), float(1.0 / np.sqrt(a + b)))


NONE = _Delay(0.0, 0.0)


def _offset(thrust: Mapping[str, _Delay], reading: _Delay | None, kind: str = "", latest: float = 0.0) -> _Delay:
    """The common part of the delays of `thrust`, by commanded channel, and of the speed `reading`.

    A logger shifts all delays alike, up to the `latest`. A rig increases one of them; an overshoot of the thrust decreases it.
    Marks and encoders have a negligible delay. Telemetry may have any: with it, the two delays of the thrust must agree.
    """
    own = list(thrust.values())
    if reading is None or kind == TELEMETRY:
        if len(own) == 1:
            return own[0] if own[0].value < 0.0 and reading is None else NONE
        if len(own) < 2 or not own[0].agrees_with(own[1]):
            return NONE
        shared = own[0].with_(own[1])
        return (
            shared if reading is None or shared.value < reading.value + reading.unknown or shared.agrees_with(reading) else NONE
        )
    speed, pitch, early = thrust["omega"], thrust.get("beta"), reading.leads
    if not reading.agrees_with(speed):
        return reading if early else NONE
    shared = reading.with_(speed)
    if pitch is not None and pitch.agrees_with(shared):
        return shared.with_(pitch)
    smallest = pitch is not None and 0.0 < shared.value < pitch.value and not shared.exceeds(latest)
    return shared if early or smallest else NONE


def _scores(fits: Sequence[_SensorFit], groups: int = GROUPS) -> list[float]:
    """Score of each fit, on the rows at which all of them have a reading, with a variance in each of so many groups of rows."""
    rows = sorted(set.intersection(*(set(f.speed) for f in fits)))
    spread = np.array([np.sum([np.log(f.speed[row][1]) for f in fits]) for row in rows])
    limits = np.quantile(spread, np.arange(1, groups) / groups) if rows else np.zeros(0)
    _, group = np.unique(np.searchsorted(limits, spread), return_inverse=True)
    return [f.score(rows, group) for f in fits]


def _as_modelled(record: Record) -> Record:
    moves = [np.flatnonzero(np.diff(record[f"{u}_ref"]))[:ENOUGH_MOVES] for u in DELAYS]
    return record.part(slice(0, max(ENOUGH_ROWS, *(int(rows.max(initial=0)) + 1 for rows in moves)))).commands_later(-EARLIEST)


def _split(record: Record) -> Record:
    """The record with each row split into rows of at most SPLIT s; the new ones have no readings. Speed is interpolated by
    parabolas between rows; in a slow log this error exceeds the sensor's."""
    parts = int(np.ceil(record.period / SPLIT - 1e-9))
    if parts == 1:
        return record
    count = parts * (len(record) - 1) + 1
    columns = {"time": np.interp(np.arange(count) / parts, np.arange(len(record)), record.time)}
    for name in ("omega_ref", "beta_ref"):
        if name in record:
            columns[name] = np.repeat(record[name], parts)[:count]
    for name in ("omega", "thrust"):
        if name in record:
            columns[name] = np.full(count, np.nan)
            columns[name][::parts] = record[name]
    return replace(record, columns=columns, late=0.0).commands_later(parts * record.late)
