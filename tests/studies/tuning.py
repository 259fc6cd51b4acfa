"""python -m tests.studies tuning: are tuned gains better than the published ones, and robust ones better in the worst case?

The paper's model with its assumed pitch actuator, through an ideal loop as the paper has it and through the rig's measurement
chain; then plants drawn from the parameters' doubt. Robust gains are judged on 200 plants that no search has seen.
"""

import argparse
from collections.abc import Sequence

from identification.demo import example_folder, step_profile
from identification.fit.problem import Prior
from identification.identify import identify
from identification.tune.summary import NAMES, against, settling, told_margins
from identification.tune.tune import JUDGED, Task, Tuned, Tuning, tune
from vpp_fmu.campaign import read_campaign
from vpp_fmu.kernel.controller import DUAL, SPEED_ONLY
from vpp_fmu.kernel.measurement import CONVERSIONS, RESOLUTION
from vpp_fmu.kernel.plant import plant
from vpp_fmu.parameters import ParameterSet

STARTS = {"dual": DUAL, "speed_only": SPEED_ONLY}
ASSUMED = {"tau_beta_2": 0.05}
CHAIN = {"delay": 250.0 / CONVERSIONS, "resolution": RESOLUTION}
PAPER = "the paper: 0.1 to 0.8 reached in about 0.5 s without overshoot; down: superior with both actuators"
SECONDS = 10.0


def the_papers(**more) -> Task:
    """The task on the paper's model."""
    return Task(ParameterSet(plant()).replaced(ASSUMED), step_profile(), tuple(ASSUMED), **more)


def identified(**more) -> Task:
    """The task on the model that the example campaign gives, with its covariance."""
    found = identify(read_campaign(example_folder()))
    doubt = found.refinement.uncertainty
    knowledge = Prior(tuple(doubt.names), doubt.values, doubt.covariance)
    return Task(found.parameters.replaced(ASSUMED), step_profile(), tuple(ASSUMED), CHAIN, knowledge=knowledge, **more)


def with_dead_band(**more) -> Task:
    """The task on the paper's model with a dead band of the pitch command and a dead time, as a diagnosis would give them."""
    values = {**ASSUMED, "pitch_command_deadband.half_width": 1.7, "speed_delay.delay": 0.02}
    std = {"pitch_command_deadband.half_width": 0.3, "speed_delay.delay": 0.005}
    parameters = ParameterSet(plant(["pitch_command_deadband", "speed_delay"])).replaced(values, std)
    return Task(parameters, step_profile(), tuple(ASSUMED), CHAIN, **more)


def show(title: str, found: Tuning) -> None:
    """Cost, steps and margins of published and tuned gains."""
    print(f"\n{title}. Aim: the tuned cost is no higher than the published gains' on the same objective.")
    for name, tuned in found.tuned.items():
        start, cost = tuned.cost("start"), tuned.cost("tuned")
        print(f"  {NAMES[name]:16} cost {start:.5f} -> {cost:.5f} {'yes' if cost <= start else 'NO'}")
        for which in ("start", "tuned"):
            print(f"    {found.task.reference if which == 'start' else which:10} {_told(tuned, which)}")
        least, note = told_margins(tuned, found.task.reference)
        print(f"    {'margins':10} {least} ({note})")
    print(f"  {PAPER}")
    print(
        f"  aim <= {SECONDS:g} s: {found.seconds:.1f} s; thrust through the FMUs differs by {_difference(found):.2g} N at most"
    )


def show_against(found: Tuning) -> None:
    """Both actuators against speed alone."""
    print("\nBoth actuators against speed alone, tuned gains. Aim: better down.")
    for row in against(found):
        told = [f"{settling(row[n]['settling'])}, squared error {row[n]['squared_error']:.4f} s" for n in found.tuned]
        print(f"  {row['before']:4.3g} -> {row['after']:4.3g} N: {told[0]} against {told[1]}")


def show_robust(title: str, found: Tuning) -> None:
    """Nominal and robust gains on plants that no search has seen."""
    print(f"\n{title}. Aim: robust gains have the lower worst cost of {JUDGED} other plants.")
    for name, tuned in found.tuned.items():
        nominal, robust = tuned.judged["tuned"], tuned.judged["robust"]
        price = tuned.cost("robust") / tuned.cost("tuned") - 1.0
        better = "yes" if robust.max() < nominal.max() else "NO"
        print(
            f"  {NAMES[name]:16} worst {nominal.max():.5f} -> {robust.max():.5f} {better}, mean {nominal.mean():.5f} -> "
            f"{robust.mean():.5f}; price on the nominal plant {price:+.2%}"
        )
        worst, over = tuned.judged["start"].max(), {which: 100.0 * each.max() for which, each in tuned.overshoots.items()}
        sensitivity = max(m.sensitivity for m in tuned.margins["start"])
        print(
            f"    largest overshoot {over['tuned']:.1f} -> {over['robust']:.1f} %; published gains: worst {worst:.5f}, "
            f"{over['start']:.1f} %, sensitivity {sensitivity:.2f} where the tuned ones keep {found.task.sensitivity:g}"
        )
    print(f"  {found.seconds:.1f} s")


def _told(tuned: Tuned, which: str) -> str:
    steps = (f"{settling(s.settling)} overshoot {s.overshoot:.1f} %" for s in tuned.objective.steps(tuned.gains[which]))
    gains = ", ".join(f"{n} {g:.4g}" for n, g in zip(tuned.objective.names, tuned.gains[which], strict=True))
    return f"{'; '.join(steps)} ({gains})"


def _difference(found: Tuning) -> float:
    return max(tuned.fmu_difference for tuned in found.tuned.values())


def main(argv: Sequence[str] | None = None) -> None:
    """Run the study."""
    parser = argparse.ArgumentParser(prog="python -m tests.studies tuning", description=__doc__)
    parser.add_argument("--workers", type=int, default=1, metavar="N", help="searches side by side")
    parser.add_argument("--draws", type=int, default=200, metavar="N", help="plants that robust gains are tuned on")
    options = parser.parse_args(argv)
    show("The paper's model, ideal measurement", tune(the_papers(), STARTS, options.workers))
    found = tune(the_papers(chain=CHAIN), STARTS, options.workers)
    show("The paper's model through the rig's converter", found)
    show_against(found)
    more = {"robust": "worst", "draws": options.draws}
    for title, task in (
        ("The paper's model, every parameter known to 10 %", the_papers(chain=CHAIN, **more)),
        ("The example campaign's model, with its covariance", identified(**more)),
        ("The paper's model with a dead band and a dead time", with_dead_band(**more)),
    ):
        show_robust(title, tune(task, STARTS, options.workers))
