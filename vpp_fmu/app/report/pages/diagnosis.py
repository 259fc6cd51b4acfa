"""The report of a diagnosis. The first screen names the effect, its size with interval, and the error before and after."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from identification.assessment.prediction import rmse
from identification.diagnose.diagnosis import Diagnosis
from identification.diagnose.guess import Guess
from identification.diagnose.learned.description import sentence as described
from identification.diagnose.validation import UNEXPLAINED
from identification.fit.noise import blocks
from identification.fit.problem import Prior
from identification.fit.uncertainty import NORMAL_95
from vpp_fmu.app.report import style
from vpp_fmu.app.report.canvas import Figure, figure
from vpp_fmu.app.report.figures import measured_against_predicted
from vpp_fmu.app.report.page import Link, Page
from vpp_fmu.app.report.pages.effect import add_effects, add_learned, around
from vpp_fmu.app.report.pages.identification import add_quality, quality_tile
from vpp_fmu.app.report.pages.residual import add_correlations, add_spectrum
from vpp_fmu.app.report.result import Knowledge, Result
from vpp_fmu.app.report.sentences import change, clause, limited, sentence, size, thrust_error, titled, words
from vpp_fmu.app.report.summary import LEFT_OUT, NEXT, artefact, summary, why_not, why_not_term, write_diagnosis
from vpp_fmu.digits import chance, interval, number, with_uncertainty
from vpp_fmu.files import OutputFolder
from vpp_fmu.linear import Linearisable
from vpp_fmu.parameters import ParameterSet

SURE = {
    "attributed": "exactly one set of effects explains the lack of fit",
    "family": "the records do not distinguish the named effects from others",
    "partly": "the named effect, or a similar one, explains a part of the lack of fit",
    "learned": "an effect outside the library, learned from these records",
    "unexplained": "no effect of the library explains the lack of fit",
    "none": "the model explains all that exceeds the noise",
}

UNIDENTIFIABLE = "not identifiable from these records"

ZOOM, SMOOTHED = 3.0, 0.2
"""Seconds shown before and after the largest error, and seconds over which the error is averaged to find it."""

WORSE = 1.5
"""Ratio of the unseen record's error to that of held-out parts, from which other conditions are suspected."""

TRUSTED = 0.8
"""Share of the error beyond the noise that two or more effects must explain before their names are trusted."""

MOST_ALIKE = 12
"""Maximum number of pairs of similar effects that a page names."""

MOST_TRIED = 6
"""Rejected learned terms that a page lists with reasons."""


def not_tried(found: Diagnosis) -> list[str]:
    """A line with the steps of the search for which the time budget did not suffice; none without any."""
    return [f"not tried within the time budget: {'; '.join(found.not_tried)}"] if found.not_tried else []


class DiagnoseResult(Result, Linearisable):
    """The effects that the model lacks, and the model with them. `found`: the whole diagnosis."""

    verb = "diagnose"
    found: Diagnosis

    @property
    def verdict(self) -> str:
        """`attributed`, `family`, `learned`, `partly`, `unexplained` or `none`; see the README."""
        return self.found.verdict

    @property
    def effects(self) -> tuple[str, ...]:
        """Names of the final model's effects."""
        return self.parameters.model.optional

    @property
    def parameters(self) -> ParameterSet:
        """Parameters of the final model."""
        return self.found.parameters(self.found.final)

    @property
    def identity(self) -> str:
        return self.parameters.identity

    @property
    def base(self) -> ParameterSet:
        """Parameters of the model without the found effects."""
        return self.found.parameters(self.found.base)

    @property
    def knowledge(self) -> Knowledge:
        """The uncertainty of the final model's parameters."""
        own = self.found.final.uncertainty.renamed(self.found.renamed(self.found.final))
        known = [k for k, std in enumerate(own.std) if np.isfinite(std) and std > 0.0]
        prior = Prior(tuple(own.names[k] for k in known), own.values[known], own.covariance[np.ix_(known, known)])
        noise = self.found.noise.floor, self.found.reading_noise.basis
        return Knowledge(prior, float(np.median(own.inflation)), noise)

    def headline(self) -> str:
        """The finding, after a warning if several effects together explain too little."""
        found = self.found
        if len(found.final.effects) > 1 and found.explained is not None and found.explained < TRUSTED:
            (before, _), (after, _) = found.errors(found.base), found.errors(found.final)
            error = thrust_error(found.unseen is not None, change(before, after, "N"), found.noise.floor)
            share = f"explain {100.0 * found.explained:.0f} % of the error beyond the noise"
            return f"Do not trust the names: together {_and(found.final.effects)} {share}. {error}"
        return _finding(found)

    def _sizes(self) -> list[tuple[str, str, str]]:
        """(label, value, note) of each parameter of the effects that were found."""
        found, figures = self.found, []
        for effect in summary(found)["effects"]:
            if found.learned and effect["name"] == found.learned.term.effect.name and found.learned.term.lead.shape == "curve":
                figures.append(("learned", "a curve", f"{described(found.learned.term)}; shown below with its 95 % band"))
                continue
            for name, p in effect["parameters"].items():
                if name == "form":
                    continue
                note = _known(p, effect["intervals"].get(name))
                if "acts_times" in p:
                    times = "once" if p["acts_times"] == 1 else f"{p['acts_times']} times"
                    note += f"; the fitted commands reach it {times}, {number(p['acts_seconds'], 2)} s in all"
                value = "no limit" if p.get("acts_times") == 0 else size(p["value"], p["unit"])
                figures.append((words(f"{effect['name']}.{name}"), value, note))
        return figures

    def _errors(self) -> list[tuple[str, str, str]]:
        """(label, value, note) of the verdict, the errors, the lack of fit and the quality."""
        found, lack = self.found, self.found.after
        (before, _), (after, _) = found.errors(found.base), found.errors(found.final)
        both = f"{number(before)} → {size(after, 'N')}" if found.final.effects else size(before, "N")
        where = "on the unseen record" if found.unseen is not None else "in cross-validation"
        figures = [("verdict", found.verdict, found.refuted or SURE[found.verdict])]
        figures.append((f"thrust error {where}", both, f"noise of one reading {size(found.noise.floor, 'N')}"))
        if found.explained is not None:
            figures.append(("error beyond the noise", f"{100 * found.explained:.0f} %", f"removed {where}"))
        note = f"p {chance(lack.p, '= ')}; the minimum size of interest is {number(lack.least, 2)} N below 10 Hz"
        figures.append(("lack of fit", f"{number(lack.size, 2)} N" if lack.certain else "not significant", note))
        return [*figures, quality_tile(found.quality)] if found.quality else figures

    def key_figures(self) -> list[tuple[str, str, str]]:
        return [*self._sizes(), *self._errors()]

    def to_dict(self) -> dict[str, Any]:
        return summary(self.found)

    def lines(self) -> list[str]:
        found = self.found
        lines = [*(finding.text for finding in found.quality), *findings(found), *not_tried(found)]
        if found.power:
            from vpp_fmu.app.report.pages.power import power_line  # noqa: PLC0415 most campaigns measure no power

            lines.append(power_line(found.power))
        lines += [f"your logger: {line}" for line in found.logger.lines]
        return [*lines, f"next_experiment.csv: commands within {', '.join(found.rig.command_lines())}"]

    def write(self, folder: OutputFolder) -> None:
        write_diagnosis(folder, self.found, self._file)
        super().write(folder)

    @property
    def title(self) -> str:
        return f"Diagnosis of {self.found.campaign.folder.name}"

    @property
    def source(self) -> str:
        return self.found.campaign.label

    def fill(self, page: Page) -> None:
        found = self.found
        page.findings(findings(found))
        page.remarks(not_tried(found))
        page.remarks([f"{words(effect)}: {LEFT_OUT}" for effect in found.left_out])
        page.remarks([f"{words(name)}: {text}" for name in found.final.effects if (text := artefact(found, name))])
        add_quality(page, found.quality)
        self.fill_effects(page, _whole(found))
        if found.power:
            from vpp_fmu.app.report.pages.power import add_power  # noqa: PLC0415 most campaigns measure no power

            add_power(page, found.power)
        lines = [*(f"Rig: {line}." for line in found.rig.lines()), *(f"Logger: {line}." for line in found.logger.lines)]
        page.section("The rig and its logger", "\n\n".join(lines))

    def fill_effects(self, page: Page, *figures: tuple[Figure, str]) -> None:
        """Add the effects, the model before and after, with further `figures` and their captions, what was tried, and the
        residual, whose details are shown if it is not explained."""
        found = self.found
        if found.final.effects:
            page.section("The effect" if len(found.final.effects) == 1 else "The effects")
            if found.learned:
                add_learned(page, found)
            add_effects(page, found)
        page.section("Before and after" if found.final.effects else "The model")
        for drawn, caption in (*figures, _worst(found)):
            page.figure(drawn, caption)
        if found.final.effects:
            _add_shift(page, found)
        page.section("What was tried")
        _add_tried(page, found)
        page.section("Residual")
        add_spectrum(page, found)
        if found.verdict in UNEXPLAINED:
            add_correlations(page, found)
            _add_alike(page, found)


def _guessed(guess: Guess) -> str:
    share = f"{100.0 * guess.explains:.0f} %"
    rest = f" beside {_and(guess.beside)}" if guess.beside else ""
    if guess.near:
        return f"Best guess{rest}: {_sized(guess)}; it would explain {share} of the lack of fit, and is not accepted."
    most = f"{100.0 * guess.most:.0f} %"
    return f"No candidate{rest} explains more than {most} of the lack of fit; the most likely is {_sized(guess)}."


def _sized(guess: Guess) -> str:
    """The effects of a guess with their sizes and standard errors."""
    found = []
    for name in guess.effects:
        sizes = []
        for s in (s for s in guess.sizes if s.effect == name):
            unit = "" if s.unit == "1" else s.unit
            known = f" ({UNIDENTIFIABLE})" if s.std is None else ""
            sizes.append(f"{words(s.name)} {with_uncertainty(s.value, s.std or 0.0, unit)}{known}")
        found.append(", ".join([words(name), *sizes]))
    return " and ".join(found)


def _and(names: Sequence[str]) -> str:
    return " and ".join(map(words, names))


def _finding(found: Diagnosis) -> str:
    (before, _), (after, _) = found.errors(found.base), found.errors(found.final)
    unseen, noise = found.unseen is not None, found.noise.floor
    error = thrust_error(unseen, size(before, "N"), noise)
    refuted = f"The best set of effects is refuted and not used: {found.refuted}. " if found.refuted else ""
    if found.verdict == "none":
        also = f"; {refuted[0].lower()}{refuted[1:].strip()}" if refuted else "."
        return f"Nothing is missing{also} {error.removesuffix('.')}{_other_conditions(found, before) or '.'}"
    if refuted:
        return f"{refuted}{error}"
    if found.verdict == "unexplained" and found.missed:
        return f"No effect is named, but something is missing: {found.missed}. {error}"
    if found.verdict == "unexplained" and not found.before.significant:
        line = f"The thrust reading has a line at the rotor frequency of {size(found.before.turning.size, 'N')} rms"
        return f"{line}: most of the noise power, and nothing else is missing. {error}"
    if found.verdict == "unexplained" and found.before.only_speed:
        text = f"The measured speed deviates from the model by {size(found.before.speed_rpm, 'rpm')} rms, and no effect of the"
        return f"{text} library explains it; the thrust does not show it: check the speed sensor first. {error}"
    if found.verdict == "unexplained" and not found.learned:
        return f"No effect of the library explains the lack of fit. {error}"
    if found.final.effects:
        error = thrust_error(unseen, change(before, after, "N"), noise)
    doubt = f"; {found.missed or 'a part of the lack of fit remains unexplained'}" if found.verdict == "partly" else ""
    return f"{sentence(_effects(found)).removesuffix('.')}{_rivals(found)}{doubt}. {error}"


def _other_conditions(found: Diagnosis, unseen: float) -> str:
    """A sentence if the unseen record is predicted worse than parts of the fitted ones that were held out; else empty."""
    held_out = found.held_out_before.rmse_thrust
    if found.unseen is None or unseen < WORSE * held_out:
        return ""
    question = f"does {found.unseen.name} have another logger or rig?"
    return f"; held-out parts of the fitted records have {size(held_out, 'N')}: {question}"


def _effects(found: Diagnosis) -> list[str]:
    """The effects of the final model as clauses, then those that are not exported."""
    clauses = []
    for fit, names, remark in (
        (found.final, found.final.effects, ""),
        (found.selection.final, found.left_out, f" ({LEFT_OUT})"),
    ):
        declared = {e.name: e for e in fit.problem.model.effects}
        for name in names:
            if found.learned and name == found.learned.term.effect.name:
                clauses.append(f"a term outside the library {described(found.learned.term)}")
            else:
                clauses.append(clause(declared[name], fit.values) + remark)
    return clauses


def _rivals(found: Diagnosis) -> str:
    """Effects that the records do not distinguish from those found, as a sentence."""
    names = sorted({other for others in found.selection.family.values() for other in others})
    return f"; these records do not distinguish it from {' or '.join(map(words, names))}" if names else ""


def findings(found: Diagnosis) -> list[str]:
    """The list under the tiles: channels, noise, residual, the best guess, what speaks against it, the next step."""
    lines = [f"{name.capitalize()}: {_channel(one)}." for name, one in found.channels.items()]
    lines.append(f"Noise of one reading: {size(found.noise.floor, 'N')}, {found.reading_noise.basis}.")
    if found.given is not None:
        error = number(summary(found)["given"]["rmse_thrust"])
        lines.append(f"The model as it was given: {error} N on {found.shown_name}, before any fit.")
    lines += [f"{titled(n)} could as well be {' or '.join(map(words, o))}." for n, o in found.selection.family.items() if o]
    if found.missed:
        lines.append(f"{found.missed[0].upper()}{found.missed[1:]}.")
    if found.verdict in UNEXPLAINED:
        lines.append(f"Residual: {_where(found)}.")
    if guess := found.best_guess:
        lines += [_guessed(guess), f"Against it: {'; '.join(guess.against)}."]
        apart = f"{number(guess.there, 2)} N rms there, by {number(guess.here, 2)} N so far"
        rival = words(guess.rival) or "the model without it"
        lines.append(f"{NEXT} distinguishes it from {rival}: their thrusts differ by {apart}.")
    if found.verdict not in ("none", "attributed"):
        ranges = ", ".join(found.rig.command_lines())
        text = f"Next step: run {NEXT} on the rig twice, and diagnose with both records (--record), within {ranges}."
        lines.append(Link(text, NEXT))
    return lines


def _channel(one: Mapping) -> str:
    names = _and(one["effects"])
    if one["verdict"] == "none":
        return "nothing is missing"
    if one["verdict"] == "unexplained":
        return "lack of fit, and no effect explains it"
    return f"{names} ({one['verdict']})"


def _known(parameter: Mapping, ends: Sequence[float] | None) -> str:
    """The 95 % interval of a parameter, scanned or from its standard error, in its unit."""
    unit = "" if parameter["unit"] == "1" else parameter["unit"]
    if ends is not None:
        return f"95 %: {interval(*ends, unit)}"
    if parameter["std"] is None:
        return UNIDENTIFIABLE
    if parameter["std"] == 0.0:
        return "on its bound"
    half = NORMAL_95 * parameter["std"]
    return f"95 %: {interval(parameter['value'] - half, parameter['value'] + half, unit)}"


def _where(found: Diagnosis) -> str:
    location = found.location
    band, section = (max(location[k], key=location[k].get) for k in ("share_by_band_hz", "mean_square_by_section"))
    strongest, largest = location["strongest_correlate"], location["largest"]
    note = f"largest while {_moving(section)}; correlates with {strongest['signal']} ({strongest['correlation']:+.2f})"
    return f"{band} Hz, {note}; up to {number(abs(largest['thrust']), 3)} N; input: {location['input']}"


def _predicted(found: Diagnosis) -> dict[str, np.ndarray]:
    """Thrust (rows,) [N] of the shown record, by fit."""
    return {name: found.prediction(fit, found.shown).thrust for name, fit in found.fits.items()}


def _whole(found: Diagnosis) -> tuple[Figure, str]:
    """The shown record beside the models, and the caption."""
    lines = _predicted(found)
    errors = [f"{number(rmse(thrust - found.shown['thrust']))} N" for thrust in lines.values()]
    error = " before and ".join(errors) + " after" * (len(errors) > 1)
    seen = "no fit saw" if found.unseen is not None else "was fitted"
    title = f"On a record that {seen} the thrust error is {error}; the noise alone is {number(found.noise.floor)} N"
    figure = measured_against_predicted(found.shown, lines, title, found.noise.floor)
    return figure, f"{found.shown_name}.csv."


def _worst(found: Diagnosis) -> tuple[Figure, str]:
    """The largest error of the model before, and the caption."""
    record, lines = found.shown, _predicted(found)
    at = blocks(record, SMOOTHED)
    means = {name: np.abs(at.mean(thrust - record["thrust"])) for name, thrust in lines.items()}
    block = int(np.nanargmax(next(iter(means.values()))))
    there = " and ".join(f"{number(mean[block], 3)} N {name}" for name, mean in means.items()).removesuffix(" model")
    near = around(record.time, float(at.time[block]), ZOOM)
    title = f"The worst moment, around {at.time[block]:.0f} s: the error is {there}"
    part = {name: thrust[near] for name, thrust in lines.items()}
    figure = measured_against_predicted(record.part(near), part, title, found.noise.floor)
    return figure, f"{2.0 * ZOOM:g} s of {found.shown_name}.csv around the worst mean over {SMOOTHED:g} s."


def _moving(section: str) -> str:
    return {"both": "both commands move", "steady": "no command moves"}.get(
        section, f"only the {section.removesuffix(' only')} command moves"
    )


def _add_alike(page: Page, found: Diagnosis) -> None:
    """Effects that the commands do not distinguish, and the invisible ones."""
    pairs, unseen = found.distinguishability.alike(), found.distinguishability.invisible()
    alike = "; ".join(f"{words(one)} and {words(other)} ({overlap:.2f})" for one, other, overlap in pairs[:MOST_ALIKE])
    page.remarks(
        [
            f"these commands do not distinguish ({min(len(pairs), MOST_ALIKE)} of {len(pairs)} pairs, squared cosine): {alike}",
            f"not visible at a plausible size under these commands: {', '.join(map(words, unseen)) or 'none'}",
        ]
    )


def _add_tried(page: Page, found: Diagnosis) -> None:
    """The table of the effects that were refitted, each in its best form, and of the learned terms."""
    best: dict[str, tuple] = {}
    fitted = [t for each in found.selection.rounds for t in each if t.fit is not None]
    for tried in sorted(fitted, key=lambda t: (why_not(found, t) is None, t.evidence), reverse=True):
        candidate, fit = tried.candidate, tried.fit
        form = ", ".join(f"{v:g}" for v in candidate.form.values()) or "only"
        own = [p for p in fit.problem.model.parameters if p.name in candidate.free]
        sizes = ", ".join(f"{p.name.partition('.')[2]} {limited(p, fit.values[p.name])}" for p in own)
        cells = form, " + ".join(tried.beside) or "nothing", f"{tried.evidence:.1f}", sizes
        best.setdefault(candidate.name, (candidate.name, *cells, why_not(found, tried) or "accepted"))
    rows = list(best.values())
    for term, judged in found.attempt.tried[:MOST_TRIED]:
        why = why_not_term(found, term, judged) or "accepted"
        rows.append((described(term), term.lead.shape, "", f"{judged.evidence:.1f}", "", why))
    columns = ("effect", "form", "beside", "evidence [nat]", "parameters", "verdict")
    caption = "Effects that were refitted, each in its best form, and learned terms; diagnosis.json has all forms and rounds."
    page.table(columns, rows, caption)


def _add_shift(page: Page, found: Diagnosis) -> None:
    """The bias of the base parameters without the effects."""
    shift = summary(found)["base_parameters"]
    names = list(shift)
    before, after = ({n: shift[n][k] for n in names} for k in ("before", "after"))
    for first, second in (("tau_omega_1", "tau_omega_2"), ("tau_beta_1", "tau_beta_2")):
        if {first, second} <= set(names) and (before[first] < before[second]) != (after[first] < after[second]):
            before[first], before[second] = before[second], before[first]
    before, after = (np.array(list(values.values())) for values in (before, after))
    reach = NORMAL_95 * np.array([shift[n]["std"] or np.nan for n in names], float)
    k = int(np.argmax(np.abs(before - after) / np.maximum(np.abs(after), 1e-9)))
    units = {p.name: p.unit for p in found.final.problem.model.parameters}
    names = [f"{words(name)} [{units[name]}]".removesuffix(" [1]") for name in names]
    title = f"Without the effect {names[k]} is biased to {number(before[k])}; with it, it is {number(after[k])}"
    scale = np.where(before == 0.0, np.nan, np.abs(before)) / 100.0
    ends = [interval(a - r, a + r) if np.isfinite(r) else "interval unknown" for a, r in zip(after, reach, strict=True)]
    rows = [f"{name}  {number(b)} → {number(a)}\n{end}" for name, b, a, end in zip(names, before, after, ends, strict=True)]
    change, widths = (after - before) / scale, reach / scale
    fig = figure(title, 44 * len(rows), "change from the start [%]")
    fig.points(0.0 * scale, rows, "start", style.BEFORE, 16, bar=True)
    fig.points(change, rows, "fitted, 95 % interval", style.AFTER, 9, across="x", error=widths)
    # Every change and the typical interval are shown: one unidentifiable parameter does not set the range.
    most = np.nanmax(np.abs(change), initial=0.5) + np.nanmedian([0.0, *widths[np.isfinite(widths)]])
    fig.axes["x"] |= {"range": [-1.1 * most, 1.1 * most], "format": "+.4~r"}
    fig.axes["y0"]["reversed"] = True
    page.figure(
        fig, "Start: the best fit without the effects; fitted: with them, 95 % intervals. Lags in the order of the latter."
    )
