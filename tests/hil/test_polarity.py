"""The check of signs at low speed: a wrong sign ends the run there, with "wrong polarity" as the cause."""

from dataclasses import replace

import numpy as np
import pytest
from rigs import CALIBRATION, IDLE, LIMITS, duties, setup, step_profile, steps

from hil.commands import PAPERS
from hil.emulator.rig import EmulatedRig as Emulated
from hil.loop.bench import locked
from hil.loop.rig import RunEnded
from hil.run import run_on_rig
from hil.safety.faults import FaultKind
from hil.safety.polarity import Level, Polarity
from vpp_fmu.plants import KernelController

WRONG = {
    "load cell": replace(CALIBRATION, newton_per_count=-CALIBRATION.newton_per_count),
    "pitch": replace(CALIBRATION, pitches=CALIBRATION.pitches[::-1]),
}


def levels(first, second, error=0.03):
    return Level(first, error, 2000.0, -5.0), Level(second, error, 2000.0, 5.0)


@pytest.mark.parametrize(
    ("first", "second", "known", "kind", "word"),
    [
        (0.55, 1.29, True, None, ""),  # the paper's map at -5 and 5 deg
        (0.55, 1.29, False, None, ""),
        (-0.55, -1.29, True, FaultKind.POLARITY, "load cell's"),
        (-0.55, -1.29, False, FaultKind.POLARITY, "load cell's"),
        (1.29, 0.55, True, FaultKind.POLARITY, "pitch's"),
        (1.29, 0.55, False, FaultKind.POLARITY, "pitch's"),
        (-1.29, -0.55, True, FaultKind.POLARITY, "expected the other sign of both"),
        (0.9, 0.92, True, FaultKind.SLOPE, "expected 0.3 to 3"),
        (0.9, 0.92, False, None, ""),
    ],
)
def test_two_levels_identify_the_wrong_sign(first, second, known, kind, word):
    fault = Polarity(LIMITS, PAPERS, known=known).judge(*levels(first, second))
    assert (fault and fault.kind) is kind
    assert word in str(fault or "")


@pytest.mark.parametrize("wrong", WRONG)
@pytest.mark.parametrize("known", [True, False])
def test_a_wrong_sign_ends_below_2500_rpm_with_its_cause(new_rig, wrong, known):
    rig, log = new_rig(polarity=Polarity(LIMITS, PAPERS, known=known))
    rig.bench.calibration = WRONG[wrong]  # the loop's; the emulated rig keeps the right one
    rig._cycle.zero = WRONG[wrong].zero
    with pytest.raises(RunEnded, match=r"wrong polarity.*expected the other sign"):
        rig.start(4000.0, 2.0)
    assert log["omega"].max() < 2500.0
    assert duties(rig)[0] == IDLE[0]


@pytest.mark.parametrize("hidden", [("load_cell_gain",), ("lac_command_deadband",)])
def test_a_good_rig_passes_with_any_hidden_effect(hidden, tmp_path):
    values = {"load_cell_gain.gain": 1.4} if hidden == ("load_cell_gain",) else {}
    done = run_on_rig(setup(Emulated(values, hidden, seed=3)), KernelController(), step_profile(hold=0.3), tmp_path)
    assert not done.ended
    assert np.isfinite(done.record["thrust"]).all()


def test_a_second_opener_is_refused_and_writes_nothing(new_rig):
    rig, _ = new_rig()
    rig.start(3000.0, 2.0)
    before = duties(rig)
    with pytest.raises(Exception, match=r"rig: not ready: found in use by process \d+ .*; nothing written"):
        locked(rig.bench.esc.folder.parent)
    assert duties(rig) == before


@pytest.mark.parametrize(("file", "text"), [("enable", "0\n"), ("period", "20000000\n"), ("duty_cycle", "1900000\n")])
def test_an_output_that_somebody_else_writes_to_ends_the_run_at_idle(new_rig, file, text):
    rig, log = new_rig()
    rig.start(3000.0, 2.0)
    esc = rig.bench.esc
    (esc.folder / file).write_text(text)
    began = len(log.rows)
    with pytest.raises(RunEnded, match=r"esc: output lost.*expected 1, 2500000 ns, normal, .*somebody else writes here"):
        steps(rig, 3)
    assert len(log.rows) - began <= 2
    shown = [(esc.folder / name).read_text().split("\n")[0] for name in ("enable", "period", "duty_cycle")]
    assert shown == ["1", "2500000", str(IDLE[0])]
