"""python -m tests.studies variation: what does `vpp diagnose` say of a rig that differs from its model in a way of its own?

A second emulator (varied_rig.py) gives the rigs: a battery with an RC network, heating by load, a servo that overshoots, lags
that change as the rig warms up, gusts that no command drives. Each is 2 to 6 times the noise in thrust. Sizes of rig, rates,
noises, sensors and files are drawn; a quarter has no speed reading. The names that count as right are listed before any run.
Each case runs in a separate process and becomes a line of a file as soon as it is done.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.optimize import brentq

from identification.diagnose.learned.learn import NAME as LEARNED
from vpp_fmu.record import Record

from .cases import HALF, Case, Factors
from .command_sequences import open_loop
from .detectable import LIMIT
from .diagnosis import outcome
from .hidden_effects import Draw
from .noise import KINDS as NOISES
from .physics import BASE
from .rig import SIZES, random_base
from .rows import add_options, completed
from .scores import removed, worse
from .sensors import Encoder, Mark, Sensor, Telemetry
from .varied_rig import VariedRig

TIMES = (2.0, 6.0)
"""Range of a variation's size over the noise, log-uniform."""

PEAK = 0.99
"""Quantile of the change of thrust over the open-loop record that counts as its size."""

RATES = (100, 250, 500)
"""Hz."""

SECONDS = (40.0, 120.0)
"""Range of the open-loop record's length, log-uniform."""

SENSORS = (Mark(1), Encoder(), Telemetry(0.02, 0.01), None)
"""Of the speed, in turn; None: it is not measured, and there is no static map, which would have it."""

METERED = (False, True)
"""Whether a battery's voltage is measured, in turn."""


@dataclass(frozen=True)
class Variation:
    """`drawn(Draw)`: what does not depend on the size; `sized(drawn, x)`: settings of size x, from 0, which is none, to `most`.

    `right`: names of it in the list; `related`: names of other physics that these readings hardly distinguish from it.
    """

    drawn: Callable[[Draw], Mapping[str, float]]
    sized: Callable[[Mapping[str, float], float], Mapping[str, float]]
    most: float
    right: tuple[str, ...] = ()
    related: tuple[str, ...] = ()


def _battery(s: Mapping[str, float], x: float) -> dict[str, float]:
    return {"battery_now": (1.0 - s["share"]) * x, "battery_late": s["share"] * x, "battery_time": s["time"]}


def _servo(s: Mapping[str, float], x: float) -> dict[str, float]:
    return {"servo_ratio": float(np.exp(-max(x, 1e-6)))}  # of size 0 it is a double lag, which the model has


HIDDEN = {
    "battery": Variation(
        lambda g: {"share": g.rng.uniform(0.5, 1.0), "time": g.any(0.3, 3.0)},
        _battery,
        0.4,
        right=("supply_sag", "supply_voltage"),
    ),
    "heating": Variation(
        lambda g: {"time": g.any(10.0, 60.0)},
        lambda s, x: {"heating_loss": x, "heating_time": s["time"]},
        0.8,
        right=("thrust_gain_drift",),
        related=("recirculation",),  # thrust falls by a lagged share of itself
    ),
    # Pitch is not measured: a lead of thrust after a move of pitch differs from an overshoot only in its ringing.
    "servo": Variation(lambda g: {}, _servo, 1.8, right=("pitch_overshoot",), related=("inflow_lag", "pitch_rate_feedthrough")),
    "warming": Variation(
        lambda g: {"time": g.any(20.0, 60.0), "pitch": g.one(0.0, 1.0)},
        lambda s, x: {"warming_slower": x, "warming_time": s["time"], "warming_pitch": s["pitch"]},
        4.0,
    ),
    "gusts": Variation(lambda g: {}, lambda s, x: {"gust": x}, 0.6),
}
"""The variations, and what counts as right; two are in no list: warming and gusts."""


@dataclass(frozen=True)
class VariedCase(Case):
    """One rig with the variation `hidden[0]`."""

    @cached_property
    def factors(self) -> Factors:
        """Rates and noises take turns; `strength` has no meaning here."""
        seconds = float(np.round(np.exp(self.random(5).uniform(*np.log(SECONDS)))))
        turn = {"rate": RATES[self.seed % len(RATES)], "noise": NOISES[self.seed % len(NOISES)], "seconds": seconds}
        mapped = {} if self.sensor else {"static": False, "steps": True}
        return replace(super().factors, **(turn | mapped))

    @property
    def sensor(self) -> Sensor | None:
        """The sensor of its speed."""
        return SENSORS[self.seed % len(SENSORS)]

    @property
    def metered(self) -> bool:
        """Whether its voltage is measured."""
        return self.hidden[0] == "battery" and METERED[self.seed // len(SENSORS) % len(METERED)]

    @property
    def times(self) -> float:
        """The wanted size over the noise."""
        return float(np.exp(self.random(6).uniform(*np.log(TIMES))))

    @cached_property
    def x(self) -> float:
        """The variation's size: `times` the noise, or the most if that is less."""
        most = HIDDEN[self.hidden[0]].most
        if self.changed(most) < self.times:
            return most
        return brentq(lambda x: self.changed(x) - self.times, 0.0, most, xtol=1e-4 * most)

    @cached_property
    def rig(self) -> VariedRig:
        """The rig with its variation."""
        return self.at(self.x)

    def at(self, x: float) -> VariedRig:
        """The rig with the variation of size x."""
        f, rng, hidden = self.factors, self.random(1), HIDDEN[self.hidden[0]]
        size = SIZES[f.size].drawn(rng)
        settings = random_base(rng, size.slow) | hidden.sized(hidden.drawn(Draw(self.random(2), HALF)), x)
        return VariedRig(settings, size, float(f.rate), f.noise, f.level, sensor=self.sensor, metered=self.metered)

    def changed(self, x: float) -> float:
        """PEAK of the change of thrust from size 0 to x in the open-loop record, over the noise's standard deviation."""
        rigs = self.at(0.0), self.at(x)
        clock, size = rigs[0].clock, rigs[0].size
        commands = size.shares(*size.commands(*open_loop(self.random(3), clock, self.factors.seconds)))
        without, there = (rig.signals(*commands, self.random(7)).load for rig in rigs)
        noise = np.sqrt(rigs[0].noise.power(np.fft.rfftfreq(len(commands[0]))[1:]).mean())
        return float(np.quantile(np.abs(there - without), PEAK) * size.thrust / noise)

    @property
    def each(self) -> dict[str, dict]:
        """Settings of the variation, by its name."""
        return {self.hidden[0]: {n: v for n, v in self.rig.settings.items() if n not in BASE}}

    def truth(self) -> dict[str, float]:
        """No parameter of the project's has a true value here."""
        return {}

    def behind(self, record: Record, thrust: np.ndarray, omega: np.ndarray) -> float:
        """As `Case.behind`; where speed is not measured, its error does not count."""
        if self.sensor is None:
            omega = self.rig.size.speed * self.rig.run(record["omega_ref"], record["beta_ref"]).omega
        return super().behind(record, thrust, omega)

    def summary(self) -> dict:
        """Entries of a table row."""
        sensor = type(self.sensor).__name__.lower() if self.sensor else "none"
        return super().summary() | {"sensor": sensor, "metered": self.metered, "times": self.changed(self.x)}


def main(parser, arguments):
    parser.add_argument("--seeds", type=int, default=8, metavar="N", help="cases of each variation (default: %(default)s)")
    parser.add_argument("--hide", default=",".join(HIDDEN), metavar="A,B", help="of %(default)s")
    add_options(parser, "out/variation.jsonl")
    options = parser.parse_args(arguments)
    asked = options.hide.split(",")
    if unknown := set(asked) - set(HIDDEN):
        raise SystemExit(f"not known: {', '.join(sorted(unknown))}; known: {', '.join(HIDDEN)}")
    seeds = range(options.first_seed, options.first_seed + options.seeds)
    print(table(completed(options, [VariedCase("variation", (name,), seed) for seed in seeds for name in asked], outcome)))


GROUPS = ("right", "related", "learned", "says so", "wrong", "none", "failed")
"""Of a row: a right name; a related one; a learned term; says that something is missing, and names nothing; a wrong name,
whatever the verdict; says that nothing is missing; not done."""


def group(c: dict) -> str:
    """One of GROUPS."""
    if c["failed"]:
        return "failed"
    hidden, names = HIDDEN[c["hidden"][0]], [{name, *c["family"].get(name, ())} for name in c["effects"] if name != LEARNED]
    if any(not own & {*hidden.right, *hidden.related} for own in names):
        return "wrong"
    if names:
        return "right" if any(own & set(hidden.right) for own in names) else "related"
    if c["verdict"] == "none":
        return "none"
    return "learned" if c["learned"] else "says so"


def table(cases: Sequence[dict]) -> str:
    """A line for each case, then counts by variation."""
    lines = [_line(c) for c in sorted(cases, key=lambda c: (list(HIDDEN).index(c["hidden"][0]), c["seed"]))]
    heads = (*GROUPS, "distinct", "worse", "removed")
    lines += ["", f"{'':10}{'cases':>8}" + "".join(f"{head:>10}" for head in heads)]
    for name in (*HIDDEN, "all"):
        part = [c for c in cases if name in ("all", c["hidden"][0])]
        if not part:
            continue
        counts, done = [sum(group(c) == g for c in part) for g in GROUPS], [c for c in part if not c["failed"]]
        distinct = sum(group(c) == "wrong" and c["behind"] >= LIMIT for c in done)
        gain = f"{np.median([removed(c) for c in done]):.2f}" if done else ""
        numbers = (len(part), *counts, distinct, sum(map(worse, done)))
        lines.append(f"{name:10}{numbers[0]:>8}" + "".join(f"{n:>10}" for n in (*numbers[1:], gain)))
    lines.append(f"distinct: wrong, by a model that these records distinguish from the truth ({LIMIT:g} nats behind it);")
    lines.append("worse: the final model, than its base; removed: median share of the true error's power on an unseen record")
    return "\n".join(lines)


def _line(c: dict) -> str:
    f, noise = c["factors"], f"{c['times']:.1f} x noise" + (f", {c['evidence']:.0f} nats" if c.get("evidence") else "")
    reads = f"speed by {c['sensor']}" if c["sensor"] != "none" else "no speed"
    rig = (
        f"{f['size']} {f['rate']} Hz {f['seconds']:.0f} s, {f['noise']} x {f['level']:.2f}, {reads}{', voltage' * c['metered']}"
    )
    if c["failed"]:
        return f"{c['name'].removeprefix('variation '):12} {noise:>22} ({rig}): FAILED {c['failed']}"
    families = sorted({name for others in c["family"].values() for name in others})
    named = f"{c['verdict']} {' + '.join(c['effects'])}{' ~ ' + ', '.join(families) if families else ''}".strip()
    term = f" ({' by '.join(c['learned'])})" if c["learned"] else ""
    true = f"{c['true_error'][0]:.3g} -> {c['true_error'][1]:.3g} N"
    return f"{c['name'].removeprefix('variation '):12} {noise:>22} ({rig}): {group(c)}: {named}{term}; true error {true}"
