"""python -m tests.studies tuning: are tuned gains better than those they start from, and robust ones better in the worst case?

Cases: the paper's model with its assumed pitch actuator, through an ideal loop as the paper has it and through the rig's
measurement chain; the same model on rigs of 1.2 N and 180 N, three times as fast and as slow; the diagnosed model of the
example campaign; then plants drawn from the parameters' uncertainty. Robust gains are judged on 200 held-out plants.
"""

from collections.abc import Mapping

from identification.demo import example_folder
from identification.diagnose.diagnose import diagnose
from identification.fit.problem import Prior
from identification.identify import identify
from identification.tune.controllers import controllers
from identification.tune.profile import rig_profile
from identification.tune.summary import NAMES, against, change_rows, labels, margin_rows, settling
from identification.tune.tune import JUDGED, Task, Tuning, tune
from identification.tune.verdict import UNITS
from vpp_fmu.campaign import read_campaign
from vpp_fmu.kernel.measurement import CONVERSIONS, RESOLUTION
from vpp_fmu.kernel.plant import FINE_TUNED, plant
from vpp_fmu.kernel.scales import PAPER as PAPERS_SCALES
from vpp_fmu.kernel.scales import Scales
from vpp_fmu.parameters import ParameterSet
from vpp_fmu.rig import Rig

ASSUMED = {"tau_beta_2": 0.05}
CHAIN = {"delay": 250.0 / CONVERSIONS, "resolution": RESOLUTION}
PAPER = "the paper: 0.1 to 0.8 reached in about 0.5 s without overshoot; down: superior with both actuators"
SECONDS = 10.0

MICRO, LARGE = Scales(20000.0, 20.0, 6.0, 1.2, 0.15), Scales(2500.0, 20.0, -6.0, 180.0, 1.5)


def a_task(parameters: ParameterSet, chain: Mapping[str, float] = CHAIN, **more) -> Task:
    """The task on a plant's parameters, with the profile of its rig."""
    own = controllers(parameters)
    profile = rig_profile(parameters, own.settings)
    resolution = chain.get("resolution", 0.0) * parameters.values["thrust_scale"] / PAPERS_SCALES.thrust_scale
    more |= {"reference": own.reference, "lowered": own.scaled}
    return Task(parameters, profile, tuple(ASSUMED), {**chain, "resolution": resolution}, **more)


def tuned(task: Task, workers: int) -> Tuning:
    """Tune the task's controllers."""
    return tune(task, controllers(task.parameters).settings, workers)


def the_papers() -> ParameterSet:
    """The paper's model."""
    return ParameterSet(plant()).replaced(ASSUMED)


def elsewhere(scales: Scales, slower: float) -> ParameterSet:
    """The paper's model on a rig of other scales, `slower` times as slow."""
    values = {**FINE_TUNED, **ASSUMED}
    lags = {name: slower * value for name, value in values.items() if name.startswith("tau")}
    speed, pitch = ((scales.omega_scale / 3.0, scales.omega_scale), tuple(scales.absolute(b, "position") for b in (0.0, 1.0)))
    rig = Rig(speed=speed, pitch=pitch, thrust=(0.0, scales.thrust_scale), scales=scales)
    return ParameterSet(plant(scales=scales), source={"rig": rig.summary()}).replaced(lags)


def diagnosed() -> ParameterSet:
    """The diagnosed parameters of the example campaign."""
    found = diagnose(read_campaign(example_folder()))
    return found.parameters(found.final).replaced(ASSUMED)


def identified(**more) -> Task:
    """The task on the model that the example campaign gives, with its covariance."""
    found = identify(read_campaign(example_folder()))
    uncertainty = found.refinement.uncertainty
    knowledge = Prior(tuple(uncertainty.names), uncertainty.values, uncertainty.covariance)
    return a_task(found.parameters.replaced(ASSUMED), knowledge=knowledge, **more)


def with_dead_band(**more) -> Task:
    """The task on the paper's model with a dead band of the pitch command and a dead time, as a diagnosis would give them."""
    values = {**ASSUMED, "pitch_command_deadband.half_width": 1.7, "speed_delay.delay": 0.02}
    std = {"pitch_command_deadband.half_width": 0.3, "speed_delay.delay": 0.005}
    return a_task(ParameterSet(plant(["pitch_command_deadband", "speed_delay"])).replaced(values, std), **more)


def show(title: str, found: Tuning) -> None:
    """Steps, margins, cost and verdict, before and after."""
    wanted = found.task.profile["thrust_set"]
    print(f"\n{title}: {wanted.min():.4g} to {wanted.max():.4g} N. Aim: no step worse; {found.task.reference} -> tuned.")
    for name, each in found.tuned.items():
        verdict = each.verdicts["tuned"]
        worse = sum(c.worse for s in verdict.steps for c in s.changes)
        print(f"  {NAMES[name]:16} {'yes' if verdict.better else 'NO'}, {worse} figures worse; {verdict.words()}")
        for step, *changes in change_rows(verdict):
            print(f"    {step}: {', '.join(f'{n} {c}' for n, c in zip(UNITS, changes, strict=True))}")
        print(f"    {', '.join(f'{margin} {change}' for margin, change in margin_rows(verdict))}")
        print(f"    cost {each.cost('start'):.4g} -> {each.cost('tuned'):.4g}, handed out: {labels(found, each)[each.chosen]}")
    off = max(each.fmu_difference for each in found.tuned.values())
    print(f"  aim <= {SECONDS:g} s: {found.seconds:.1f} s; thrust through the FMUs differs by {off:.2g} N at most")


def show_against(found: Tuning) -> None:
    """Both actuators against speed alone."""
    print("\nBoth actuators against speed alone, tuned gains. Aim: better down.")
    for row in against(found):
        texts = [f"{settling(row[n]['settling'])}, squared error {row[n]['squared_error']:.4f} s" for n in found.tuned]
        print(f"  {row['before']:4.3g} -> {row['after']:4.3g} N: {texts[0]} against {texts[1]}")


def show_robust(title: str, found: Tuning) -> None:
    """Nominal and robust gains on held-out plants."""
    print(f"\n{title}. Aim: robust gains have the lower worst cost of {JUDGED} other plants.")
    for name, each in found.tuned.items():
        nominal, robust = each.judged["tuned"], each.judged["robust"]
        price = each.cost("robust") / each.cost("tuned") - 1.0
        better = "yes" if robust.max() < nominal.max() else "NO"
        handed = labels(found, each)[each.chosen]
        print(
            f"  {NAMES[name]:16} handed out: {handed}\n    worst {nominal.max():.5f} -> {robust.max():.5f} {better}, "
            f"mean {nominal.mean():.5f} -> {robust.mean():.5f}; price on the nominal plant {price:+.2%}"
        )
        worst, over = each.judged["start"].max(), {which: 100.0 * o.max() for which, o in each.overshoots.items()}
        sensitivity = max(m.sensitivity for m in each.margins["start"])
        print(
            f"    largest overshoot {over['tuned']:.1f} -> {over['robust']:.1f} %; published gains: worst {worst:.5f}, "
            f"{over['start']:.1f} %, sensitivity {sensitivity:.2f} where the tuned ones keep {found.task.sensitivity:g}"
        )
    print(f"  {found.seconds:.1f} s")


def main(parser, arguments):
    parser.add_argument("--workers", type=int, default=1, metavar="N", help="searches side by side")
    parser.add_argument("--draws", type=int, default=200, metavar="N", help="plants that robust gains are tuned on")
    options = parser.parse_args(arguments)
    ideal = a_task(the_papers(), chain={})
    show("The paper's model, ideal measurement", tuned(ideal, options.workers))
    found = tuned(a_task(the_papers()), options.workers)
    show("The paper's model through the rig's converter", found)
    print(f"  {PAPER}")
    show_against(found)
    show("1.2 N at 20 000 rpm, three times as fast", tuned(a_task(elsewhere(MICRO, 1.0 / 3.0)), options.workers))
    show("180 N at 2500 rpm, three times as slow", tuned(a_task(elsewhere(LARGE, 3.0)), options.workers))
    show("The example campaign's model, diagnosed", tuned(a_task(diagnosed()), options.workers))
    more = {"robust": "worst", "draws": options.draws}
    for title, task in (
        ("The paper's model, every parameter known to 10 %", a_task(the_papers(), **more)),
        ("The example campaign's model, with its covariance", identified(**more)),
        ("The paper's model with a dead band and a dead time", with_dead_band(**more)),
    ):
        show_robust(title, tuned(task, options.workers))
