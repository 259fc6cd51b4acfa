"""The report of a diagnosis: its first screen says which effect, how large, the error before and after, and how sure."""

import numpy as np

from identification.diagnose.diagnose import Diagnosis
from identification.diagnose.noise import blocks
from identification.diagnose.summary import summary
from vpp_fmu.report import (
    Page,
    autocorrelation,
    correlation_heatmap,
    measured_against_predicted,
    residual_by_section,
    thinning,
)

SURE = {
    "attributed": "one set of effects explains it",
    "family": "these data can't tell the named effects apart",
    "partly": "a named effect explains part of it",
    "unexplained": "no effect of the library explains it",
    "none": "nothing above the noise is missing",
}


def headline(found: Diagnosis) -> str:
    """The finding in one sentence."""
    effects = " and ".join(found.final.effects) or "no effect"
    before, after = found.held_before.rmse_thrust, found.held_after.rmse_thrust
    noise = f"the noise is {found.noise.floor:.3f} N"
    if found.verdict == "none":
        return f"Nothing is missing: the thrust error on unseen data is {before:.3f} N, {noise}."
    if found.verdict == "unexplained":
        return f"Something is missing that is not in the library: {before:.3f} N on unseen data, {noise}."
    return f"{effects}: thrust error on unseen data {before:.3f} N before, {after:.3f} N after, {noise}."


def key_figures(found: Diagnosis) -> list[tuple[str, str, str]]:
    """(label, value, note) of what a reader must know first."""
    figures = [("verdict", found.verdict, SURE[found.verdict])]
    for effect in summary(found)["effects"]:
        for name, p in effect["parameters"].items():
            if name != "form":
                doubt = "" if p["std"] is None else f"± {1.96 * p['std']:.2g} (95 %)"
                figures.append((f"{effect['name']}, {name}", f"{p['value']:.4g} {p['unit']}", doubt))
    before, after = found.held_before.rmse_thrust, found.held_after.rmse_thrust
    figures.append(("thrust error, unseen data", f"{before:.3f} → {after:.3f} N", f"noise {found.noise.floor:.3f} N"))
    if found.explained is not None:
        figures.append(
            (
                "of the explainable error",
                f"{100 * found.explained.share:.0f} %",
                f"removed on unseen data, ± {200 * found.explained.error:.0f} %",
            )
        )
    return figures


def diagnosis_page(found: Diagnosis) -> Page:
    """The page of one diagnosis."""
    page = Page("Diagnosis", headline(found))
    page.tiles(key_figures(found))
    add_diagnosis(page, found)
    return page


def add_diagnosis(page: Page, found: Diagnosis) -> None:
    """Figures and tables of a diagnosis, onto a page."""
    page.section("Before and after")
    for record in found.held:
        _add_record(page, found, record)
    _add_sections(page, found)
    page.section("Why this, and not something else")
    _add_candidates(page, found)
    page.section("What is left")
    _add_remainder(page, found)
    page.section("What these commands can show")
    _add_apart(page, found)
    if found.verdict not in ("none", "attributed"):
        page.note("next_experiment.csv holds a record of commands that separates what these could not. Run it twice.")


def _add_record(page: Page, found: Diagnosis, record) -> None:
    before, after = (found.prediction(fit, record) for fit in (found.base, found.final))
    shown = {"before": before.thrust} | ({"after": after.thrust} if found.final.effects else {})
    title = f"Unseen data: {before.rmse_thrust:.3f} N before, {after.rmse_thrust:.3f} N after"
    commands = {n: record[n] for n in ("omega_ref", "beta_ref")}
    figure = measured_against_predicted(record.time, record["thrust"], shown, title, commands=commands, noise=found.noise.floor)
    page.figure(figure, f"{record.source.rsplit('/', 1)[-1]}. {thinning(len(record))}")
    center = _worst(record, before.thrust - record["thrust"])
    near = np.abs(record.time - center) <= 3.0
    zoom = {name: values[near] for name, values in shown.items()}
    title = f"The worst moment before, around {center:.0f} s"
    part = record.part(near)
    commands = {n: part[n] for n in ("omega_ref", "beta_ref")}
    figure = measured_against_predicted(part.time, part["thrust"], zoom, title, commands=commands, noise=found.noise.floor)
    page.figure(figure, "Six seconds around the largest error of means over 0.2 s.")


def _worst(record, error) -> float:
    at = blocks(record, 0.2)
    return float(at.time[np.nanargmax(np.abs(at.mean(error)))])


def _add_sections(page: Page, found: Diagnosis) -> None:
    record = found.held[0]
    before, after = (found.prediction(fit, record).summary()["sections"] for fit in (found.base, found.final))
    names = list(before)
    values = [np.array([each[n]["rmse_thrust"] for n in names]) for each in (before, after)]
    title = "Where the error fell"
    page.figure(
        residual_by_section(names, *values, found.noise.floor, title), "Thrust error by what is commanded, unseen data."
    )
    rows = [(n, v["before"], v["after"], v["std"]) for n, v in summary(found)["base_parameters"].items()]
    page.table(("parameter", "before", "after", "std"), rows, "What the base parameters had bent to, and where they stand now.")


def _add_candidates(page: Page, found: Diagnosis) -> None:
    rows = []
    for entry in summary(found)["candidates"]:
        if "delta_bic" not in entry:
            continue
        beside = " + ".join(entry["beside"]) or "nothing"
        form = ", ".join(f"{v:g}" for v in entry["form"].values()) or "only"
        size = ", ".join(f"{n.partition('.')[2]} {v:.3g}" for n, v in entry["parameters"].items())
        rows.append((entry["name"], form, beside, entry["delta_bic"], size, entry["why_not"] or "taken"))
    page.table(
        ("effect", "form", "beside", "fall of BIC", "parameters", "verdict"), rows, "Candidates that were refitted in full."
    )
    for effect, judged in found.selection.judgements.items():
        gains = ", ".join(f"{channel} {gain:+.1f}" for channel, gain in judged.held_out_gain.items())
        page.note(f"{effect}: BIC falls by {judged.delta_bic:.0f}; log-likelihood of unseen data: {gains}.")


def _add_remainder(page: Page, found: Diagnosis) -> None:
    record = found.campaign.open_loop
    title = f"What repeats of the error was {found.before_left.share:.3f} of the noise's power, now {found.left.share:.3f}"
    lines = {}
    for name, fit in (("before", found.base), ("after", found.final)):
        error = blocks(record, 0.02).mean(record["thrust"] - found.prediction(fit, record).thrust)
        lines[name] = _correlation(error, 150)
    lags = np.arange(1, 151) * 0.02
    band = 1.96 / np.sqrt(len(error))
    page.figure(
        autocorrelation(lags, lines["after"], band, title), "Autocorrelation of the thrust residual after, means over 20 ms."
    )
    where = found.location
    strongest = where["strongest_correlate"]
    page.table(
        ("what is left", ""),
        [
            ("strongest correlate", f"{strongest['signal']}, {strongest['correlation']:+.2f}"),
            ("input", where["input"]),
            *((f"share between {band} Hz", f"{100 * share:.0f} %") for band, share in where["share_by_band_hz"].items()),
            *((f"mean square, {name}", f"{power:.2g} N²") for name, power in where["mean_square_by_section"].items()),
        ],
        "Where the remaining repeatable error lives.",
    )


def _correlation(error: np.ndarray, count: int) -> np.ndarray:
    e = error[np.isfinite(error)] - np.nanmean(error)
    return np.array([float(e[k:] @ e[:-k]) for k in range(1, count + 1)]) / float(e @ e)


def _add_apart(page: Page, found: Diagnosis) -> None:
    visible = [i for i, v in enumerate(found.apart.visibility) if v >= 10.0]
    names = [found.apart.labels[i] for i in visible]
    if len(names) > 1:
        title = "Which effects these commands can tell apart: 1 means one passes for the other"
        page.figure(
            correlation_heatmap(names, found.apart.overlap[np.ix_(visible, visible)], title), "Squared cosine of their traces."
        )
    unseen = ", ".join(found.apart.invisible()) or "none"
    page.note(f"Would not show at a plausible size under these commands: {unseen}.")
