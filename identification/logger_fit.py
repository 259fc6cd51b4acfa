"""Estimate the logger of a campaign: the offset of readings to commands, and the kind of speed sensor.

The contract's logger reads, then commands, in each row. Others command first, write what the last loop read, or log a command a
row late. All of that is one number: the rows by which a command acts later than the readings of its row. It is estimated
together with the base model and a speed sensor, by maximum likelihood over the kinds of sensor.

Effects of a rig make its response later, never earlier. So of three delays, from each command to the thrust and from the speed
command to the measured speed, the least is the logger's; what the others have beyond it is the sensor's or the rig's.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from identification.fit.coordinates import slowest
from identification.fit.experiment import Experiment
from identification.fit.least_squares import solve
from identification.fit.noise import independent
from identification.fit.problem import Problem
from identification.gate.gate import Passed, passed
from identification.logger import FINEST, SIGNIFICANT, Logger
from identification.roles import Fitted, roles
from identification.run_in import BLOCKS, run_in
from vpp_fmu.campaign import Campaign
from vpp_fmu.kernel.plant import AVERAGED, FINE_TUNED, LIBRARY, plant, sized
from vpp_fmu.kernel.types import Effect
from vpp_fmu.native import Simulator
from vpp_fmu.record import Record
from vpp_fmu.rig import infer_rig
from vpp_fmu.sensors import ENCODER, MARK, TELEMETRY, SpeedSensor

EARLIEST = 3
"""Rows by which readings may lead their commands, at most."""

ROUNDS, QUARTER = 4, 0.25
"""Fits in which run-ins are looked for, at most, and the share of a record that the first of them leaves out, at most."""

MARKS = (1, 2, 3, 4)
"""Pulses of a revolution that are tried."""

EVIDENCE = 5.0
"""Penalised log-likelihood (half a BIC difference) by which a sensor of more parameters, or another logger, must be better
(Kass and Raftery, 1995: very strong)."""

MOST_ROWS = 30_000
"""Rows of a record that are used: enough for a hundredth of a row."""

FAST = 3.0
"""Digits by which two values of a moving speed differ, at least."""

STRAY = 0.01
"""Share of intervals between two new values that may be of any length."""

ROUGH, FULL = (3, 3), (12, 12, 30)
"""Evaluations in each round of a fit that ranks a sensor, and of one that estimates."""

NEAR = 100.0
"""Log-likelihood within which a rough fit may still be the best one."""

CLOSE = 1e-9
"""Share of the cost that ends a fit."""

NUDGE = 0.02
"""Share of a row by which a sensor's times are moved for a derivative."""

LATEST = 0.3
"""s: delay and filter of a speed sensor, at most."""

FILTER = 0.02
"""s: filter of a telemetry from which a fit starts."""

FRESH = 1.05
"""Rows between two new values, in the mean, above which they are renewed at an interval that shows."""

DELAYS = {"omega": "speed_delay", "beta": "pitch_delay"}


def as_logged(gate: Passed, effects: Iterable[str] = (), library: Iterable[Effect] = LIBRARY, values=None) -> Passed:
    """What passed the gate, its records as their logger took them, without their run-ins. Estimated beside `effects` of a
    `library` at `values`, from the fitted records; without any, the logger is the contract's, and no start is judged."""
    campaign, declared = gate.campaign, gate.campaign.rig.sensor
    if not any((campaign.open_loop, campaign.repeat, campaign.validation, *gate.further.values())):
        found = Logger(sensor=SpeedSensor(**declared) if "kind" in declared else SpeedSensor())
        return replace(gate.changed(found.applied), logger=found)
    values = {**AVERAGED, **(values or {})}
    longest = 0.5 * BLOCKS * slowest(values, values)
    settled = gate.without_run_ins(lambda record: min(longest, QUARTER * float(record.time[-1])))
    for _ in range(ROUNDS):  # wrong lags may explain a run-in: the first fit leaves the start of every record out
        groups, _ = roles(settled.campaign, settled.further)
        of = _Estimate(groups, campaign.rig.scales, declared, effects, library, values)
        values = of.values
        before, settled = settled, gate.without_run_ins(of.run_in)
        if {(f.code, f.where) for f in settled.findings} == {(f.code, f.where) for f in before.findings}:
            break
    found = of.logger()
    return replace(settled.changed(found.applied), logger=found)


def mended(record: Record) -> tuple[Record, list[str]]:
    """(the record with its commands shifted by whole rows to where they acted, what was done in words). BadInput where the gate
    refuses the record."""
    campaign = Campaign(Path("."), None, (), record, None, None, rig=infer_rig([record], None, {}))
    logger = as_logged(passed(campaign)).logger
    rows = round(logger.rows)
    if not rows:
        return record, ["mend: no shift of the commands by a whole row"]
    way = "down" if rows > 0 else "up"
    told = f"mend: commands shifted {way} by {abs(rows)} row{'s' * (abs(rows) > 1)}: {logger.lines[0]}"
    return record.commands_later(rows), [told]


class _Estimate:
    def __init__(self, groups: Sequence[Sequence[Fitted]], scales, declared, effects, library, values):
        effects = [e for e in effects if e not in DELAYS.values()]
        library = tuple(library)
        delays = (e for e in LIBRARY if e.name in DELAYS.values() and e.name not in {known.name for known in library})
        self._model = plant([*effects, *DELAYS.values()], sized((*library, *delays), scales))
        self._groups = [[Fitted(one.name, _as_modelled(one.record)) for one in group] for group in groups]
        self._first, self._declared = self._groups[0][0].record, declared
        self._period = self._first.period
        moves = {u: any(np.ptp(g[0].record[f"{u}_ref"]) > 0.0 for g in groups) for u in DELAYS}
        own = [e.full(p.name) for e in self._model.effects if e.name in effects for p in e.parameters if not p.choices]
        delays = [f"{name}.delay" for u, name in DELAYS.items() if moves[u]]
        lags = [f"tau_{u}_{k}" for u in DELAYS if moves[u] for k in (1, 2)]
        self._names = [n for n in FINE_TUNED if not n.startswith("tau_") or n in lags] + own + delays
        start = {f"{name}.delay": EARLIEST * self._period for name in DELAYS.values()}
        known = {p.name for p in self._model.parameters}
        start = self._model.values({n: v for n, v in {**values, **start}.items() if n in known})
        noise = independent(start["thrust_scale"])
        self._experiments = [Experiment(group, noise) for group in self._groups]
        self._thrust_alone = [Experiment(group, noise, channels=("thrust",)) for group in self._groups]
        self._measured = any(len(e.omega_time) for e in self._experiments)
        # Delays that are free from the start take the place of lags.
        base = Problem(self._model, self._thrust_alone, start, [n for n in self._names if n not in delays])
        self.values = start | base.coordinates.values(base.fit(start).value)

    def run_in(self, record: Record) -> float:
        """s at the record's start that its initial state takes to die away."""
        shown = _as_modelled(record)
        outputs = Simulator(self._model).simulate(self.values, *shown.run)
        return run_in(shown, outputs, slowest(self.values, self._names))

    def logger(self) -> Logger:
        """The most likely one. Every sensor is fitted roughly, from the fit to the thrust alone, then the best ones in full."""
        thrust = _SensorFit(self, None, ())
        thrust.solve(FULL)
        if not self._measured:
            return self._decided(thrust)
        fits = [_SensorFit(self, sensor, free, thrust, score) for sensor, free, score in self._hypotheses()]
        for fit in fits:
            fit.solve(ROUGH)
        scores = _scores(fits)
        near = [fit for fit, score in zip(fits, scores, strict=True) if score > max(scores) - NEAR]
        for fit in near:
            fit.solve(FULL)
        return self._decided(max(zip(near, _scores(near), strict=True), key=lambda pair: pair[1])[0])

    def _decided(self, fit: "_SensorFit") -> Logger:
        """The logger that a fit's delays show."""
        late = {u: self._late(fit, f"{name}.delay") for u, name in DELAYS.items() if f"{name}.delay" in self._names}
        reading = None
        if fit.sensor.kind and "omega" in late:
            own = ["speed_delay.delay", *(["delay"] if "delay" in fit.free else [])]
            reading = self._late(fit, *own, unknown=fit.unknown_instant)
        offset = _offset(late, reading, fit.sensor.kind)
        rows, std = (value / self._period for value in (offset.value, offset.std))
        near = max(SIGNIFICANT * std, FINEST)
        rows = next((value for value in (0.0, float(round(rows))) if abs(rows - value) < near), rows)
        sensor = fit.sensor
        if reading is not None and "delay" in fit.free:
            delay, delay_std = fit.estimate("delay")
            over = reading.value - rows * self._period
            delay = min(delay, over, key=abs) if abs(delay - over) > SIGNIFICANT * delay_std else delay
            sensor = replace(sensor, delay=delay if abs(delay) > SIGNIFICANT * delay_std else 0.0)
        stds = {name: fit.estimate(name)[1] for name in fit.free}
        return Logger(rows, std, sensor, stds, self._period)

    def _late(self, fit: "_SensorFit", *names: str, unknown: float = 0.0) -> "_Late":
        value, std = fit.estimate(*names)
        return _Late(value - EARLIEST * self._period, std, unknown)

    def _hypotheses(self) -> list[tuple[SpeedSensor, tuple[str, ...], float]]:
        """(sensor, which of its numbers are free, log-likelihood of the rows at which its values were renewed)."""
        declared = self._declared
        rows, turn = renewals(self._first)
        usual = float(rows.mean()) if len(rows) else 1.0
        refresh = usual * self._period if usual > FRESH else 0.0
        kinds = [declared["kind"]] if "kind" in declared else [MARK, ENCODER, TELEMETRY]
        marks = [declared["marks_per_revolution"]] if "marks_per_revolution" in declared else MARKS
        every = [SpeedSensor(kind, n) for kind in kinds for n in (marks if kind == MARK else (1,))]
        known = {k: v for k, v in declared.items() if k in ("filter", "refresh", "delay")}
        found = []
        for sensor in every:
            expected = {MARK: turn / sensor.marks_per_revolution, ENCODER: 1.0, TELEMETRY: usual}[sensor.kind]
            free = {"delay", "filter"} if sensor.kind == TELEMETRY else {"delay"}
            start = {"refresh": refresh, "filter": FILTER} if sensor.kind == TELEMETRY else {}
            found.append(
                (replace(sensor, **{**start, **known}), tuple(sorted(free - set(known))), renewal_score(rows, expected))
            )
        best = max(score for *_, score in found)
        return [one for one in found if one[-1] > best - NEAR]


class _SensorFit:
    """The base model and the delays, fitted with one kind of sensor, whose `free` numbers are parameters too. `sensor` None: to
    the thrust alone."""

    def __init__(
        self,
        of: _Estimate,
        sensor: SpeedSensor | None,
        free: tuple[str, ...],
        start: "_SensorFit | None" = None,
        renewed: float = 0.0,
    ):
        self._of, self.free, self.sensor, self._renewed = of, free, sensor or SpeedSensor(), renewed
        self._experiments = of._experiments if sensor else of._thrust_alone
        self._problem = Problem(of._model, self._experiments, of.values, of._names)
        c = self._problem.coordinates
        self._count, self._sensor = len(c.names), self.sensor
        earliest = -of._period if self.sensor.kind == TELEMETRY else -LATEST
        limits = {"delay": (earliest, LATEST), "filter": (0.1 * of._period, LATEST)}
        self._lower, self._upper = (np.append(x, [limits[n][k] for n in free]) for k, x in enumerate((c.lower, c.upper)))
        own = c.vector(of.values) if start is None else start._x
        self._x = np.append(own, [getattr(self.sensor, n) for n in free])
        if start is not None:
            self._problem.scale["thrust"] = start._problem.scale["thrust"]
            residual, _ = self._evaluate(self._x)
            self._problem.weigh(residual)

    def solve(self, limits: Sequence[int]) -> None:
        """Fit in rounds of so many evaluations, the channels weighed by what each round leaves."""
        for limit in limits:
            found = solve(self._evaluate, self._x, self._lower, self._upper, CLOSE, limit)
            self._x, self._solution = found.value, found
            self._problem.weigh(found.residual)
        self.sensor = self._sensor_at(self._x)
        self._values = self._problem.values | self._problem.coordinates.values(self._x[: self._count])
        problem = self._with(self.sensor)
        self._thrust = -sum(e.sizes["thrust"] for e in problem.experiments) * float(np.log(problem.scale["thrust"]))
        readings = [
            (t, y[:, 1]) for e, y in zip(problem.experiments, problem.outputs(self._values), strict=True) for t in e.tachometers
        ]
        self.speed = {
            (k, row): pair
            for k, (t, omega) in enumerate(readings)
            for row, *pair in zip(t.rows.tolist(), (t.shows(omega) - t.measured).tolist(), t.std.tolist(), strict=True)
        }

    @property
    def unknown_instant(self) -> float:
        """s: half the time within which the instant of a value is not known."""
        return {MARK: 0.5, TELEMETRY: 0.5}.get(self.sensor.kind, 0.0) * self._of._period

    def _with(self, sensor: SpeedSensor) -> Problem:
        if not self.free:
            return self._problem
        found = Problem(self._of._model, [e.measured_by(sensor) for e in self._experiments], self._of.values, self._of._names)
        found.scale = self._problem.scale
        return found

    def _sensor_at(self, x: np.ndarray) -> SpeedSensor:
        return replace(self._sensor, **dict(zip(self.free, x[self._count :].tolist(), strict=True)))

    def _evaluate(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        own, sensor = x[: self._count], self._sensor_at(x)
        problem = self._with(sensor)
        residual, jacobian = problem.evaluate(own)
        if not self.free:
            return residual, jacobian
        outputs = problem.outputs(problem.values | problem.coordinates.values(own))
        first = sum(e.sizes["thrust"] for e in problem.experiments)
        further, step = np.zeros((len(residual), len(self.free))), NUDGE * self._of._period
        for k, name in enumerate(self.free):
            moved = replace(sensor, **{name: getattr(sensor, name) + step})
            other = [e.measured_by(moved).omega_residual(y[:, 1]) for e, y in zip(problem.experiments, outputs, strict=True)]
            further[first:, k] = (np.concatenate(other) / problem.scale["omega"] - residual[first:]) / step
        return residual, np.column_stack([jacobian, further])

    def score(self, rows: Sequence[tuple[int, int]]) -> float:
        """Penalised log-likelihood, of the speed on these `rows` (record, row), the noise's variances unknown."""
        error, std = np.array([self.speed[row] for row in rows]).T
        scale = float(np.sqrt(np.mean((error / std) ** 2)))
        return (
            self._thrust + self._renewed - float(np.sum(np.log(std * scale))) - 0.5 * len(self.free) * float(np.log(len(rows)))
        )

    def estimate(self, *names: str) -> tuple[float, float]:
        """(sum of parameters, its standard error) under white noise."""
        every = [*self._problem.coordinates.names, *self.free]
        values = self._values | {n: getattr(self.sensor, n) for n in self.free}
        free = [k for k, active in enumerate(self._solution.active) if not active]
        jacobian = self._solution.jacobian[:, free]
        inverse = np.linalg.pinv(jacobian.T @ jacobian, hermitian=True)
        at = [free.index(every.index(n)) for n in names if every.index(n) in free]
        return sum(values[n] for n in names), float(np.sqrt(inverse[np.ix_(at, at)].sum()))


@dataclass(frozen=True)
class _Late:
    """A delay [s] from a command to a reading, its standard error, and how much more or less of it may be the instant of the
    reading, which is not `known`."""

    value: float
    std: float
    unknown: float = 0.0

    def differs_from(self, value: float) -> bool:
        return abs(self.value - value) > SIGNIFICANT * self.std + self.unknown

    def agrees_with(self, other: "_Late") -> bool:
        return (
            abs(self.value - other.value) <= SIGNIFICANT * float(np.hypot(self.std, other.std)) + self.unknown + other.unknown
        )

    def with_(self, other: "_Late") -> "_Late":
        """The mean, weighed by precision."""
        a, b = (1.0 / (one.std + one.unknown + 1e-9) ** 2 for one in (self, other))
        return _Late((a * self.value + b * other.value) / (a + b), float(1.0 / np.sqrt(a + b)))


NONE = _Late(0.0, 0.0)


def _offset(thrust: Mapping[str, _Late], reading: _Late | None, kind: str) -> _Late:
    """What the delays of thrust, by commanded channel, and of the speed's `reading` share.

    A logger moves all of them alike. A rig makes one of them later, and an overshoot of the thrust makes it earlier. A mark or
    an encoder has no delay to speak of, telemetry may have any: there the two channels of thrust must agree.
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
    if not reading.differs_from(0.0):
        return NONE
    speed, pitch = thrust["omega"], thrust.get("beta")
    shared = reading.with_(speed) if reading.agrees_with(speed) else reading
    if shared.value < 0.0:
        return shared
    agreed = shared is not reading and pitch is not None and pitch.agrees_with(shared)
    return shared.with_(pitch) if agreed else NONE


def _scores(fits: Sequence[_SensorFit]) -> list[float]:
    """Of each fit, on the rows of which all have a reading."""
    rows = sorted(set.intersection(*(set(f.speed) for f in fits)))
    return [f.score(rows) for f in fits]


def _as_modelled(record: Record) -> Record:
    return record.part(slice(0, MOST_ROWS)).commands_later(-EARLIEST)


def renewals(record: Record) -> tuple[np.ndarray, np.ndarray]:
    """((intervals,) rows from one new value of the speed to the next, (intervals,) the rows that a revolution takes) between
    values that each differ from the one before by FAST digits or more: equal ones in between are then the same value."""
    shown = np.where(np.isfinite(record["omega"]), record["omega"], 0.0)
    changes = np.append(0.0, np.abs(np.diff(shown)))
    new = np.flatnonzero(changes > 0.0)
    clear = changes[new] >= FAST * float(np.min(changes[new], initial=np.inf))
    kept = clear[1:] & clear[:-1] & (shown[new[1:]] > 0.0)
    return np.diff(new)[kept], 60.0 / (shown[new[1:]][kept] * record.period)


def renewal_score(rows: np.ndarray, expected: np.ndarray | float) -> float:
    """Log-likelihood of intervals (n,) in whole rows between new values that come `expected` rows apart, at any phase."""
    away = np.abs(rows - np.maximum(expected, 1.0))
    return float(np.sum(np.log(np.maximum(1.0 - away, STRAY))))
