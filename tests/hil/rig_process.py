"""A closed loop on the emulated rig in real time, as a separate process for fault injection: `rig_process.py TASK`.

TASK is JSON: `folder` for the log, `seconds` of profile, `swing` (thrust steps instead of a constant set-point), `limits`
(changes), `physics` (`hidden`, `parameters`, `lingers`), `seed`, `fmu` (fault of its FMU once the file "now" exists in the
folder), `wrong` (part with the wrong sign in the loop's calibration: "load cell" or "pitch"), `refuse` (name of a PWM file
whose writes are refused), `twin` (reaction to its twin's alarm: "note", "ramp" or "idle"), `sabotage` (reaction of the
controller to SIGUSR1: "nan", "flat out", "clock back", or a pause of so many seconds). It prints a line of JSON with the paths
of the rig's files, one when the thrust has settled, and one at the end.
"""

import json
import signal
import sys
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from hil.devices.calibration import read_calibration
from hil.emulator import pwm_tree
from hil.emulator.faults import Saboteur
from hil.emulator.rig import EmulatedRig as Emulated
from hil.loop.session import Setup
from hil.run import ON_ALARM, run_on_rig
from hil.safety.limits import Limits
from hil.twin.band import Band
from hil.twin.twin import Twin, twin_of
from tests.hil.quick_vpp import shorten_waits
from tests.hil.stubborn import stubborn
from vpp_fmu.errors import VppError
from vpp_fmu.kernel.plant import plant
from vpp_fmu.parameters import ParameterSet
from vpp_fmu.plants import FmuController, KernelController
from vpp_fmu.record import Record

CALIBRATION = Path(__file__).parents[2] / "hil" / "emulator" / "calibration.json"
WRONG = json.loads(sys.argv[1]).get("wrong")
BAND = Band(0.12, 0.047, 0.13, steady=0.12)
"""Band of the paper's model on the emulated rig."""
SETTLED = 250
"""Steps of the controller after which the thrust has settled."""


def say(**message):
    print(json.dumps(message), flush=True)


class SpokenSetup(Setup):
    """A set-up that prints the paths of the rig's files."""

    def bench(self):
        bench = super().bench()
        own = bench.calibration
        if WRONG == "load cell":
            bench.calibration = replace(own, newton_per_count=-own.newton_per_count)
        elif WRONG == "pitch":
            bench.calibration = replace(own, pitches=own.pitches[::-1])
        say(esc=str(bench.esc.duty_file), at=str(bench.esc.duty_file.parents[3]), idle=bench.esc.idle_ns)
        return bench


class Asked(Saboteur):
    """A controller that fails as TASK says once SIGUSR1 arrives; it says when the thrust has settled."""

    def __init__(self, controller, sabotage):
        super().__init__(controller, sabotage)
        self._steps = 0
        signal.signal(signal.SIGUSR1, self._ask)

    def _ask(self, *_):
        self.asked = True

    def step(self, thrust_set, thrust):
        self._steps += 1
        if self._steps == SETTLED:
            say(running=True)
        return super().step(thrust_set, thrust)


def profile(seconds, swing):
    times = np.arange(0.0, seconds + 1.0, 1.0)
    wanted = np.where((times > 1.0) & (times % 2.0 > 0.5), 10.0, 5.0) if swing else np.full(len(times), 6.0)
    return Record({"time": times, "thrust_set": wanted}, "faults")


def main(task):
    signal.signal(signal.SIGQUIT, signal.SIG_DFL)  # a shell ignores it in background jobs
    if refuse := task.get("refuse"):
        pwm_tree.attached = partial(pwm_tree.attached, refuse=lambda file: file == refuse)
    physics = task.get("physics", {})
    hidden, seed = tuple(physics.get("hidden", ())), task.get("seed", 1)
    emulated = Emulated(physics.get("parameters", {}), hidden, seed, physics.get("lingers", 0.0))
    setup = SpokenSetup(read_calibration(CALIBRATION), Limits(**task.get("limits", {})), emulated)
    folder, how = Path(task["folder"]), task.get("fmu")
    within = FmuController(stubborn(folder, how, folder / "now")) if how else KernelController()
    controller = Asked(within, task.get("sabotage"))
    try:
        twin = Twin(twin_of(ParameterSet(plant()), BAND), on_alarm=ON_ALARM[task["twin"]]) if "twin" in task else None
        done = run_on_rig(setup, controller, profile(task["seconds"], task.get("swing")), folder, twin=twin)
    except VppError as error:
        say(ended=str(error), state="safe", transitions=[], counters={}, lost=0)
        return
    one, facts, omega = done.session, done.session.summary(), done.record["omega"][SETTLED:]
    jump = float(np.abs(np.diff(omega)).max()) if len(omega) > 1 else 0.0
    say(
        ended=done.ended,
        state=one.rig.states.state.value,
        transitions=facts["transitions"],
        counters=facts["counters"],
        lost=one.logged.lost,
        failure=one.logged.failure,
        jump=jump,
        missed=one.rig.ticks.missed,
    )


if __name__ == "__main__":
    shorten_waits()  # there are fifty faults to test
    main(json.loads(sys.argv[1]))
