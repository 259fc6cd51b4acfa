"""The schedule of a model's steps: a communication step is cut into pieces in which all inputs are constant.

A piece ends where a delayed command begins to act or a sampled effect is due, and is cut into equal steps no longer than the
model's largest step. A delay is thus exact at any communication step, and every form that is exact for held inputs stays exact
behind it. A sampled law runs when its sample is due. `schedule.c` is the same text in C; both must do the same arithmetic in
the same order, since results are compared bit by bit. This file is part of the Python FMU.
"""

from math import ceil, isinf

NOW = 1e-9  # s; events within a nanosecond are simultaneous, so that rounding cuts no tiny steps
NUDGE = 1e-7  # s; short enough for a derivative at an instant, long enough to keep its digits
SLOTS = 4096  # commands that may wait in one delay; C needs the bound, so Python has it too
FULL = f"delay: found more than {SLOTS} waiting command changes, expected fewer. Try: longer communication steps"
PIECES = 100_000  # maximum of the model's own steps in one communication step of an FMU: seconds of computing time
LONGEST_EXACT = 1e5  # s; longest communication step of an FMU that is exact at any: beyond a day it is a mistake


class DelayFull(OverflowError):
    """Commands change faster than a delay can hold them."""


class DelayLine:
    """A delayed command: changes wait until their delay has passed."""

    def __init__(self, value):
        self.acting = self.latest = value
        self.waits, self.values = [], []  # each wait counts from the change before it, the first from now
        self.span = 0.0  # time from now until the last change acts

    def push(self, value, delay):
        """The command changes to `value` now; it acts after `delay` seconds."""
        if value == self.latest:
            return
        if len(self.waits) == SLOTS:
            raise DelayFull(FULL)
        self.waits.append(delay - self.span if self.waits else delay)
        self.values.append(value)
        self.latest, self.span = value, delay

    def act(self):
        """Apply all changes that are due. True if any was."""
        changed = False
        while self.waits and self.waits[0] <= NOW:
            left = self.waits.pop(0)
            self.acting, changed = self.values.pop(0), True
            if self.waits:
                self.waits[0] += left
        return changed

    def pass_time(self, piece):
        """Advance the time by `piece` seconds."""
        if self.waits:
            self.waits[0] -= piece
            self.span -= piece


def run_held(lines, delays, inputs, span, largest, step, nudge=None, due=tuple):
    """Advance a continuous model by `span` seconds under `inputs` that the caller holds.

    `lines`: DelayLine or None for each input; `delays`: the seconds each is held back; `largest`: the longest step allowed.
    `step(acting inputs, dt)` takes one step. When a delayed command begins to act, `nudge(k, old, new)` is called, for the
    tangents: the delay of the k-th delayed input determines when the inputs change from `old` to `new`. `due()`: for each
    sampled effect the time until its next sample, after one that is due now.
    """
    delayed = [(i, line) for i, line in enumerate(lines) if line is not None]
    for i, line in delayed:
        line.push(inputs[i], delays[i])
    acting = list(inputs)
    left = span
    while True:
        before = [line.acting for _, line in delayed]
        began = [line.act() for _, line in delayed]
        piece = left
        for i, line in delayed:
            acting[i] = line.acting
            if line.waits and line.waits[0] < piece - NOW:
                piece = line.waits[0]
        for wait in due():
            if wait < piece - NOW:
                piece = wait
        if nudge is not None:
            for k, (i, _) in enumerate(delayed):
                if began[k]:
                    nudge(k, [*acting[:i], before[k], *acting[i + 1 :]], acting)
        count = 1 if isinf(largest) else max(1, ceil(piece / largest - NOW))
        for _ in range(count):
            step(acting, piece / count)
        for _, line in delayed:
            line.pass_time(piece)
        left -= piece
        if left <= NOW:
            return


def next_sample(wait, period):
    """The time until the next sample of an effect, after one that is due now."""
    return wait + period if wait < NOW else wait


def run_sampled(wait, period, span, step):
    """Advance a sampled law by `span` seconds: `step(period)` at each sample that is due. Returns the wait for the next."""
    while wait < span - NOW:
        step(period)
        wait += period
    wait -= span
    return 0.0 if abs(wait) <= NOW else wait
