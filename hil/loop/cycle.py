"""One tick of the rig: drive the outputs, log, wait for the deadline, read the sensors, check the readings."""

import contextlib
import math
from collections.abc import Callable, Mapping, Sequence

from hil.loop.bench import Bench
from hil.loop.columns import STATES
from hil.loop.live import EVERY, StatusLine, text_of
from hil.loop.log import Log
from hil.loop.sensors import Sensors
from hil.loop.ticks import Tick, Ticks
from hil.page.operator_page import OperatorPage
from hil.safety.faults import DeviceFault, Fault, FaultKind
from hil.safety.limits import Cut, Limits
from hil.safety.plausibility import Plausibility, Reading, SupplyLimits
from hil.safety.states import SafetyState, StateMachine
from hil.safety.stop import StopSignals
from hil.safety.supervisor import Supervisor

PERIOD = 0.004
"""Period of the loop, s (paper: 250 Hz)."""

COUNTED = 250
"""Ticks between two readings of the devices' counters."""

NOBODY = (math.nan, math.nan)
"""Values of a controller while there is none."""


class Cycle:
    """The rig's ticks, with their devices, log, checks and safety states.

    `wanted`: the controller's set-point [N]. `throttle` [1] and `commands` [rpm, deg] are on the outputs. `residual` [N] and
    `alarm` are the twin's, for the log. `asked`: why the operator ends the run. `events`: those of the log. `page`: the
    operator's page; its failure is logged and the run continues. `twin`: its `beside` outputs for the log. `line`: the
    terminal's, if there is one.
    """

    def __init__(
        self,
        bench: Bench,
        limits: Limits,
        log: Log,
        signals: StopSignals | None,
        line: StatusLine | None,
        plausibility: Callable[[], Plausibility],
        page: OperatorPage | None = None,
        beside: int = 0,
    ):
        self.dt, self.bench, self.limits, self.states = PERIOD, bench, limits, StateMachine()
        self.ticks, self._tick = Ticks(bench.clock, self.dt), Tick(0, 0.0, 0)
        self.events: list[dict] = []
        self.wanted, self.zero = math.nan, bench.calibration.zero
        self.log, self._signals, self._line, self._judgement = log, signals, line, plausibility
        self._page, self._page_gone, self._counted, self._short = page, False, {}, False
        self._known: set[tuple[str, FaultKind]] = set()
        self._nothing = (math.nan,) * beside
        self.supervisor: Supervisor | None = None
        self.begin()

    def begin(self) -> None:
        """Reset everything that belongs to one run."""
        self.plausibility, self.sensors = self._judgement(), Sensors(self.bench, self.zero)
        self._supply_limits = SupplyLimits(self.limits)
        self.throttle, self.commands = 0.0, (0.0, self.bench.calibration.rest_pitch)
        self.residual, self.alarm, self.asked = math.nan, False, ""
        self.forget()
        self._woke, self._driven_since = self.bench.clock.now(), None

    def forget(self) -> None:
        """Clear the twin's outputs."""
        self.twin: Sequence[float] = self._nothing

    def wake(self) -> None:
        """Request and read the sensors before the first tick after a break."""
        self.sensors.wake(self.bench.clock, self.dt)
        self.ticks.resume()
        self._sense()

    @property
    def passed(self) -> float:
        """Time from the tick before to this one [s]."""
        return self.dt * (1 + self._tick.missed)

    def tick(self, omega_ref: float, beta_ref: float, throttle: float, wanted=NOBODY, cut: Cut = Cut.NONE) -> None:
        """Drive the outputs until the next tick, if the state allows it; then read the sensors and check the readings.

        The commands [rpm, deg] and the throttle act; `wanted`: the controller's commands; `cut`: the limits that changed them.
        """
        self.throttle, self.commands = throttle, (omega_ref, beta_ref)
        self._drive()
        self._record(wanted, cut)
        self._tick = self.ticks.wait()
        self._woke = self.bench.clock.now()
        self._sense()
        self._judge()

    def idle(self) -> None:
        """Set the idle pulse on both outputs, on the second one even if the first one fails."""
        self.throttle, calibration = 0.0, self.bench.calibration
        for channel, pulse in ((self.bench.esc, calibration.esc_idle), (self.bench.lac, calibration.lac_idle)):
            with contextlib.suppress(DeviceFault):
                channel.set(pulse)

    def fault(self, fault: Fault) -> None:
        """Note a fault at its first occurrence, and pass it to the states."""
        if (fault.device, fault.kind) in self._known:
            return
        self._known.add((fault.device, fault.kind))
        if fault.kind is not FaultKind.INTERRUPTED:
            self.states.fault(fault)
        else:
            self.asked = str(fault)
            if self.states.state is SafetyState.RUN:
                self.states.ramp_down(self.asked)
        self.note(str(fault))

    def note(self, why: str) -> None:
        """Record the present state with its time and reason."""
        self.keep(state=self.states.state.value, why=why)

    def keep(self, **event) -> None:
        """Write an event to the log's events, which survive a crash, and remember it, because a disk may refuse it."""
        self.events.append({"time": round(self.ticks.time, 9), **event})
        self.log.note(self.events[-1])

    def _drive(self) -> None:
        changed = self._changed()
        fault = self.supervisor.beat() if self.supervisor else None
        if fault or changed:  # an output that the supervisor set to idle is changed, too
            self.fault(fault or changed)
        if not self.states.driving:
            self.idle()
            return
        calibration, bench = self.bench.calibration, self.bench
        try:
            bench.esc.set(calibration.esc_pulse(self.throttle))
            bench.lac.set(calibration.lac_pulse(self.commands[1]))
        except DeviceFault as failed:
            self.fault(failed.fault)
            self.idle()

    def _changed(self) -> Fault | None:
        """The fault if another process has written to an output since the last tick. The output is set to idle, once."""
        for channel in (self.bench.esc, self.bench.lac):
            try:
                channel.verify()
            except DeviceFault as failed:
                if (failed.device, failed.kind) not in self._known:
                    channel.restore()
                return failed.fault
        return None

    def _record(self, wanted: tuple[float, float], cut: Cut) -> None:
        sensors, tick, state = self.sensors, self._tick, STATES.index(self.states.state.value)
        pulses = sensors.revolution.pulses if sensors.revolution else 0
        busy = self.bench.clock.now() - self._woke
        self.log.put(
            *(self.ticks.time, state, self.wanted, *wanted, *self.commands, sensors.thrust, sensors.omega),
            *(sensors.thrust_age, sensors.mark_age, sensors.counts, pulses, self.throttle, cut),
            *(self.residual, self.alarm, tick.late, busy, tick.missed),
            *sensors.supply.values(),
            *self.twin,
        )
        if self._line and self.ticks.ticks % EVERY == 0:
            self._line.show(self._status())
        if self.ticks.ticks % COUNTED == 0:
            self._keep_counters()
            if not self._short and self.log.warning:
                self._short = True
                self.note(f"log: {self.log.warning}")

    def _status(self) -> str:
        numbers = (
            ("thrust", "6.2f", self.sensors.thrust, "N"),
            ("set-point", "6.2f", self.wanted, "N"),
            ("done", "3.0f", 100.0 * self.log.done, "%"),
            ("speed", "5.0f", self.sensors.omega, "rpm"),
            ("pitch command", "5.1f", self.commands[1], "deg"),
            ("missed", "3.0f", self.ticks.missed, ""),
        )
        warnings = {
            "ALARM: not as its model": self.alarm,
            "the page is gone": self._page_gone,
            "THE DISK IS NEARLY FULL": self._short,
        }
        return text_of(self.states.state.value, numbers, [text for text, on in warnings.items() if on])

    def _keep_counters(self) -> None:
        """Write the counters of recovered errors to the log's events, if they changed."""
        counted = healed(self.bench.counters)
        if counted != self._counted:
            self._counted = counted
            self.keep(counters=counted)

    def _sense(self) -> None:
        for fault in self.sensors.read(self.passed):
            self.fault(fault)

    def _judge(self) -> None:
        """Check the readings, the log, the page and the deadlines, and whether the operator ends the run."""
        sensors = self.sensors
        if sensors.revolution is not None and self.states.state is SafetyState.RUN and not sensors.revolution.closed:
            why = "100 ms without a request" if sensors.revolution.silent else "commanded, or the board has restarted"
            self.fault(Fault("relay", FaultKind.RELAY_OPEN, f"found it open, expected it closed in a run: {why}"))
        if sensors.revolution is not None:
            reading = Reading(
                *(self.ticks.time, sensors.counts, sensors.saturated, sensors.thrust, sensors.thrust_age, sensors.omega),
                *(sensors.revolution.pulses, sensors.mark_age, sensors.speed_age, self.throttle, self.commands[1]),
            )
            if fault := self.plausibility.check(reading):
                self.fault(fault)
        supply = self.bench.supply
        if supply and self.states.state is SafetyState.RUN:  # in earlier states the open relay cuts the supply
            fault = self._supply_limits.check(supply.values, supply.new)
            if fault:
                self.fault(fault)
        if self.log.broken:
            self.fault(Fault("log", FaultKind.LOG_LOST, self.log.broken))
        if self._page and not self._page_gone and self._page.broken:
            self._page_gone = True
            self.note(f"page: {self._page.broken}; the run goes on without it")
        if overdue := self._overdue():
            self.fault(overdue)
        if self._signals and (asked := self._signals.asked):
            self.fault(asked)

    def _overdue(self) -> Fault | None:
        """The fault if a tick is too late, too many ticks were missed, or the run takes too long."""
        limits, late, share = self.limits, self._tick.late, self.ticks.missed_share
        if late > limits.late:
            return Fault("loop", FaultKind.OVERRUN, f"found {1e3 * late:.1f} ms late, expected at most {1e3 * limits.late:g}")
        if share > limits.missed_share:
            found = f"found {share:.0%} of a second's ticks missed, expected at most {limits.missed_share:.0%}"
            return Fault("loop", FaultKind.OVERRUN, found)
        if self.states.state is not SafetyState.RUN:
            self._driven_since = None
        elif self._driven_since is None:
            self._driven_since = self.ticks.time
        elif self.ticks.time - self._driven_since > limits.run_time:
            return Fault("loop", FaultKind.RUN_TIME, f"found a run of more than {limits.run_time:g} s, the limit run_time")
        return None


def healed(counters: Mapping[str, Mapping[str, int]]) -> dict[str, dict[str, int]]:
    """Counters of recovered device errors, without pulses."""
    found = {device: {what: n for what, n in counts.items() if n and what != "pulses"} for device, counts in counters.items()}
    return {device: counts for device, counts in found.items() if counts}
