"""The report's section on the fine-tuning (paper's figures 7 and 8)."""

import numpy as np

from vpp_fmu.kernel.plant import BASE, FINE_TUNED
from vpp_fmu.paper import figures
from vpp_fmu.paper.fine_tuning import by_part, parts, thrust
from vpp_fmu.paper.study import Study
from vpp_fmu.report import Page, measured_against_predicted, thinning

INITIAL, DESCENT, OURS, PUBLISHED = "initial", "the paper's descent", "fine-tuned", "paper's published model"

PARTS = {"8a": ("speed only", "speed"), "8b": ("pitch only", "pitch"), "8c": ("both", "both inputs")}
"""The paper's figure for each part of the record, and what is in action there."""


def add_fine_tuning(page: Page, study: Study) -> dict[str, int]:
    """Learning curve, and the open-loop record in its three parts."""
    page.section("Fine-tuning (figures 7, 8)")
    rig, model = study.fine_tuning, study.fine_tuning_model
    noise = 0.5 * (study.found.noise.std / BASE.values()["thrust_scale"]) ** 2
    took, count = len(rig.ours.curve) - 1, len(rig.costs) - 1
    title = (
        f"The paper's descent takes {rig.fall[0]:.0f} % off the cost in {count} iterations; ours {rig.fall[1]:.0f} % in {took}"
    )
    caption = (
        f"Descent {rig.seconds:.2f} s, ours {rig.ours.seconds:.2f} s. The paper's record is not published: its model under "
        "this record's commands, with noise that leaves the paper's final cost, stands for it."
    )
    places = {"7": page.figure(figures.learning_curves(rig, model, noise, title), caption)}
    errors = by_part(rig.record, models(study))
    for number, (part, name) in PARTS.items():
        places[number] = _add_part(page, study, parts(rig.record)[part], name, errors[part])
    page.table(
        ("part", *(f"{name} [N]" for name in models(study))),
        [(part, *own.values()) for part, own in errors.items()],
        f"Thrust error, rms, of the record that was fitted; noise of one reading {study.found.noise.std:.3f} N. Fine-tuned: "
        "this project's identification, of this record and its repeat together.",
    )
    return places


def models(study: Study) -> dict[str, dict[str, float]]:
    """Parameters of the models that are compared, by what they are called."""
    tuned = study.fine_tuning
    return {
        INITIAL: dict(tuned.start),
        DESCENT: dict(tuned.values),
        OURS: study.found.parameters.values,
        PUBLISHED: FINE_TUNED,
    }


def _add_part(page: Page, study: Study, rows: np.ndarray, name: str, errors: dict[str, float]) -> int:
    record = study.fine_tuning.record
    lines = {label: thrust(record, own)[rows] for label, own in models(study).items() if label != DESCENT}
    title = f"{name.capitalize()} in action: {errors[INITIAL]:.3f} N before, {errors[OURS]:.3f} N after fine-tuning"
    figure = measured_against_predicted(
        record.time[rows],
        record["thrust"][rows],
        lines,
        title,
        commands={n: record[n][rows] for n in ("omega_ref", "beta_ref")},
        noise=study.found.noise.std,
    )
    caption = "The published model is that of the paper's blades and actuator, not of these. "
    return page.figure(figure, caption + thinning(len(rows)))
