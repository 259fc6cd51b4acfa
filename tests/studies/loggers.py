"""python -m tests.studies loggers: does `vpp diagnose` depend on the speed sensor, and on the time at which rows are written?

The emulator of the diagnosis study (rig.c) is read by other speed sensors and loggers (sensors.py). `--part nothing`: rigs
without hidden effects, on which the diagnosis should find none. `hidden`: one effect of the pitch or of the inflow. `pairs`: a
strong slow effect and a weak fast one; the weak one should not be passed over.

An effect counts as detectable if the expected log-likelihood of the true model is 20 nats or more above that of the best base
model. This is half the squared distance, over the noise, of the noise-free readings from those of the same rig without the
effect, with the nine base parameters and the logger's nuisance parameters free (offset of all readings, delay of speed, its
filter if it has one). The uncertainty of speed there is that of one mark a revolution, whatever the sensor. For a pair it is
the log-likelihood of the weak effect, with the strong one known. Each case depends on `--first-seed` and its number alone.
"""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from identification.diagnose.diagnose import diagnose
from identification.diagnose.diagnosis import Diagnosis
from vpp_fmu.campaign import Campaign
from vpp_fmu.record import Record

from . import command_sequences
from .detectable import LIMIT, efficient_errors, evidence
from .hidden_effects import HIDDEN, Draw
from .physics import BASE, in_time
from .rig import SIZES, Files, campaign, random_base
from .rows import add_options, completed
from .scores import NAMED, Column, by_factor, hit, honest, passed_over, share, wrong
from .sensors import Encoder, LoggedRig, Logger, Mark, Telemetry

PARTS = {"nothing": 300, "hidden": 400, "pairs": 100}
"""Default numbers of cases; in `hidden` the effects take turns."""

EFFECTS = ("pitch_command_deadband", "pitch_backlash", "inflow_lag", "pitch_rate_limit")
STRONG = ("thrust_gain_drift", "sensor_drift")
WEAK = ("inflow_lag", "pitch_rate_feedthrough", "pitch_backlash", "pitch_command_deadband")
STRENGTHS = dict.fromkeys(EFFECTS, (0.5, 1.0)) | dict.fromkeys(STRONG, (0.8, 1.0))
STRENGTHS_WEAK = dict(zip(WEAK, ((0.4, 1.0), (0.3, 0.8), (0.0, 0.4), (0.0, 0.4)), strict=True))
"""As in hidden_effects.py, from 0 (least size) to 1. Inflow and feedthrough are weak, so they need more to be detectable."""

LEVELS = {
    "sensor": ("1 mark", "2 marks", "3 marks", "4 marks", "encoder", "telemetry"),
    "rows": ("before", "after", "middle", "mean", "late", "early"),
    "rate": (25, 50, 100, 250, 1000),
    "noise": ("white", "white", "white", "white", "1/f", "quantised"),
    "static": (True, False),
    "steps": (True, False),
    "repeat": (True, False),
    "validation": (True, False),
}
"""Each factor's levels come equally often. Rate in Hz; the files that a campaign may have beside its open-loop record."""

LATE = (0.5, 1.0, 1.5, 2.0)
"""Rows by which a command is logged late or early."""

FILTER, REFRESH = (0.01, 0.05), (0.005, 0.04)
"""Ranges of the filter and of the refresh time of telemetry [s]."""

NOISE = (0.3, 2.0)
"""Range of the noise over SHARE of the rig's thrust, log-uniform."""

SECONDS, SECONDS_FAST = (40.0, 90.0), (30.0, 40.0)
"""s of the open-loop record; the second from 1000 Hz on."""

UNSEEN = 40.0
"""s of the noise-free hold-out record."""

SETTLED = 1.0
"""s on the paper's rig for which the first command of that record is held at its start."""

DRAWS = 1000
"""Draws of an efficient estimator's errors."""

CLOSE = 1.02
"""Thrust error on hold-out data over the noise, up to which the model counts as close to the noise."""

LOGGERS = {"row_clock", "reading_delay", "speed_reading_delay"}
"""Effects of the logger: a name, but no defect of the rig."""


@dataclass(frozen=True)
class Case:
    """One campaign."""

    part: str
    first: int
    number: int

    @property
    def name(self) -> str:
        """Name in files and tables."""
        return f"{self.part} {self.first} {self.number}"

    def random(self, stream: int) -> np.random.Generator:
        """One of the case's random generators."""
        return np.random.default_rng([self.first, [*PARTS].index(self.part), self.number, stream])

    @cached_property
    def factors(self) -> dict:
        """Factors of the campaign. `lag` and `span` of rows, as `sensors.Logger`; `level` of the noise."""
        found = {name: self._balanced(k, levels) for k, (name, levels) in enumerate(LEVELS.items())}
        rng = self.random(0)
        late, within = float(rng.choice(LATE)), float(rng.uniform(0.0, 1.0))
        lags = {"before": 0.0, "after": -within, "middle": -0.5, "mean": -0.5, "late": -late, "early": late}
        found["lag"] = lags[found["rows"]]
        found["span"] = float(found["rows"] == "mean")
        found["level"] = float(np.exp(rng.uniform(*np.log(NOISE))))
        found["seconds"] = float(np.round(rng.uniform(*(SECONDS_FAST if found["rate"] >= 1000 else SECONDS))))
        found["filter"], found["refresh"] = (float(np.round(rng.uniform(*ends), 4)) for ends in (FILTER, REFRESH))
        return found

    def _balanced(self, factor: int, levels: Sequence):
        """Each level once in as many cases as there are levels, in random order."""
        turn, place = divmod(self.number, len(levels))
        rng = np.random.default_rng([self.first, [*PARTS].index(self.part), factor, turn])
        return levels[rng.permutation(len(levels))[place]]

    @property
    def hidden(self) -> tuple[str, ...]:
        """Names of the hidden effects; of a pair the strong one first."""
        if self.part == "pairs":
            return STRONG[self.number % 2], WEAK[self.number // 2 % len(WEAK)]
        return (EFFECTS[self.number % len(EFFECTS)],) if self.part == "hidden" else ()

    @cached_property
    def sizes(self) -> tuple[dict[str, float], ...]:
        """Settings of each hidden effect."""
        rng, strengths = self.random(1), STRENGTHS | (STRENGTHS_WEAK if self.part == "pairs" else {})
        drawn = [HIDDEN[n].draw(Draw(rng, rng.uniform(*strengths[n]))) for n in self.hidden]
        return tuple(in_time(dict(own), self.rig_alone.size.slow) for own in drawn)

    @cached_property
    def rig_alone(self) -> LoggedRig:
        """The rig without its hidden effects."""
        f, rng = self.factors, self.random(2)
        size = SIZES["paper"].drawn(rng)
        kind = f["sensor"]
        marks = {f"{n} mark{'s' * (n > 1)}": Mark(n) for n in range(1, 5)}
        sensor = {"encoder": Encoder(), "telemetry": Telemetry(f["filter"], f["refresh"]), **marks}[kind]
        settings, logger = random_base(rng, size.slow), Logger(f["lag"], f["span"])
        return LoggedRig(settings, size, float(f["rate"]), f["noise"], f["level"], sensor=sensor, logger=logger)

    def with_sizes(self, *sizes: dict[str, float]) -> LoggedRig:
        """The rig with these additional settings."""
        alone = self.rig_alone
        merged = {k: v for own in (alone.settings, *sizes) for k, v in own.items()}
        return replace(alone, settings=merged)

    @property
    def rig(self) -> LoggedRig:
        """The rig with its hidden effects."""
        return self.with_sizes(*self.sizes)

    def measured(self) -> Campaign:
        """The campaign that the diagnosis gets."""
        files = (self.factors[n] for n in ("repeat", "validation", "static", "steps"))
        return campaign(self.rig, self.random(3), Files(self.factors["seconds"], *files))

    def unseen(self) -> tuple[Record, float]:
        """(hold-out record of other commands without noise, the true delay [s] of its speed behind its thrust).

        It begins settled, because a diagnosis leaves out the readings of a rotor that is in motion at the start."""
        rng, rig = self.random(4), self.rig
        rest = rig.clock.rows(SETTLED)
        commands = (np.concatenate([np.full(rest, c[0]), c]) for c in command_sequences.both(rng, rig.clock, UNSEEN))
        read = rig.read(rng, tuple(commands))
        time = np.round(np.arange(len(read.speed)) / rig.rate, 9)
        columns = {"time": time, "omega_ref": read.speed, "beta_ref": read.pitch, "omega": read.omega, "thrust": read.force}
        return Record(columns, "unseen"), read.delay

    def evidence(self, record: Record) -> float:
        """Expected log-likelihood of the true model over the best base model [nats]."""
        if not self.sizes:
            return 0.0
        known = self.sizes[0] if self.part == "pairs" else {}
        alone, f = self.rig_alone, self.factors
        base = {n: alone.settings[n] for n in BASE}
        time_constant = f["filter"] if f["sensor"] == "telemetry" else 0.0
        commands = record["omega_ref"], record["beta_ref"]
        return evidence(self.rig, base, *commands, known, 1 + f["repeat"], sensor_filter=time_constant)

    def reachable(self, measured: Campaign, record: Record, noise: float) -> float:
        """The probability that an efficient estimator, which knows the logger and the sensor, comes CLOSE to the noise [N]."""
        fitted = [measured.open_loop] * (1 + self.factors["repeat"]) + list(measured.steps)
        commands = [(r["omega_ref"], r["beta_ref"]) for r in fitted]
        if (static := measured.static) is not None:
            points = zip(static.omega_ref, static.beta_ref, static.samples, strict=True)
            commands += [(np.full(int(n), speed), np.full(int(n), pitch)) for speed, pitch, n in points]
        draws = self.random(5).standard_normal((DRAWS, len(BASE)))
        errors = efficient_errors(self.rig, commands, (record["omega_ref"], record["beta_ref"]), draws)
        return float(np.mean(np.hypot(errors, noise) <= CLOSE * noise))

    def summary(self) -> dict:
        """Entries of a line of the file."""
        head = {"name": self.name, "kind": self.part, "hidden": list(self.hidden), "equal": {}}
        return head | {"factors": self.factors, "sizes": list(self.sizes)}


def logger_of(found: Diagnosis, rpm: float) -> dict:
    """The logger as diagnosed, s: `lag` of all readings (below 0 they lead), and `delay` of speed behind thrust at `rpm`,
    including the mean over a mark's window; its `sensor` in words."""
    logger, row = found.logger, found.fitted[0].record.period
    sensor, delay = logger.sensor, logger.sensor.filter + logger.sensor.delay
    if sensor.kind == "mark":
        window = 60.0 / (sensor.marks_per_revolution * rpm)
        delay += 0.5 * window + 0.5 * min(row, window)  # its last pulse came at a random time in the row before
    elif sensor.refresh:
        delay += 0.5 * min(row, sensor.refresh)
    return {"lag": logger.offset, "delay": delay, "sensor": f"{sensor.kind} {sensor.marks_per_revolution}"}


def outcome(case: Case) -> dict:
    """Measure the case, diagnose it, compare with the truth."""
    measured = case.measured()
    began = time.perf_counter()
    found = diagnose(measured, workers=1)
    seconds = time.perf_counter() - began
    record, delay = case.unseen()
    noise = float(np.sqrt(case.rig.noise.power(np.fft.rfftfreq(len(record))[1:]).mean()))
    error = found.prediction(found.final, found.logger.applied(record)).rmse_thrust
    row = case.summary() | {"failed": None, "verdict": found.verdict, "effects": list(found.final.effects)}
    row |= {"family": {k: v for k, v in found.selection.family.items() if v}, "seconds": seconds}
    row |= {"over_noise": float(np.hypot(error, noise) / noise), "evidence": case.evidence(measured.open_loop)}
    row |= {} if case.sizes else {"reachable": case.reachable(measured, record, noise)}
    said = logger_of(found, float(record["omega"].mean()))
    true = {"lag": case.factors["lag"] / case.factors["rate"], "delay": delay}
    off = {f"{n}_off": 1e3 * (said[n] - true[n]) for n in true}
    return row | {"logger": said, "true": true} | off


def says_something(row: dict) -> bool:
    """Names nothing, but says that something is missing."""
    return row["verdict"] != "none" and not gives_name(row)


def gives_name(row: dict) -> bool:
    """Adds an effect of the list or a learned one to the model, or names a family of effects."""
    return bool(row["effects"]) or row["verdict"] in (*NAMED, "learned")


def gives_logger(row: dict) -> bool:
    """Names effects, and all of them are the logger's."""
    return bool(row["effects"]) and set(row["effects"]) <= LOGGERS


def close(row: dict) -> bool:
    """The model's thrust error on hold-out data is close to the noise."""
    return row["over_noise"] <= CLOSE


def _verdict(*words: str) -> Callable[[dict], bool]:
    return lambda row: row["verdict"] in words


def _column(head: str, test: Callable[[dict], bool]) -> Column:
    return Column("", head, lambda row: True, test)


_LEARNED, _NONE = _column("learned", _verdict("learned")), _column("none", _verdict("none"))
_CLOSE = _column(f"<= {CLOSE}", close)

COLUMNS = {
    "nothing": (_column("names", gives_name), _column("logger's", gives_logger), _column("missing", says_something), _CLOSE),
    "hidden": (_column("named", hit), _column("wrong", wrong), _LEARNED, _column("open", honest), _NONE, _CLOSE),
    "pairs": (
        *(_column("both", hit), _column("admits", honest), _column("passes", passed_over), _column("wrong", wrong)),
        *(_LEARNED, _NONE, _CLOSE),
    ),
}

FACTORS: dict[str, Callable[[dict], str]] = {
    "all": lambda r: "",
    **{name: lambda r, name=name: str(r["factors"][name]) for name in LEVELS},
    "level": lambda r: "below 0.8" if r["factors"]["level"] < 0.8 else "0.8 and more",
    "hidden": lambda r: " + ".join(r["hidden"]),
}


def table(part: str, found: Sequence[dict]) -> str:
    """Counts by factor over the detectable cases (all if nothing is hidden), errors, seconds, and failures."""
    done = [r for r in found if not r["failed"]]
    judged = [r for r in done if part == "nothing" or r["evidence"] >= LIMIT]
    lines = by_factor(judged, FACTORS, COLUMNS[part])
    lines += [share(f"{part}: {column.head}", column.test, judged) for column in COLUMNS[part]]
    if reachable := [r["reachable"] for r in judged if "reachable" in r]:
        lines.append(f"  of an efficient estimator (Cramer-Rao bound): {np.mean(reachable):.1%} of {len(reachable)}")
    if part != "nothing":
        below = [r for r in done if r["evidence"] < LIMIT]
        lines.append(share("not detectable", lambda r: r in below, done))
        lines.append(share("  of these wrong", wrong, below))
    if done:
        lag, delay = (np.median([abs(r[n]) for r in done]) for n in ("lag_off", "delay_off"))
        seconds = np.array([r["seconds"] for r in done])
        lines.append(f"off in the median: all readings by {lag:.2f} ms, speed behind thrust by {delay:.2f} ms")
        lines.append(f"a diagnosis took {np.median(seconds):.1f} s in the median, {seconds.max():.0f} s at worst")
    lines += [f"FAILED {r['name']}: {r['failed']}" for r in found if r["failed"]]
    return "\n".join(lines)


def line(row: dict) -> str:
    """One case in a line."""
    f = row["factors"]
    files = ", ".join(n for n in ("static", "steps", "repeat", "validation") if f[n]) or "one record"
    like = f"{f['sensor']}, {f['rows']} {f['lag']:+.2f} rows, {f['rate']} Hz, {f['noise']} {f['level']:.2f}, {files}"
    head = f"{row['name']} ({like}) {' + '.join(row['hidden'])}".rstrip()
    if row["failed"]:
        return f"{head}: failed, {row['failed']}"
    names = ", ".join([*row["effects"], *(f"({n})" for other in row["family"].values() for n in other)])
    off = "".join(f", {n} {row[n]:+.2f} ms" for n in ("lag_off", "delay_off") if n in row)
    verdict = f"{row['verdict']} {names}".rstrip()
    return f"{head}: {verdict}; {row['over_noise']:.3f} of the noise{off}, {row['evidence']:.0f} nats, {row['seconds']:.0f} s"


def main(parser, arguments):
    parser.add_argument("--part", choices=PARTS, default="nothing", help="(default: %(default)s)")
    parser.add_argument("--seeds", type=int, metavar="N", help=f"cases (default: {PARTS})")
    parser.add_argument("--only", type=int, metavar="K", help="this case alone")
    add_options(parser, "out/loggers.jsonl")
    options = parser.parse_args(arguments)
    numbers = range(options.seeds or PARTS[options.part]) if options.only is None else [options.only]
    found = completed(options, [Case(options.part, options.first_seed, k) for k in numbers], outcome)
    print("\n".join(line(row) for row in found))
    print(table(options.part, [row for row in found if row["name"].startswith(options.part)]))
