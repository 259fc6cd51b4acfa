"""The rig as a plant: tare, arm, run with one tick per step, and a ramp-down after any fault."""

import contextlib
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from statistics import stdev
from typing import NamedTuple

from hil.loop.bench import Bench
from hil.loop.cycle import NOBODY, PERIOD, Cycle
from hil.loop.live import StatusLine
from hil.loop.log import Log
from hil.page.operator_page import OperatorPage
from hil.physics.speed_pi import SpeedPi
from hil.safety.faults import DeviceFault, Fault, FaultKind
from hil.safety.limits import Cut, Limiter, Limits
from hil.safety.plausibility import Plausibility
from hil.safety.polarity import Level, Polarity
from hil.safety.states import SafetyState
from hil.safety.stop import StopSignals
from hil.safety.supervisor import Supervisor
from hil.safety.tare import Tare, TareGate, TareRefused, tare
from hil.twin.twin import Twin
from vpp_fmu.errors import VppError

SERVES = 0.02
"""Largest age of the speed, s, that the speed loop uses; then it freezes, or its integral would open the throttle."""
TARE_SAMPLES = 1000
TARE_TRIES = 3
"""More than one, because slow noise of the amplifier sometimes looks like a drift."""
REST = 1.0
"""Time without a revolution, s, after which the rotor counts as at rest."""
RUN_OUT = 20.0
"""Maximum time until a rotor is at rest, s."""
SETTLE = 3.0
"""Time at the first commands before a run begins, s (paper: duration of transients)."""
RELAY, REPEAT = 0.5, 10
"""Maximum time until the relay is closed, s, and ticks after which the command to the board is repeated."""
RAMP = 1.5
"""Duration of a ramp-down from full throttle to none, s."""


class RunEnded(VppError):
    """The run ended early; the message says why. The data until then are in the log."""


ENDINGS = (RunEnded, TareRefused, DeviceFault)
"""Exceptions of `start` and `step`, after which the idle pulse is on the outputs."""


class RigSample(NamedTuple):
    """Thrust [N], speed [rpm] held since the last pass of the mark, pitch (NaN: the rig measures none), ages [s]."""

    thrust: float
    omega: float
    beta: float
    thrust_age: float
    omega_age: float


class RigPlant:
    """The rig as a plant: `start` tares, arms, runs and settles; `stop` ramps down; `close` sets the idle pulse.

    Any fault ends the run: by a ramp-down if that is safe, else by the idle pulse at once. `start` or `step` then raises
    RunEnded. `supervise` starts the process that stops the rotor if this one can't; `plausibility` makes the checks of a run's
    readings; `gate`: conditions of a tare; `polarity`: check of signs at low speed. `events`: those of the
    log so far.
    """

    def __init__(
        self,
        bench: Bench,
        limits: Limits,
        log: Log,
        supervise: Callable[[], Supervisor] | None = None,
        signals: StopSignals | None = None,
        twin: Twin | None = None,
        line: StatusLine | None = None,
        plausibility: Callable[[], Plausibility] | None = None,
        gate: TareGate | None = None,
        polarity: Polarity | None = None,
        page: OperatorPage | None = None,
    ):
        self.dt, self.bench, self.limits, self._gate = PERIOD, bench, limits, gate
        plausibility = plausibility or (lambda: Plausibility(limits, PERIOD))
        self._cycle = Cycle(bench, limits, log, signals, line, plausibility, page, len(twin.outputs) if twin else 0)
        self.states, self.ticks, self.events = self._cycle.states, self._cycle.ticks, self._cycle.events
        self._supervise, self.twin, self._polarity = supervise, twin, polarity
        self._pi, self._limiter = SpeedPi(), Limiter(limits)
        self.counters = bench.counters

    def start(self, omega_ref: float, beta_ref: float) -> RigSample:
        """Wait until the rotor is at rest, tare, arm, spin up slowly to the commands [rpm, deg], settle."""
        self._begin()
        self.states.tared(self._tare())
        self._cycle.note("tared")
        self.states.arm()
        self._cycle.note("armed")
        self._close_relay()
        self.states.run()
        self._cycle.note("run")
        low, high = self.limits.omega_min, self.limits.omega_max
        target = min(max(omega_ref, low), high), min(max(beta_ref, self.limits.beta_min), self.limits.beta_max)
        if self._polarity and self._polarity.possible:
            self._check_polarity(self._polarity)
        at = self._go(target)
        for _ in range(round(SETTLE / self.dt)):
            self._driven_tick(*at)
        if self.twin:
            self.twin.start(self.ticks.time, *at, self.last.thrust, self.last.omega)
        return self.last

    def step(self, omega_ref: float, beta_ref: float) -> RigSample:
        """Hold the commands, limited, for one tick; returns the readings at the next tick."""
        limited = self._limiter.apply(omega_ref, beta_ref, self.dt)
        if limited.fault:
            self._cycle.fault(limited.fault)
        if self.twin:
            self._watch(self.twin, limited.omega_ref, limited.beta_ref)
        self._driven_tick(limited.omega_ref, limited.beta_ref, (omega_ref, beta_ref), limited.cut)
        return self.last

    def _watch(self, twin: Twin, omega_ref: float, beta_ref: float) -> None:
        """Update the twin with the last readings; note its alarms, and end the run if its `on_alarm` is a fault."""
        known, cycle = len(twin.alarms), self._cycle
        cycle.twin = twin.update(self.ticks.time, omega_ref, beta_ref, self.last.thrust, self.last.omega)
        cycle.residual, cycle.alarm = twin.residual, twin.alarmed
        for alarm in twin.alarms[known:]:
            cycle.keep(alarm=alarm._asdict())
            if twin.on_alarm is None:
                cycle.note(f"twin: alarm: {alarm.cause}")
            else:
                cycle.fault(Fault("twin", twin.on_alarm, alarm.cause))

    def idle(self, count: int) -> None:
        """Run `count` ticks with all devices active and the idle pulse on the outputs, which stays after any failure.

        Faults are noted in `states` and `events`; only the operator ends it early (RunEnded).
        """
        self._begin()
        for k in range(1, count + 1):
            self._cycle.tick(0.0, self.bench.calibration.rest_pitch, 0.0)
            self.show_done(k / count)
            if any(fault.device == "operator" for fault in self.states.faults) or self._cycle.asked:
                self._end()
        self._dismiss()

    def stop(self) -> None:
        """End the run: ramp down, set the idle pulse, end the supervisor. Then `start` may be called again."""
        if self.states.state is SafetyState.RUN:
            self.states.ramp_down("end of the run")
            self._cycle.note("end of the run")
            self._come_down()
        self._dismiss()

    def close(self) -> None:
        """Set the idle pulse, whatever happened; then close all devices."""
        self._cycle.idle()
        self._open_relay()
        self._dismiss()
        self.counters = self.bench.counters
        self.bench.close()

    @property
    def last(self) -> RigSample:
        sensors = self._cycle.sensors
        return RigSample(sensors.thrust, sensors.omega, math.nan, sensors.thrust_age, sensors.mark_age)

    @property
    def supply(self) -> Mapping[str, float]:
        """The last readings of the supply's sensors in the calibration, by name; NaN before the first."""
        return {name: self._cycle.sensors.supply[name] for name in self._cycle.bench.calibration.supply}

    def fail(self, fault: Fault) -> None:
        """The source of commands failed: ramp down as the fault allows, and end the run (RunEnded)."""
        self._cycle.fault(fault)
        self._come_down()
        self._end()

    def show_done(self, share: float) -> None:
        """Set the progress for the terminal's line and the page; `share`: 0 to 1."""
        self._cycle.log.done = share

    def keep(self, **event) -> None:
        """Keep an event beside the log."""
        self._cycle.keep(**event)

    def note(self, why: str) -> None:
        """Record the present state with a reason."""
        self._cycle.note(why)

    def follow(self, thrust_set: float) -> None:
        """Set the controller's set-point [N], for the log."""
        self._cycle.wanted = thrust_set

    def _begin(self) -> None:
        self._cycle.begin()
        self._pi, self._limiter = SpeedPi(), Limiter(self.limits, *self._cycle.commands)
        if self._supervise:
            self._cycle.supervisor = self._supervise()
        self._cycle.wake()

    def _tare(self) -> Tare:
        """The load cell's zero, once the rotor is at rest."""
        rest, sensors = 0.0, self._cycle.sensors
        for _ in range(round(RUN_OUT / self.dt)):
            self._idle_tick()
            rest = rest + self.dt if sensors.omega == 0.0 else 0.0
            if rest >= REST:
                break
        else:
            raise RunEnded(f"tare: speed: found {sensors.omega:.0f} rpm after {RUN_OUT:g} s, expected a rotor at rest")
        for left in reversed(range(TARE_TRIES)):
            try:
                return self._zeroed()
            except TareRefused as refused:
                if not left:
                    raise
                self._cycle.note(str(refused))
        raise AssertionError("unreachable")

    def _zeroed(self) -> Tare:
        counts, sensors, calibration = [], self._cycle.sensors, self.bench.calibration
        for _ in range(TARE_SAMPLES):
            self._idle_tick()
            counts.append(sensors.counts)
        found = tare(counts, calibration.newton_per_count, calibration.zero, self._gate)
        self._cycle.zero = sensors.zero = found.zero
        noise = found.noise * abs(calibration.newton_per_count)
        self._cycle.keep(tare={"zero_counts": found.zero, "noise_N": noise, "samples": found.samples})
        return found

    def _close_relay(self) -> None:
        """Switch the ESC's supply on with the idle pulse on, and wait until the ESC is ready."""
        cycle, tachometer = self._cycle, self.bench.tachometer
        for k in range(round(RELAY / self.dt)):
            if k % REPEAT == 0:
                with contextlib.suppress(DeviceFault):  # the tick's request reports the same fault
                    tachometer.arm()
            self._idle_tick()
            if cycle.sensors.revolution and cycle.sensors.revolution.closed:
                break
        else:
            cycle.fault(Fault("relay", FaultKind.NOT_READY, f"found open {RELAY:g} s after the command, expected closed"))
            self._end()
        cycle.keep(relay="closed")
        for _ in range(1 + round(self.bench.esc_boot / self.dt)):
            self._idle_tick()

    def _open_relay(self) -> None:
        """Disarm the board after the rotor has stopped; the next run must arm it again."""
        with contextlib.suppress(DeviceFault):
            self.bench.tachometer.stop()

    def _idle_tick(self) -> None:
        """A tick with the idle pulse, before the run."""
        self._cycle.tick(0.0, self.bench.calibration.rest_pitch, 0.0)
        if self.states.state not in (SafetyState.SAFE, SafetyState.ARMED) or self._cycle.asked:
            self._end()

    def _go(self, target: tuple[float, float]) -> tuple[float, float]:
        """Move slowly to the commands, at the slopes of spin-up."""
        at = (math.nan, math.nan)
        while at != target:
            at = self._limiter.ramp(*target, self.dt)[:2]
            self._driven_tick(*at)
        return at

    def _check_polarity(self, check: Polarity) -> None:
        """Measure the thrust at two pitches at low speed; a wrong sign ends the run."""
        found = []
        for beta in check.betas:
            at = self._go((check.omega, beta))
            for _ in range(round(check.settle / self.dt)):
                self._driven_tick(*at)
            thrust, omega = [], 0.0
            for _ in range(round(check.average / self.dt)):
                self._driven_tick(*at)
                thrust.append(self.last.thrust)
                omega += self.last.omega
            found.append(_level(thrust, omega / len(thrust), beta))
        self.keep(polarity=[asdict(one) for one in found])
        if fault := check.judge(*found):
            self.fail(fault)

    def _driven_tick(self, omega_ref, beta_ref, wanted=NOBODY, cut=Cut.NONE) -> None:
        """A tick of the run."""
        cycle, sensors = self._cycle, self._cycle.sensors
        if self.states.state is SafetyState.RUN:
            frozen = sensors.speed_age > SERVES or not cycle.plausibility.speed_trusted
            cycle.tick(omega_ref, beta_ref, self._pi.update(omega_ref, sensors.omega, cycle.passed, frozen), wanted, cut)
        if self.states.state is not SafetyState.RUN:
            self._come_down()
            self._end()

    def _come_down(self) -> None:
        """Ramp the throttle down, without any sensor. An urgent fault ends the ramp early."""
        cycle = self._cycle
        cycle.residual = cycle.wanted = math.nan
        cycle.forget()
        while self.states.state is SafetyState.RAMPDOWN and cycle.throttle > 0.0:
            commands = self._limiter.ramp(0.0, self.bench.calibration.rest_pitch, cycle.passed)[:2]
            cycle.tick(*commands, max(0.0, cycle.throttle - cycle.passed / RAMP))
        cycle.idle()
        self._open_relay()
        self.states.stopped()
        cycle.note("idle pulse")

    def _end(self) -> None:
        raise RunEnded(str(self.states.cause or self._cycle.asked or self.states.reason))

    def _dismiss(self) -> None:
        if self._cycle.supervisor:
            self._cycle.idle()
            self._cycle.supervisor.close()
            self._cycle.supervisor = None


def _level(thrust: Sequence[float], omega: float, beta: float) -> Level:
    """The mean with its standard error from five block means, because the amplifier's noise is coloured."""
    rows = len(thrust) // 5
    blocks = [sum(thrust[k * rows : (k + 1) * rows]) / rows for k in range(5)]
    return Level(sum(thrust) / len(thrust), stdev(blocks) / 5**0.5, omega, beta)
