"""The guided calibration: its line fit in closed form, and scripted answers on an emulated rig with known parameters."""

import contextlib
import json
from dataclasses import replace

import numpy as np
import pytest
from rigs import CALIBRATION

from hil.calibrate import CalibrationRefused, G, line, pitched, started, weighed
from hil.devices.calibration import never_measured, read_calibration, to_json
from hil.emulator.rig import ZERO_SHIFT, virtual_bench
from hil.emulator.rig import EmulatedRig as Emulated

TRUTH = replace(
    CALIBRATION,
    newton_per_count=-0.00231,
    zero=9000.0,
    esc_idle=1.06e-3,
    pitches=tuple(0.5 + 0.9 * pitch for pitch in CALIBRATION.pitches),
    pitch_min=-10.0,
    pitch_max=10.0,
)
"""A rig that differs from its driver's calibration: slope and its sign, zero, idle pulse and pitch table."""


class Person:
    """Follows all requests, and reads the pitch of a rod with `play` [deg] to 0.1 deg."""

    def __init__(self, play=0.0):
        self.asked, self._play, self._before = [], play, 0.0

    def do(self, what):
        self.asked.append(what)

    def read(self, what):
        pulse = 1e-6 * float(what.split()[2])
        rising = self._before <= pulse if self._before != pulse else False
        self._before = pulse
        return round(TRUTH.pitch(pulse) + (-0.5 if rising else 0.5) * self._play, 1)


@pytest.fixture
def bench():
    one = virtual_bench(Emulated(seed=3), CALIBRATION, TRUTH)
    yield one
    one.close()


def test_the_line_residuals_and_hysteresis_are_those_of_the_textbook():
    forces, counts = (0.0, 5.0, 10.0, 5.0, 0.0), (1000.0, 1995.0, 3000.0, 2005.0, 1000.0)
    found = line(forces, counts)
    slope, zero = np.polyfit(forces, counts, 1)
    assert (1.0 / found.newton_per_count, found.zero) == pytest.approx((slope, zero))
    assert found.hysteresis == pytest.approx(10.0 / 200.0)
    assert found.residuals == pytest.approx([0.0, -0.025, 0.0, 0.025, 0.0], abs=1e-9)
    variance = 50.0 / 3.0 / np.sum((np.array(forces) - 4.0) ** 2)
    assert found.std == pytest.approx(np.sqrt(variance) / 200.0**2)
    with pytest.raises(CalibrationRefused, match="slope: found"):
        line((0.0, 5.0, 10.0), (1000.0, 1000.0, 1000.0))
    with pytest.raises(CalibrationRefused, match="3 readings under 1 weights"):
        line((5.0, 5.0, 5.0), (1.0, 2.0, 3.0))


@pytest.mark.parametrize("with_thrust", [False, True])
def test_the_load_cells_truth_is_found(bench, with_thrust):
    person = Person()
    found = weighed(bench, person, (0.0, 0.5, 1.0, 1.5), with_thrust)
    assert found.forces[3] == pytest.approx((1.0 if with_thrust else -1.0) * 1.5 * G)
    assert abs(found.newton_per_count - TRUTH.newton_per_count) < 4.0 * found.std
    assert found.newton_per_count == pytest.approx(TRUTH.newton_per_count, rel=5e-3)
    assert found.zero == pytest.approx(TRUTH.zero + ZERO_SHIFT, abs=20.0)
    assert max(map(abs, found.residuals)) < 0.06
    assert [what.split()[1] for what in person.asked if what.startswith("hang")] == ["0.5", "1", "1.5", "1", "0.5"]


def test_the_pitch_table_is_the_middle_of_the_play(bench):
    found = pitched(bench, Person(play=0.4), TRUTH.pulses)
    assert found.pitches == pytest.approx(TRUTH.pitches, abs=0.051)
    assert found.play == pytest.approx(0.4, abs=0.11)
    assert bench.lac.duty_file.read_text().split()[0] == str(round(1e9 * CALIBRATION.lac_idle))


def test_a_pitch_that_does_not_follow_is_refused(bench):
    person = Person()
    person.read = lambda what: 3.0
    with pytest.raises(CalibrationRefused, match="rise only or to fall only"):
        pitched(bench, person, TRUTH.pulses)


def test_the_pulse_at_which_the_motor_starts(bench, tmp_path):
    found = started(bench, tmp_path / "supervisor.log", supervised=False)
    assert TRUTH.esc_idle < found < TRUTH.esc_idle + 40e-6
    assert bench.esc.duty_file.read_text().split()[0] == str(round(1e9 * CALIBRATION.esc_idle))


def test_a_motor_that_turns_at_idle_is_refused(tmp_path):
    lower = replace(CALIBRATION, esc_idle=0.9e-3)
    with (
        contextlib.closing(virtual_bench(Emulated(seed=3), CALIBRATION, lower)) as one,
        pytest.raises(CalibrationRefused, match="idle pulse of 1000 us"),
    ):
        started(one, tmp_path / "supervisor.log", supervised=False)


def answers(parts=("load_cell", "pitch", "esc")):
    lines = []
    if parts != ("esc",):
        lines += ["# the emergency stop is pressed", ""]
    if "load_cell" in parts:
        lines += ["0 0.5 1 1.5", "against", *[""] * 7, "", ""]
    if "pitch" in parts:
        readings = [f"{pitch:g}" for pitch in CALIBRATION.pitches]
        lines += ["", *readings, *reversed(readings)]
    return [*lines, *["", "bare"] * ("esc" in parts)]


def answered(folder, lines):
    """Words of the command with these answers in a file."""
    (folder / "answers.txt").write_text("\n".join(lines) + "\n")
    given = ["--virtual", "--answers", folder / "answers.txt", "--operator", "Ada"]
    return ["hil", "calibrate", *given, "-o", folder / "out"]


def test_the_command_writes_a_calibration_with_who_when_and_residuals(tmp_path, printed):
    assert "residuals" in printed(*answered(tmp_path, answers()))
    found = read_calibration(tmp_path / "out" / "calibration.json")
    assert never_measured(found) == []
    assert found.newton_per_count == pytest.approx(CALIBRATION.newton_per_count, rel=5e-3)
    assert found.pitches == CALIBRATION.pitches
    assert CALIBRATION.esc_idle - 20e-6 < found.esc_idle < CALIBRATION.esc_idle + 20e-6
    assert {section: found.source[section]["who"] for section in ("load_cell", "esc", "pitch")} == dict.fromkeys(
        ("load_cell", "esc", "pitch"), "Ada"
    )
    assert len(found.source["load_cell"]["residuals_N"]) == 7
    assert "rising and falling apart" in (tmp_path / "out" / "report.html").read_text().lower()
    first = (tmp_path / "out" / "calibration.json").read_text()
    printed(*answered(tmp_path, answers()))  # the same rig and answers: the same numbers
    again = json.loads((tmp_path / "out" / "calibration.json").read_text())
    assert {k: v for k, v in again.items() if k != "source"} == {k: v for k, v in json.loads(first).items() if k != "source"}


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda lines: lines[:6], "the end of the input, expected an answer"),
        (lambda lines: [*lines[:2], "1 0.5", *lines[3:]], "line 3, weights to hang [kg] (Enter: 0 0.5 1 1.5): found 1 0.5"),
        (lambda lines: [*lines[:3], "sideways", *lines[4:]], "found sideways, expected with or against"),
        (lambda lines: [*lines[:-1], "spin"], "found spin, expected bare"),
        (lambda lines: [*lines[:14], "steep", *lines[15:]], "found steep, expected a number"),
    ],
)
def test_wrong_answers_are_reported_in_one_line_and_nothing_is_written(tmp_path, refused, change, said):
    assert said in refused(*answered(tmp_path, change(answers())))
    assert not (tmp_path / "out" / "calibration.json").exists()


def test_a_calibration_that_was_never_measured_drives_no_real_rig(tmp_path, refused):
    path = tmp_path / "c.json"
    path.write_text(to_json(replace(CALIBRATION, source={"load_cell": {"who": "Ada", "when": "2026-03-07"}})))
    said = refused("hil", "campaign", "--rig", "real", "--calibration", path, "-o", tmp_path / "out")
    assert "source: found no operator and date for esc, pitch" in said
