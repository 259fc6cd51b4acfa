"""The operator's signals: Ctrl-C once ramps down, twice stops at once; SIGTERM and a lost terminal stop at once."""

import signal
from collections.abc import Callable

from hil.safety.faults import Fault, FaultKind


class StopSignals:
    """Within the context signals only set a flag that the loop reads between ticks: no bus transfer is interrupted.

    Enter it in the main thread. The previous handlers are restored at the end. `pressed`: whether an interrupt was STOP
    on the operator's page, which sends the same signal.
    """

    HANDLED = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)

    def __init__(self, pressed: Callable[[], bool] = lambda: False):
        self._interrupts, self._ended, self._before, self._pressed = 0, None, {}, pressed

    def __enter__(self):
        self._before = {number: signal.signal(number, self._note) for number in self.HANDLED}
        return self

    def __exit__(self, *_):
        for number, handler in self._before.items():
            signal.signal(number, handler)

    def _note(self, number, _frame):
        if number == signal.SIGINT:
            self._interrupts += 1
        else:
            self._ended = signal.Signals(number).name

    @property
    def asked(self) -> Fault | None:
        """The most urgent stop request so far, or None. INTERRUPTED is no fault of the rig: it ends the run normally."""
        if self._ended:
            return Fault("operator", FaultKind.TERMINATED, self._ended)
        if not self._interrupts:
            return None
        how = "STOP on the page" if self._pressed() else "Ctrl-C"
        if self._interrupts > 1:
            return Fault("operator", FaultKind.INTERRUPTED_TWICE, f"{how} {self._interrupts} times")
        return Fault("operator", FaultKind.INTERRUPTED, how)
