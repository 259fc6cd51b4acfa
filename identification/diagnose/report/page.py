"""The report of a diagnosis: its first screen says which effect, how large, the error before and after, and how sure."""

from collections.abc import Mapping, Sequence

import numpy as np

from identification.diagnose.diagnose import Diagnosis
from identification.diagnose.empirical import Empirical, corrected
from identification.diagnose.evidence.noise import blocks
from identification.diagnose.report.effect import add_effects
from identification.diagnose.report.evidence import add_apart, add_evidence, add_shift
from identification.diagnose.report.residual import add_residual
from identification.diagnose.report.summary import summary
from vpp_fmu.digits import interval, number, signed
from vpp_fmu.record import Record
from vpp_fmu.report import Page, measured_against_predicted, residual_by_section, thinning

SURE = {
    "attributed": "one set of effects explains it",
    "family": "these data can't tell the named effects from others",
    "partly": "the named effect explains a part of it, or something near it does",
    "unexplained": "no effect to choose from explains it",
    "none": "nothing above the noise is missing",
}

UNTOLD = "not told by these records"

ZOOM, SMOOTHED = 3.0, 0.2
"""s to both sides of a worst moment; it is the worst mean over so many s."""


def headline(found: Diagnosis) -> str:
    """The finding in one or two sentences."""
    before, after = found.held_before.rmse_thrust, found.held_after.rmse_thrust
    noise = f"the noise is {number(found.noise.floor)} N"
    if found.verdict == "none":
        return f"Nothing is missing: the thrust error on unseen data is {number(before)} N, {noise}."
    if found.verdict == "unexplained":
        return f"Something is missing that no effect to choose from explains: {number(before)} N on unseen data, {noise}."
    described = {e.name: e.description for e in found.final.evidence.model.effects}
    effects = " and ".join(f"{name} ({described[name]})" for name in found.final.effects)
    return f"{effects}: thrust error on {_unseen(found)} {number(before)} N before, {number(after)} N after, {noise}."


def _unseen(found: Diagnosis) -> str:
    """What the errors are of. A record that told where a parameter is, is no longer unseen in that."""
    told = " and ".join(n for n in found.selection.placed if n in found.final.values)
    return f"data that no fit saw, but that placed {told}," if told else "unseen data"


def key_figures(found: Diagnosis) -> list[tuple[str, str, str]]:
    """(label, value, note) of what a reader must know first."""
    figures = []
    for effect in summary(found)["effects"]:
        for name, p in effect["parameters"].items():
            if name == "form":
                continue
            note = _known(p, effect["intervals"].get(name))
            note += ", its place told by the unseen record" if name in effect["placed_by_unseen_data"] else ""
            unit = "" if p["unit"] == "1" else f" {p['unit']}"
            figures.append((f"{effect['name']}, {name}", f"{number(p['value'])}{unit}", note))
    before, after = found.held_before.rmse_thrust, found.held_after.rmse_thrust
    change = f"{number(before)} → {number(after)} N" if found.final.effects else f"{number(before)} N"
    checked = "" if found.noise.verified else ", not verified by a repeat"
    figures.append((f"thrust error, {_unseen(found)}", change, f"noise of one reading {number(found.noise.floor)} N{checked}"))
    if found.given is not None:
        as_given = summary(found)["given"][0]["rmse_thrust"]
        figures.append(("the model as it was given", f"{number(as_given)} N", "thrust error on unseen data, before any fit"))
    if found.explained is not None:
        share, doubt = 100 * found.explained.share, 200 * found.explained.error
        figures.append(("of the explainable error", f"{share:.0f} %", f"± {doubt:.0f} %, removed on {_unseen(found)}"))
    rivals = [f"{name} could as well be {' or '.join(others)}" for name, others in found.family.items() if others]
    figures.append(("verdict", found.verdict, "; ".join(rivals) or SURE[found.verdict]))
    return [*figures, _where(found)] if found.verdict in ("partly", "unexplained") else figures


def _known(parameter: Mapping, ends: Sequence[float] | None) -> str:
    """How well a parameter is known: its interval where that was searched, else from its standard deviation, in its unit."""
    unit = "" if parameter["unit"] == "1" else parameter["unit"]
    if ends is not None:
        return f"95 %: {interval(*ends, unit)}"
    if parameter["std"] is None:
        return UNTOLD
    if parameter["std"] == 0.0:
        return "on its bound"
    half = 1.96 * parameter["std"]
    return f"95 %: {interval(parameter['value'] - half, parameter['value'] + half, unit)}"


def _where(found: Diagnosis) -> tuple[str, str, str]:
    """Where the error lives that nothing explains."""
    where = found.location
    band, section = (max(where[k], key=where[k].get) for k in ("share_by_band_hz", "mean_square_by_section"))
    strongest, largest = where["strongest_correlate"], where["largest"]
    note = f"most where {_commanded(section)}; goes with {strongest['signal']} ({strongest['correlation']:+.2f}); "
    note += f"up to {number(abs(largest['thrust']), 3)} N; input: {where['input']}"
    return "what is left", f"{band} Hz", note


def diagnosis_page(found: Diagnosis, correction: Empirical | None = None) -> Page:
    """The page of one diagnosis, and of an empirical correction where one was asked for."""
    page = Page(f"Diagnosis of {found.campaign.folder.name}", headline(found))
    page.tiles(key_figures(found))
    for effect, judged in found.selection.judgements.items():
        if effect in found.final.effects and judged.artefact:
            page.note(f"{effect}: {judged.artefact}.")
    page.section("Before and after" if found.final.effects else "The model on unseen data")
    for record in found.held:
        _add_whole(page, found, record)
    if correction is not None:
        _add_empirical(page, found, correction)
    add_diagnosis(page, found)
    return page


def add_diagnosis(page: Page, found: Diagnosis) -> None:
    """Figures and tables of a diagnosis, onto a page that shows the unseen record already."""
    page.section("The worst moments")
    for record in found.held:
        _add_worst(page, found, record)
    if found.final.effects:
        _add_sections(page, found)
        page.section("What the effect does")
        add_effects(page, found)
        add_shift(page, found)
    page.section("Why this, and not something else")
    add_evidence(page, found)
    page.section("What is left")
    add_residual(page, found)
    _add_location(page, found)
    page.section("What these commands can show")
    add_apart(page, found)
    if found.verdict not in ("none", "attributed"):
        page.note("next_experiment.csv holds a record of commands that separates what these could not. Run it twice.")


def _add_empirical(page: Page, found: Diagnosis, correction: Empirical) -> None:
    page.section("Beyond the library: an empirical correction")
    page.note(f"{correction.told[0].upper()}{correction.told[1:]}. It is in no parameter file and in no FMU.")
    if not correction.accepted:
        return
    record = found.held[0]
    shown = corrected(found, correction, record)
    lines = {"model": shown["thrust"], "empirical": shown["thrust_empirical"]}
    change = f"{number(correction.before)} to {number(correction.after)} N"
    title = f"A linear filter of the model's own outputs brings the error from {change}"
    page.figure(_figure(found, record, lines, title), "Unseen data. The filter was fitted to the open-loop record.")


def _add_whole(page: Page, found: Diagnosis, record: Record) -> None:
    shown = {name: found.prediction(fit, record) for name, fit in found.fits.items()}
    errors = [f"{number(p.rmse_thrust)} N" for p in shown.values()]
    erred = f"{errors[0]} before, by {errors[1]} after" if len(errors) > 1 else errors[0]
    title = f"On unseen data the model errs by {erred}; the noise alone is {number(found.noise.floor)} N"
    lines = {name: p.thrust for name, p in shown.items()}
    page.figure(_figure(found, record, lines, title), f"{record.source.rsplit('/', 1)[-1]}. {thinning(len(record))}")


def _add_worst(page: Page, found: Diagnosis, record: Record) -> None:
    """Where the model before was worst, and where the one after is, if that is elsewhere."""
    lines = {name: found.prediction(fit, record).thrust for name, fit in found.fits.items()}
    at = blocks(record, SMOOTHED)
    means = {name: np.abs(at.mean(thrust - record["thrust"])) for name, thrust in lines.items()}
    centers = [float(at.time[np.nanargmax(mean)]) for mean in means.values()]
    for name, center in dict(zip(means, centers, strict=True)).items():
        if name == "after" and abs(center - centers[0]) < ZOOM:
            continue  # in the same window
        block = int(np.argmin(np.abs(at.time - center)))
        there = " and ".join(f"{number(mean[block], 3)} N {other}" for other, mean in means.items()).removesuffix(" model")
        near = np.abs(record.time - center) <= ZOOM
        when = "" if name == "model" else f" {name}"
        title = f"The worst moment{when}, around {center:.0f} s: the error is {there}"
        part = {other: thrust[near] for other, thrust in lines.items()}
        page.figure(_figure(found, record.part(near), part, title), f"Six seconds around the worst mean over {SMOOTHED:g} s.")


def _figure(found: Diagnosis, record: Record, lines, title: str):
    commands = {n: record[n] for n in ("omega_ref", "beta_ref")}
    return measured_against_predicted(record.time, record["thrust"], lines, title, commands=commands, noise=found.noise.floor)


def _add_sections(page: Page, found: Diagnosis) -> None:
    record = found.held[0]
    before, after = (found.prediction(fit, record).summary()["sections"] for fit in (found.base, found.final))
    names = list(before)
    values = [np.array([each[n]["rmse_thrust"] for n in names]) for each in (before, after)]
    k = int(np.argmax(values[0] - values[1]))
    title = f"The error fell most where {_commanded(names[k])}: from {number(values[0][k])} to {number(values[1][k])} N"
    figure = residual_by_section(names, *values, found.noise.floor, title)
    page.figure(figure, "Thrust error by what is commanded, unseen data.")


def _followed(found: Diagnosis) -> str:
    rest = found.following
    yes = "yes" if rest.significant else "no more than noise would"
    return f"{yes}: log-likelihood {rest.gain:+.1f} of {rest.count} plays, bounds and rates of both channels"


def _commanded(section: str) -> str:
    return {"both": "both are commanded", "steady": "nothing is commanded"}.get(section, f"{section} is commanded")


def _add_location(page: Page, found: Diagnosis) -> None:
    where, what = found.location, "error of the base model" if not found.final.effects else "error that is left"
    strongest, largest = where["strongest_correlate"], where["largest"]
    page.table(
        ("what", "value"),
        [
            ("goes most with", f"{strongest['signal']}, {strongest['correlation']:+.2f}"),
            ("input", where["input"]),
            ("follows the commands still", _followed(found)),
            ("largest", f"{signed(largest['thrust'], 3)} N at {largest['time']:.1f} s"),
            *((f"share at {band} Hz", f"{100 * share:.0f} %") for band, share in where["share_by_band_hz"].items()),
            *((f"mean square, {n}", f"{number(max(p, 0.0), 3)} N²") for n, p in where["mean_square_by_section"].items()),
        ],
        f"Where the {what} lives, so far as it repeats.",
    )
