"""The operator's signals, sent for real."""

import os
import signal

import pytest

from hil.safety.faults import FaultKind, Reaction
from hil.safety.stop import StopSignals


@pytest.mark.parametrize(
    ("sent", "kind", "reaction"),
    [
        ([signal.SIGINT], FaultKind.INTERRUPTED, Reaction.RAMP_DOWN),
        ([signal.SIGINT, signal.SIGINT], FaultKind.INTERRUPTED_TWICE, Reaction.IDLE),
        ([signal.SIGTERM], FaultKind.TERMINATED, Reaction.IDLE),
        ([signal.SIGHUP], FaultKind.TERMINATED, Reaction.IDLE),
        ([signal.SIGINT, signal.SIGTERM], FaultKind.TERMINATED, Reaction.IDLE),
    ],
)
def test_each_signal_has_its_reaction(sent, kind, reaction):
    before = [signal.getsignal(number) for number in StopSignals.HANDLED]
    with StopSignals() as signals:
        assert signals.asked is None
        for number in sent:
            os.kill(os.getpid(), number)
        assert signals.asked.kind is kind
        assert kind.reaction is reaction
    assert [signal.getsignal(number) for number in StopSignals.HANDLED] == before
