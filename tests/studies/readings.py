"""python -m tests.studies readings: does the diagnosis distinguish delays of a logger from those of the rotor?

The emulator of the diagnosis study (rig.py) runs continuously; a logger of 10 to 100 rows a second, even or uneven, sets the
commands and writes the rows. Hidden in turn, and together: rows with readings from a share of a row earlier (`age`), a load
cell that is read late, a motor that is late. A record determines only three lags of these: from the speed's command to the
speed reading, from there to the thrust reading, from the pitch's command to the thrust reading. A case is `right` if its names
are right, `family` if they are in a family that the diagnosis does not distinguish, and `same` if other names give all three
lags within CLOSE. Otherwise it has `missed` a name or is `wrong`: it has a false name or a false "something is missing".
"""

import itertools
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from identification.diagnose.diagnose import diagnose
from vpp_fmu.app.report.summary import artefact
from vpp_fmu.campaign import Campaign
from vpp_fmu.kernel.plant import LIBRARY
from vpp_fmu.record import Record
from vpp_fmu.rig import infer_rig
from vpp_fmu.sensors import MARK

from .command_sequences import Clock, open_loop
from .noise import LSB, SHARE, Noise
from .physics import PAPER, Frame, run
from .rig import SIZES

FINE = 0.001
"""s between samples of the rig: rows are whole multiples of it."""

UNEVEN = 0.5
"""Largest share by which an uneven row is longer or shorter than the usual one."""

RATES = (100.0, 50.0, 25.0, 10.0)
"""Hz."""

LATE, MOTOR = 0.03, 0.04
"""Delays of the load cell's reading and of the motor, s."""

AGES = (0.5, 1.0)
"""Ages of the readings in rows."""

LAGS = ("motor and row", "thrust after speed", "pitch and row")
CLOSE = 2.0
"""ms within which lags count as the same."""

NAMES = ("row_clock", "reading_delay", "speed_delay")
RIVALS = (*NAMES, "speed_reading_delay", "pitch_delay", "sensor_lag", "speed_asymmetry", "start_from_rest")
SOME = tuple(e for e in LIBRARY if e.off is None or e.name in RIVALS)
"""Effects that a late reading may be confused with; --whole allows the whole library."""


@dataclass(frozen=True)
class Logged:
    """One case: `rate` Hz of the rows, `even` or not, `age` rows, `late` and `motor` s; 0: absent."""

    rate: float
    even: bool
    age: float = 0.0
    late: float = 0.0
    motor: float = 0.0
    seconds: float = 60.0

    @property
    def name(self) -> str:
        """Name in the table."""
        parts = [f"{self.age:g} rows"] * bool(self.age) + [f"read {1e3 * self.late:g} ms late"] * bool(self.late)
        parts += [f"motor {1e3 * self.motor:g} ms late"] * bool(self.motor)
        return f"{self.rate:g} Hz {'even' if self.even else 'uneven'}, {', '.join(parts) or 'nothing'}"

    @property
    def hidden(self) -> set[str]:
        """The hidden effects."""
        return {name for name, size in zip(NAMES, (self.age, self.late, self.motor), strict=True) if size}

    @property
    def lags(self) -> np.ndarray:
        """(3,) ms, as LAGS."""
        row = self.age / self.rate
        return 1e3 * np.array([self.motor + row, self.late, self.late + row])

    def campaign(self, seed: int = 0) -> Campaign:
        """An open-loop record and a validation record."""
        one, other = (self.record(np.random.default_rng([seed, k]), name) for k, name in enumerate(("open_loop", "validation")))
        # Rows slower than a revolution do not determine the kind of sensor, so it is declared.
        rig = infer_rig([one], None, SIZES["paper"].declared | {"sensor": {"kind": MARK, "marks_per_revolution": 1}})
        return Campaign(Path("logged"), None, (), one, None, other, rig=rig)

    def record(self, rng: np.random.Generator, name: str) -> Record:
        """The logger's record of the rig; commands change only at a row."""
        size, row = SIZES["paper"], 1.0 / self.rate
        w, b = open_loop(rng, Clock(row, 1.0), self.seconds)
        speed, pitch = size.commands(w, b)
        spread = np.zeros(len(w)) if self.even else UNEVEN * rng.uniform(-1.0, 1.0, len(w))
        fine = np.maximum(1, np.round(row * (1.0 + spread) / FINE)).astype(int)
        at = np.cumsum(fine) - fine
        settings = {**PAPER, "reading_delay": self.late, "speed_delay": self.motor}
        found = run(settings, Frame(FINE, 1e-4, 1.0, size.speed), *size.shares(np.repeat(speed, fine), np.repeat(pitch, fine)))
        read = np.maximum(at - self.age * np.append(fine[0], fine[:-1]), 0.0)
        force = size.thrust * np.interp(read, np.arange(len(found.load)), found.load)
        noise = Noise("white", SHARE * size.thrust, row, 1.0, LSB * size.thrust)
        columns = {"time": np.round(at * FINE, 9), "omega_ref": speed, "beta_ref": pitch}
        columns |= {"omega": found.shown[np.floor(read + 1e-9).astype(int)], "thrust": noise.reading(rng, force)}
        return Record(columns, name)


def cases() -> Iterator[Logged]:
    """Row spacings and hidden effects in all combinations."""
    sets = [(age, late, motor) for age in (0.0, *AGES) for late in (0.0, LATE) for motor in (0.0, MOTOR)]
    sets = [s for s in sets if not (s[0] == AGES[1] and all(s[1:]))]
    for rate, even, (age, late, motor) in itertools.product(RATES, (True, False), sets):
        yield Logged(rate, even, age, late, motor)


def outcome(case: Logged, seed: int = 0, library=SOME) -> dict:
    """Result of a diagnosis of the case."""
    began = time.perf_counter()
    campaign = case.campaign(seed)
    found = diagnose(campaign, library, workers=1)
    values, effects = found.final.values, set(found.final.effects) | ({"row_clock"} if found.logger.rows else set())
    row = 1e3 * campaign.open_loop.period * (values.get("row_clock.age", 0.0) + found.logger.rows)
    own = {n: 1e3 * values.get(f"{n}.delay", 0.0) for n in (*NAMES[1:], "speed_reading_delay", "pitch_delay")}
    own["sensor_lag"] = 1e3 * values.get("sensor_lag.time_constant", 0.0)
    shown = own["speed_reading_delay"] + 1e3 * found.logger.sensor.delay
    weighed = own["reading_delay"] + own["sensor_lag"]
    lags = np.array([own["speed_delay"] + shown + row, weighed - shown, own["pitch_delay"] + weighed + row])
    off = lags - case.lags
    named = effects.union(*found.selection.family.values())
    alarm = found.verdict == "unexplained" and not case.hidden
    if effects == case.hidden and not alarm:
        word = "right"
    elif found.verdict == "family" and case.hidden <= named:
        word = "family"
    else:
        same = effects and np.all(np.abs(off) < CLOSE)
        word = "same" if same else "wrong" if alarm or effects - case.hidden else "missed"
    before, after = (found.errors(fit)[0] for fit in (found.base, found.final))
    return {
        "word": word,
        "verdict": found.verdict,
        "effects": sorted(effects),
        "family": {k: v for k, v in found.selection.family.items() if v},
        "logger": found.logger.lines,
        "said": {effect: artefact(found, effect) for effect in found.final.effects},
        "off": off,
        "before": before,
        "after": after,
        "seconds": time.perf_counter() - began,
    }


def main(parser, arguments):
    parser.add_argument("--rates", default=",".join(f"{r:g}" for r in RATES), metavar="A,B", help="Hz, of %(default)s")
    parser.add_argument("--seed", type=int, default=0, metavar="K", help="of commands and noise (default: %(default)s)")
    parser.add_argument("--whole", action="store_true", help="the whole library may be named")
    options = parser.parse_args(arguments)
    rates, rows = [float(r) for r in options.rates.split(",")], []
    for case in cases():
        if case.rate not in rates:
            continue
        found = outcome(case, options.seed, LIBRARY if options.whole else SOME)
        rows.append((case, found))
        lags = ", ".join(f"{o:+.1f}" for o in found["off"])
        other = "".join(f" or {', '.join(v)} for {k}" for k, v in found["family"].items())
        text = f"{found['verdict']}: {', '.join(found['effects']) or 'no effect'}{other}"
        print(
            f"{case.name:55s} {found['word']:7s} {text}; ms off {lags}; {found['before']:.3f} -> {found['after']:.3f} N",
            flush=True,
        )
    print(table(rows))


def table(rows: list[tuple[Logged, dict]]) -> str:
    """Counts of each result by row spacing, and the lags' errors in ms."""
    words = ("right", "family", "same", "missed", "wrong")
    lines = [f"{'':14s}" + "".join(f"{w:>8s}" for w in words) + f"{'median ms off, largest':>26s}"]
    for rate, even in sorted({(c.rate, c.even) for c, _ in rows}):
        own = [found for c, found in rows if (c.rate, c.even) == (rate, even)]
        off = np.abs(np.concatenate([found["off"] for found in own]))
        counts = "".join(f"{sum(f['word'] == w for f in own):8d}" for w in words)
        lines.append(f"{rate:4g} Hz {'even' if even else 'uneven':6s}{counts}{np.median(off):18.2f}, {off.max():.1f}")
    off = np.abs(np.array([found["off"] for _, found in rows]))
    lines.append(f"all {len(rows):3d}       " + "".join(f"{sum(f['word'] == w for _, f in rows):8d}" for w in words))
    lines += [
        f"{name}: median {np.median(o):.2f} ms off, 90 % within {np.quantile(o, 0.9):.1f} ms"
        for name, o in zip(LAGS, off.T, strict=True)
    ]
    return "\n".join(lines)
