"""The paper's study from its campaign to its controllers, on the emulated rig and on the paper's own model."""

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass

from hil.campaign import Plan
from identification.fit.refine import BASE_PARAMETERS
from identification.identify import Identification, identify
from vpp_fmu.campaign import Campaign
from vpp_fmu.files import OutputFolder
from vpp_fmu.paper.averages import Averages, averages
from vpp_fmu.paper.control import Control, control
from vpp_fmu.paper.fine_tuning import FineTuning, fine_tuned, on_the_papers_model
from vpp_fmu.paper.recording import recorded
from vpp_fmu.paper.static import Statics, statics

FULL, REPEATS = Plan(before=5.0), 6
"""The paper's campaign; runs of each loop on the rig."""

QUICK, FEWER = Plan(points=4, settle=1.0, samples=100, levels=2, before=0.4, after=2.5, section=8.0, validation=8.0), 1
"""The same shape, smaller: fewer points, readings and steps, shorter records."""


@dataclass(frozen=True, eq=False)
class Study:
    """Everything that was found. `averages`: of step responses the paper's way; `fine_tuning`: of the open-loop record, and
    of a record of the paper's own model; `seconds` of each stage, by name."""

    plan: Plan
    seed: int
    campaign: Campaign
    found: Identification
    statics: Statics
    averages: Averages
    fine_tuning: FineTuning
    fine_tuning_model: FineTuning
    control: Control
    seconds: Mapping[str, float]

    @property
    def is_full(self) -> bool:
        """Whether the campaign is as large as the paper's."""
        return self.plan == FULL


class Stages:
    """Seconds of stages by name; `show` is told what is going on."""

    def __init__(self, show: Callable[[str], None] = lambda text: None):
        self.show, self.seconds, self._last = show, {}, time.perf_counter()

    def done(self, name: str) -> None:
        """The stage of that name has ended."""
        now = time.perf_counter()
        self.seconds[name], self._last = now - self._last, now


def study(folder: OutputFolder, plan: Plan, repeats: int, seed: int, stages: Stages) -> Study:
    """Measure the campaign into `folder` on the emulated rig, then do all that the paper did with it."""
    campaign = recorded(folder, plan, seed, stages.show)
    stages.done("campaign on the emulated rig")
    found = identify(campaign, seed=seed, stage=stages.show)
    stages.done("identification")
    held = statics(campaign.static, seed)
    stages.show("steps the paper's way")
    means = averages(campaign.steps, seed)
    stages.done("static map and steps the paper's way")
    stages.show("the paper's descent")
    tuned = fine_tuned(campaign.open_loop, {name: found.start[name] for name in BASE_PARAMETERS})
    tuned_model = on_the_papers_model(campaign.open_loop, seed)
    stages.done("fine-tuning the paper's way")
    loops = control(found.parameters, found.noise.std, seed, repeats, stages.show)
    stages.done("control")
    return Study(plan, seed, campaign, found, held, means, tuned, tuned_model, loops, stages.seconds)
