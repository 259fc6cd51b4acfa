"""Report section: the electrical power in time, before and after the effects that its model lacks."""

from identification.power.diagnose import PowerDiagnosis
from identification.power.effects import PowerEffect
from identification.power.fit import electrical
from vpp_fmu.app.report.figures import measured_against_predicted
from vpp_fmu.app.report.page import Page
from vpp_fmu.app.report.sentences import change, sentence, size
from vpp_fmu.digits import chance, interval, number

VERDICTS = {
    "none": "Nothing is missing.",
    "partly": "A part of the lack of fit remains unexplained.",
    "unexplained": "No effect of the power explains its lack of fit.",
}


def power_line(found: PowerDiagnosis) -> str:
    """The finding in sentences, in ASCII."""
    of = "Unseen" if found.unseen else "Cross-validated"
    before, after = found.errors
    errors = change(before, after, "W") if found.power[1].effects else size(before, "W")
    parts = ["Power:"] + ([sentence([_clause(found, effect) for effect in found.effects])] if found.effects else [])
    if rivals := sorted({name for names in found.family.values() for name in names}):
        parts.append(f"These records do not distinguish it from {' or '.join(rivals)}.")
    parts += [VERDICTS[found.verdict]] if found.verdict in VERDICTS else []
    return " ".join([*parts, f"{of} power error {errors}."])


def _clause(found: PowerDiagnosis, effect: PowerEffect) -> str:
    own = found.parameters[effect.name]
    return effect.says.format_map({name: size(p["value"], p["unit"]) for name, p in own.items()})


def add_power(page: Page, found: PowerDiagnosis) -> None:
    """The section: its finding, one figure, the sizes and the candidates."""
    page.section("Power", power_line(found).removeprefix("Power: ").replace(" -> ", " → "))
    part, effects = found.part, found.power[1].effects
    columns = {name: part.record[name][part.at.edges[:-1]] for name in ("omega_ref", "beta_ref")}
    columns |= {"time": part.at.time, "power": part.at.mean(electrical(part.record.columns))}
    lines = zip(("before", "after") if effects else ("model",), found.power, strict=False)
    predictions = {name: columns["power"] - fit.error(part) for name, fit in lines}
    after = f" before and {number(found.errors[1], 3)} W after" if effects else ""
    title = f"The error of the power is {number(found.errors[0], 3)} W{after}"
    lack = found.power[1].lack
    caption = f"{part.name}.csv, means over {number(found.block, 2)} s. "
    caption += "Model: the identified one, its map refined on the fitted records. "
    caption += f"Lack of fit: p {chance(lack.p, '= ')}, {number(lack.size, 2)} W; minimum size {number(lack.least, 2)} W. "
    page.figure(measured_against_predicted(columns, predictions, title, reading="power"), caption)
    sizes = [
        (effect, name, p["value"], interval(*p["interval"], p["unit"]))
        for effect, own in found.parameters.items()
        for name, p in own.items()
    ]
    if sizes:
        page.table(("effect", "parameter", "value", "95 % interval"), sizes, "Effects of the power. They are not in the FMU.")
    rows = [
        (t.effect.label, " + ".join(t.beside) or "nothing", f"{t.judged.evidence:.1f}", found.why_not(t) or "accepted")
        for t in found.tried
    ]
    page.table(("effect", "beside", "evidence [nat]", "verdict"), rows, "Candidates.")
    if not found.voltage:
        page.note("supply_sag is not identifiable: it needs measured voltage and current.")
