"""The states: each legal move, each illegal one, and thousands of random calls against a table written by hand."""

import random

import pytest

from hil.safety.faults import Fault, FaultKind, Reaction
from hil.safety.states import IllegalMove, SafetyState, StateMachine
from hil.safety.tare import Tare

ZERO = Tare(100.0, 3.0, 0.2, 500)
SOFT = Fault("tachometer", FaultKind.SILENT, "50 ms")
HARD = Fault("tachometer", FaultKind.OVER_SPEED, "7000 rpm")

# (state, idle pulse on, tared, faulty) and a call give the next such tuple; every other call is refused.
TABLE = {
    ("SAFE", True, False, False): {
        "tare": ("SAFE", True, True, False),
        "soft": ("FAULT", True, False, True),
        "hard": ("FAULT", True, False, True),
    },
    ("SAFE", True, True, False): {
        "tare": ("SAFE", True, True, False),
        "arm": ("ARMED", True, True, False),
        "soft": ("FAULT", True, True, True),
        "hard": ("FAULT", True, True, True),
    },
    ("ARMED", True, True, False): {
        "run": ("RUN", False, True, False),
        "stopped": ("SAFE", True, False, False),
        "soft": ("FAULT", True, True, True),
        "hard": ("FAULT", True, True, True),
    },
    ("RUN", False, True, False): {
        "ramp down": ("RAMPDOWN", False, True, False),
        "soft": ("RAMPDOWN", False, True, True),
        "hard": ("FAULT", False, True, True),
    },
    ("RAMPDOWN", False, True, False): {
        "stopped": ("SAFE", True, False, False),
        "soft": ("RAMPDOWN", False, True, True),
        "hard": ("FAULT", False, True, True),
    },
    ("RAMPDOWN", False, True, True): {
        "stopped": ("FAULT", True, False, True),
        "soft": ("RAMPDOWN", False, True, True),
        "hard": ("FAULT", False, True, True),
    },
    ("FAULT", False, True, True): {
        "stopped": ("FAULT", True, False, True),
        "soft": ("FAULT", False, True, True),
        "hard": ("FAULT", False, True, True),
    },
    ("FAULT", True, True, True): {
        "stopped": ("FAULT", True, False, True),
        "soft": ("FAULT", True, True, True),
        "hard": ("FAULT", True, True, True),
        "reset": ("SAFE", True, False, False),
    },
    ("FAULT", True, False, True): {
        "stopped": ("FAULT", True, False, True),
        "soft": ("FAULT", True, False, True),
        "hard": ("FAULT", True, False, True),
        "reset": ("SAFE", True, False, False),
    },
}
CALLS = {
    "tare": lambda machine: machine.tared(ZERO),
    "arm": StateMachine.arm,
    "run": StateMachine.run,
    "ramp down": lambda machine: machine.ramp_down("end of the run"),
    "soft": lambda machine: machine.fault(SOFT),
    "hard": lambda machine: machine.fault(HARD),
    "stopped": StateMachine.stopped,
    "reset": StateMachine.reset,
}


def shown(machine):
    return machine.state.name, machine.idle, machine.tare is not None, bool(machine.faults)


def call(machine, name):
    """Whether the machine accepts the call."""
    try:
        CALLS[name](machine)
    except IllegalMove:
        return False
    return True


@pytest.mark.parametrize("seed", range(20))
def test_random_calls_follow_the_table_and_reach_run_only_tared_and_armed(seed):
    """20 x 50 sequences of 60 calls; the last calls before RUN are also checked without the table."""
    dice, runs = random.Random(seed), 0
    weights = [1.0 if name in ("soft", "hard") else 4.0 for name in CALLS]
    for _ in range(50):
        machine, taken = StateMachine(), []
        assert shown(machine) == ("SAFE", True, False, False)
        for name in dice.choices(list(CALLS), weights, k=60):
            expected = TABLE[shown(machine)].get(name)
            before = shown(machine)
            assert call(machine, name) == (expected is not None), (before, name)
            assert shown(machine) == (expected or before), (before, name)
            assert machine.driving == (machine.state in (SafetyState.RUN, SafetyState.RAMPDOWN))
            if expected:
                taken.append(name)
            if expected and name == "run":
                runs += 1
                assert taken[-2:] == ["arm", "run"]
                since = [k for k, one in enumerate(taken) if one in ("stopped", "reset")][-1:] or [-1]
                assert "tare" in taken[since[0] + 1 :]
                assert not {"soft", "hard"} & set(taken[since[0] + 1 :])
    assert runs > 20


def running():
    machine = StateMachine()
    machine.tared(ZERO)
    machine.arm()
    machine.run()
    return machine


def test_a_refusal_says_where_the_rig_is_and_where_the_move_is_allowed():
    machine = StateMachine()
    with pytest.raises(IllegalMove, match=r"^run: found the rig in SAFE, expected ARMED$"):
        machine.run()
    with pytest.raises(IllegalMove, match=r"^arm: found no tare since the last run, expected one$"):
        machine.arm()
    machine = running()
    machine.fault(HARD)
    with pytest.raises(IllegalMove, match=r"^reset: found no idle pulse yet, expected it$"):
        machine.reset()


def test_the_first_fault_is_the_cause():
    machine = running()
    machine.fault(SOFT)
    assert (machine.state, machine.reason) == (SafetyState.RAMPDOWN, "tachometer: silent: 50 ms")
    machine.fault(HARD)
    assert (machine.cause, machine.faults) == (SOFT, [SOFT, HARD])


@pytest.mark.parametrize("kind", FaultKind)
def test_every_kind_of_fault_leaves_run(kind):
    machine = running()
    machine.fault(Fault("rig", kind, "test"))
    ramped = kind.reaction is Reaction.RAMP_DOWN
    assert machine.state is (SafetyState.RAMPDOWN if ramped else SafetyState.FAULT)
    machine.stopped()
    assert machine.state is SafetyState.FAULT
    with pytest.raises(IllegalMove):
        machine.arm()
