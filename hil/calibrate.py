"""Measure a rig's calibration: load cell by weights, blade pitch against pulse, throttle pulse at which the motor starts.

Only the last part turns the motor, without a propeller. A `Guide` asks a person for actions and readings; on the emulated rig
an emulated hand acts.
"""

import contextlib
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Protocol

import numpy as np

from hil.devices.calibration import Calibration
from hil.loop.bench import Bench
from hil.loop.cycle import PERIOD
from hil.safety.faults import DeviceFault
from hil.safety.supervisor import Supervisor
from hil.safety.tare import TareGate, TareRefused, tare
from vpp_fmu.digits import number
from vpp_fmu.errors import VppError

PARTS = ("load_cell", "pitch", "esc")
MASSES = (0.0, 0.5, 1.0, 1.5)
"""kg."""
FRICTION = 0.05
"""Residual or hysteresis, N, above which friction is suspected (hil/README.md)."""
BARE = "bare"
G = 9.80665
"""Standard gravity, m/s^2; on the ground it is 0.26 % less to 0.27 % more."""
READINGS = 1000
"""Readings of the load cell at each weight: 4 s."""
TRIES = 3
PUSH = 2.0
"""Force of the emulated hand for a light press, N."""
SURE = 10.0
"""Standard errors that a push must exceed."""
SETTLES = 2.0
"""Settling time of the pitch's rod at each pulse, s."""
STEP, HOLD, HIGHEST = 5e-6, 0.4, 200e-6
"""Increment of the throttle's pulse, its interval, and its largest total, an eighth of the usual range; s."""
MARGIN = 20e-6
"""Distance of the idle pulse below the pulse at which the motor started, s."""
TURNS = 2
"""Passes of the mark that count as turning."""


class CalibrationRefused(VppError):
    """The measurements give no valid calibration; the message says why."""


class Guide(Protocol):
    """The person at the rig. Each method returns when it is done."""

    def do(self, what: str) -> None:
        """Ask for an action."""

    def read(self, what: str) -> float:
        """Ask for a reading."""

    def choice(self, what: str, words: Sequence[str]) -> str:
        """Ask for one of `words`."""

    def numbers(
        self, what: str, default: Sequence[float], good: Callable[[Sequence[float]], bool], allowed: str
    ) -> tuple[float, ...]:
        """Ask for numbers that satisfy `good`; `allowed` describes them in words."""


@dataclass(frozen=True)
class LoadCell:
    """Straight line of `counts` (n,) against `forces` (n,) [N], thrust positive: `newton_per_count`, its standard deviation
    `std`, `zero` [counts]; `residuals` (n,) [N]; `hysteresis` [N], the largest difference of readings under the same weight."""

    forces: tuple[float, ...]
    counts: tuple[float, ...]
    newton_per_count: float
    std: float
    zero: float
    residuals: tuple[float, ...]
    hysteresis: float

    def said(self) -> str:
        """The line and its residuals in words."""
        worst = max(map(abs, self.residuals))
        friction = ": look for friction" if max(worst, self.hysteresis) > FRICTION else ""
        return (
            f"load cell: {1e3 * self.newton_per_count:.5g} ± {1e3 * self.std:.2g} mN a count, zero {self.zero:.1f} counts, "
            f"residuals up to {number(worst)} N, hysteresis {number(self.hysteresis)} N{friction}"
        )


@dataclass(frozen=True)
class PitchTable:
    """Blade pitch [deg] at `pulses` (n,) [s]: `up` (n,) with rising pulses, `down` (n,) with falling ones, `pitches` (n,) their
    mean, used in the table; `play` [deg], the largest difference."""

    pulses: tuple[float, ...]
    up: tuple[float, ...]
    down: tuple[float, ...]

    @property
    def pitches(self) -> tuple[float, ...]:
        return tuple((a + b) / 2.0 for a, b in zip(self.up, self.down, strict=True))

    @property
    def play(self) -> float:
        return max(abs(a - b) for a, b in zip(self.up, self.down, strict=True))


@dataclass(frozen=True)
class Measured:
    """Measured parts; None if not measured. `throttle`: the pulse [s] at which the motor starts, and the longest pulse that the
    ESC was taught."""

    cell: LoadCell | None = None
    pitch: PitchTable | None = None
    throttle: tuple[float, float] | None = None


def measured(
    bench: Bench, guide: Guide, parts: Sequence[str], report: Path, supervised: bool, say: Callable[[str], None]
) -> Measured:
    """Measure the `parts` of PARTS in turn, and print a line for each; `report`, `supervised` as in `started`."""
    before, cell, pitch, throttle = bench.calibration, None, None, None
    if "load_cell" in parts or "pitch" in parts:
        guide.do("press the emergency stop: the ESC has no supply, and the rotor is at rest")
    if "load_cell" in parts:
        from_zero = lambda values: _rise(values) and values[0] == 0.0  # noqa: E731
        masses = guide.numbers("weights to hang [kg]", MASSES, from_zero, "two or more numbers that rise from 0 on")
        way = guide.choice("do the weights pull with the thrust, or against it", ("with", "against"))
        cell = weighed(bench, guide, masses, way == "with")
        say(cell.said())
    if "pitch" in parts:
        present, most = tuple(round(1e6 * pulse, 3) for pulse in before.pulses), 1e6 * before.lac_period
        inside = lambda values: _rise(values) and values[0] >= 0.0 and values[-1] <= most  # noqa: E731
        allowed = f"two or more numbers from 0 to {most:g} that rise"
        pulses = guide.numbers("pulses to the pitch [us]", present, inside, allowed)
        pitch = pitched(bench, guide, [round(1e-6 * pulse, 9) for pulse in pulses])
        say(f"pitch: {min(pitch.pitches):g} to {max(pitch.pitches):g} deg, play {pitch.play:.2f} deg")
    if "esc" in parts:
        taught, idle, longest = (round(1e6 * pulse, 3) for pulse in (before.esc_max, before.esc_idle, before.esc_period))
        within = lambda values: len(values) == 1 and idle < values[0] < longest  # noqa: E731
        question = "longest pulse that the ESC was taught, by its manual [us]"
        (taught,) = guide.numbers(question, (taught,), within, f"a number above {idle:g} and below {longest:g}")
        guide.choice("take the propeller OFF, then release the emergency stop; only the bare motor will turn", (BARE,))
        start = started(bench, report, supervised)
        throttle = start, round(1e-6 * taught, 9)
        say(f"throttle: the motor starts at {1e6 * start:g} us")
    return Measured(cell, pitch, throttle)


def _rise(values: Sequence[float]) -> bool:
    return len(values) > 1 and all(a < b for a, b in pairwise(values))


def line(forces: Sequence[float], counts: Sequence[float]) -> LoadCell:
    """Fit the load cell's line by least squares: counts = zero + force / newton_per_count, for known forces (n,) [N] and read
    counts (n,). CalibrationRefused: no significant slope, fewer than three readings, or fewer than two forces."""
    x, y = np.asarray(forces, float), np.asarray(counts, float)
    if np.ptp(x) == 0.0 or len(x) < 3:
        found = f"{len(x)} readings under {len(set(x.tolist()))} weights"
        raise CalibrationRefused(f"load cell: weights: found {found}, expected 3 under 2 at least")
    spread = x - x.mean()
    slope = float(spread @ y / (spread @ spread))
    zero = float(y.mean() - slope * x.mean())
    error = float(np.sqrt(np.sum((y - zero - slope * x) ** 2) / (len(x) - 2) / (spread @ spread)))
    if abs(slope) <= 3.0 * error or slope == 0.0:
        raise CalibrationRefused(f"load cell: slope: found {slope:.4g} ± {error:.2g} counts per N, expected one beyond 3 std")
    found = (y - zero) / slope - x
    same = [np.ptp(y[x == force]) for force in set(x.tolist())]
    hysteresis = float(max(same) / abs(slope))
    return LoadCell(tuple(x), tuple(y), 1.0 / slope, error / slope**2, zero, tuple(found), hysteresis)


def weighed(bench: Bench, guide: Guide, masses: Sequence[float], with_thrust: bool) -> LoadCell:
    """The load cell's line from `masses` (n,) [kg], hung in rising and then in falling order. `with_thrust`: whether they pull
    in the direction of thrust. At the end a push along the thrust must read positive. CalibrationRefused, TareRefused."""
    sign, forces, counts = 1.0 if with_thrust else -1.0, [], []
    for mass in (*masses, *reversed(masses[:-1])):
        guide.do(f"hang {mass:g} kg on the thrust's axis and wait until it is still" if mass else "take all weights off")
        force = sign * mass * G
        _hand(bench, force)
        forces.append(force)
        counts.append(_mean(bench)[0])
    found = line(forces, counts)
    _check_sign(bench, guide, found)
    return found


def _check_sign(bench: Bench, guide: Guide, found: LoadCell) -> None:
    guide.do("take all weights off and let go")
    _hand(bench, 0.0)
    free, error = _mean(bench)
    guide.do("press lightly on the stand, the way that thrust pushes, and keep pressing")
    _hand(bench, PUSH)
    pressed = np.array([bench.adc.read().counts for _ in _ticks(bench, READINGS // 4)], float).mean()
    _hand(bench, 0.0)
    push = found.newton_per_count * (pressed - free)
    if abs(push) < SURE * error * abs(found.newton_per_count):
        raise CalibrationRefused(f"load cell: push: found {push:+.3f} N, expected more than its uncertainty")
    if push < 0.0:
        found = f"a push the way of the thrust reads {push:+.2f} N"
        raise CalibrationRefused(f"load cell: polarity: found {found}, expected a positive one. Try: weights the other way")


def pitched(bench: Bench, guide: Guide, pulses: Sequence[float]) -> PitchTable:
    """Blade pitch at `pulses` (n,) [s], approached from below and then from above. CalibrationRefused if it is not
    monotonic."""

    def at(pulse: float) -> float:
        bench.lac.set(pulse)
        _wait(bench, SETTLES)
        return guide.read(f"pulse of {1e6 * pulse:g} us: blade pitch at 75 % of the radius [deg]")

    low, high = pulses[0], pulses[-1]
    bench.lac.set(low)
    _wait(bench, SETTLES)
    up = [at(pulse) for pulse in pulses]
    bench.lac.set(high)
    down = [at(pulse) for pulse in reversed(pulses)][::-1]
    bench.lac.set(bench.calibration.lac_idle)
    found = PitchTable(tuple(pulses), tuple(up), tuple(down))
    moves = np.diff(found.pitches)
    if not (np.all(moves > 0.0) or np.all(moves < 0.0)):
        shown = ", ".join(f"{pitch:g}" for pitch in found.pitches)
        raise CalibrationRefused(f"pitch: found {shown} deg over rising pulses, expected them to rise only or to fall only")
    return found


def started(bench: Bench, report: Path, supervised: bool) -> float:
    """Raise the ESC's pulse slowly from idle until the bare motor turns; returns that pulse [s] and sets the idle pulse again.

    `supervised`: in real time, a second process stops the motor if this one ends or is silent. CalibrationRefused if the motor
    turns at once, or not at all. DeviceFault."""
    supervisor = Supervisor(bench.outputs, report, keep=(bench.lock,)) if supervised else None
    idle = bench.calibration.esc_idle

    def held(pulse: float, seconds: float) -> int:
        """Hold a pulse for a time; returns the mark's passes so far."""
        passes = 0
        for _ in _ticks(bench, round(seconds / PERIOD)):
            fault = supervisor.beat() if supervisor else None
            if fault:
                raise DeviceFault(fault.device, fault.kind, fault.detail)
            bench.esc.set(pulse)
            answer = bench.tachometer.poll()
            bench.tachometer.request()
            passes = answer.pulses if answer else passes
        return passes

    try:
        bench.tachometer.request()
        held(idle, 0.1)
        bench.tachometer.arm()
        before = held(idle, 1.0 + bench.esc_boot)
        if held(idle, 1.0) > before:
            found = f"a turning motor at its idle pulse of {1e6 * idle:g} us"
            raise CalibrationRefused(f"throttle: found {found}, expected rest. Try: teach the ESC its range")
        for k in range(1, round(HIGHEST / STEP) + 1):
            pulse = idle + k * STEP
            if held(pulse, HOLD) - before >= TURNS:
                return pulse
        raise CalibrationRefused(f"throttle: found no turn up to {1e6 * pulse:g} us, expected a start: has the ESC its supply?")
    finally:
        bench.esc.set(idle)
        with contextlib.suppress(DeviceFault):
            bench.tachometer.stop()
        if supervisor:
            supervisor.close()


def adopted(before: Calibration, measured: Measured, who: str, when: str) -> Calibration:
    """The calibration with the measured parts; `who` and `when` go into its source. The pitch limits of a run are clipped to
    the new table."""
    cell, pitch, throttle = measured.cell, measured.pitch, measured.throttle
    own = {"who": who, "when": when, "how": "vpp hil calibrate"}
    source = {key: value for key, value in before.source.items() if key not in ("who", "when")}
    changes: dict = {"source": source}
    if cell:
        changes |= {"newton_per_count": cell.newton_per_count, "zero": cell.zero}
        read = {"forces_N": cell.forces, "counts": cell.counts, "residuals_N": cell.residuals, "hysteresis_N": cell.hysteresis}
        source["load_cell"] = own | read | {"std_N_per_count": cell.std}
    if pitch:
        low, high = min(pitch.pitches), max(pitch.pitches)
        least, most = max(before.pitch_min, low), min(before.pitch_max, high)
        changes |= {"pulses": pitch.pulses, "pitches": pitch.pitches, "pitch_min": least, "pitch_max": most}
        changes["rest_pitch"] = min(max(before.rest_pitch, least), most)
        source["pitch"] = own | {"pulses_s": pitch.pulses, "up_deg": pitch.up, "down_deg": pitch.down, "play_deg": pitch.play}
    if throttle:
        changes |= {"esc_idle": round(throttle[0] - MARGIN, 9), "esc_max": throttle[1]}
        source["esc"] = own | {"started_at_s": throttle[0], "taught_s": throttle[1]}
    return replace(before, **changes)


def _mean(bench: Bench) -> tuple[float, float]:
    """(mean, its standard error) of the load cell's counts at rest. TareRefused after three unsteady attempts."""
    for left in reversed(range(TRIES)):
        counts = [bench.adc.read().counts for _ in _ticks(bench, READINGS)]
        try:
            found = tare(counts, bench.calibration.newton_per_count, float(np.mean(counts)), TareGate())
        except TareRefused:
            if not left:
                raise
        else:
            return found.zero, found.error
    raise AssertionError("unreachable")


def _hand(bench: Bench, force: float) -> None:
    """Set the force [N] of the emulated hand."""
    if bench.hand:
        bench.hand(force)
        _wait(bench, 0.1)


def _ticks(bench: Bench, count: int):
    """Pause for a tick, `count` times."""
    begun = bench.clock.now()
    for k in range(1, count + 1):
        bench.clock.wait_until(begun + k * PERIOD)
        yield k


def _wait(bench: Bench, seconds: float) -> None:
    for _ in _ticks(bench, math.ceil(seconds / PERIOD)):
        pass
