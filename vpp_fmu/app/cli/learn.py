"""Learn a control law, a small network, on plants drawn from the parameters' uncertainty; compare it with the tuned PID.

An evolution strategy (cma) searches the weights on the compiled loop. The comparison uses plants, set-points and noise that
are not part of the search. `vpp export --policy` makes an FMU of the law, which falls back on the PID while an observation is
outside the range of the training."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from tqdm import tqdm

from identification.tune.controllers import controllers
from identification.tune.learn import LearnedLaw, learn, random_steps
from identification.tune.profile import rig_profile
from identification.tune.tune import TuningTask, chain_of, tune
from vpp_fmu.app.cli.answer import Answer
from vpp_fmu.app.cli.inputs import add_gains, add_knowledge, knowledge_of, noise_in, read_gains, read_plant
from vpp_fmu.app.cli.options import SEED, Number, whole
from vpp_fmu.app.cli.output import add_effects_from, add_output, written
from vpp_fmu.app.report.pages.learning import headline, key_figures, learning_page
from vpp_fmu.files import OutputFolder
from vpp_fmu.outputs import OutputSet
from vpp_fmu.parameters import POLICY, ParameterSet, parameters_file
from vpp_fmu.structured import as_json

EXAMPLE = "vpp learn out/parameters.json --generations 500 -o policy"

FORMAT = "vpp-learning/1"


def configure(parser):
    text = "the plant's parameters, a file or its folder"
    parser.add_argument("parameters", type=parameters_file, metavar="PARAMETERS", help=text)
    add_effects_from(parser)
    text = "the PID to compare with and to fall back on (default: tuned here on set-points of the same kind)"
    add_gains(parser, text)
    text = "identification.json: correlation of the parameters, noise of thrust (default: the one beside PARAMETERS)"
    add_knowledge(parser, text)
    text = "generations of the search (default: %(default)s, about five minutes on two cores)"
    parser.add_argument("--generations", type=whole(1, 10**6), default=1000, metavar="N", help=text)
    text = "units of the network's hidden layer (default: %(default)s)"
    parser.add_argument("--hidden", type=whole(1, 64), default=6, metavar="N", help=text)
    text = "held-out plants of the comparison (default: %(default)s)"
    parser.add_argument("--plants", type=whole(2, 10000), default=100, metavar="N", help=text)
    text = "overshoot in %% of a step that costs nothing (default: %(default)g)"
    parser.add_argument("--overshoot", type=Number(0.01, 100.0, "%"), default=5.0, metavar="X", help=text)
    text = "standard deviation, as a share, of parameters whose file has none (default: %(default)g)"
    parser.add_argument("--spread", type=Number(0.0, 1.0), default=0.1, metavar="X", help=text)
    parser.add_argument("--seed", type=SEED, default=0, metavar="N", help="of plants, set-points, noise and search")
    add_output(parser)


def run(options):
    parameters, given = read_plant(options), read_gains(options)
    known_in, knowledge = knowledge_of(options, parameters)
    task, settings = task_of(
        parameters,
        (given, options.gains),
        knowledge=knowledge and knowledge[0],
        noise_std=noise_in(known_in),
        overshoot=options.overshoot / 100.0,
        spread=options.spread,
        seed=options.seed,
        effects_from=tuple(options.effects_from),
    )
    folder = OutputSet(options.output, "learn")
    with tqdm(total=100, unit="%", disable=None, leave=False) as bar:
        size = options.hidden, options.generations, options.plants
        found = learn(task, settings, *size, lambda share: bar.update(round(100 * share) - bar.n))
    write_learning(folder, found, parameters.label)
    return Answer(headline(found), summary(found), figures=key_figures(found), written=written(options, folder, parameters))


def write_learning(folder: OutputFolder, found: LearnedLaw, source: str) -> None:
    """All files of a learned law; `source`: of the parameters."""
    folder.write(POLICY, as_json(found.policy.to_dict()))
    rows = [f"{n},{c:.7g}" for n, c in zip(found.evaluations, found.cost, strict=True)]
    folder.write("learning_curve.csv", "\n".join(["evaluations,cost", *rows]) + "\n")
    folder.write("learning.json", as_json(summary(found)))
    folder.write("report.html", learning_page(found, source).html())


def task_of(
    parameters: ParameterSet, gains: tuple[ParameterSet | None, str | None], **known
) -> tuple[TuningTask, Mapping[str, float]]:
    """The task and all values of the PID: the given `gains` (values, their source), or tuned on set-points of the same kind.
    `known`: fields of the task."""
    given, source = gains
    own = controllers(parameters, given, source=source or "gains")
    name, settings = next(iter(own.settings.items()))
    task = TuningTask(
        parameters=parameters,
        profile=rig_profile(parameters, own.settings),
        chain=chain_of(parameters, settings["sample_time"]),
        reference=own.reference,
        lowered=own.scaled,
        **known,
    )
    if given is not None:
        return task, settings
    tuned = tune(replace(task, profile=random_steps(task, settings)), {name: settings}).tuned[name]
    return task, tuned.objective.with_gains(tuned.final)


def summary(found: LearnedLaw) -> dict:
    """The content of learning.json."""
    compared = {
        name: {
            "squared_error_mean": float(np.mean(f.errors)),
            "squared_error_worst": float(np.max(f.errors)),
            "overshoot_median": float(np.median(f.overshoots)),
            "travel_per_second": f.travel,
        }
        for name, f in found.flights.items()
    }
    return {
        "format": FORMAT,
        "units": {"squared_error": "s", "overshoot": "share of a step", "travel": "ranges of the commands"},
        "network": list(found.policy.size),
        "held_out_plants": len(found.flights["policy"].errors),
        "held_out": compared,
        "share_of_plants_with_less_error": found.better,
        "share_of_time_in_fallback": found.fallback,
        "generations": len(found.cost),
        "evaluations": int(found.evaluations[-1]),
        "seconds": found.seconds,
    }
