"""The content of diagnosis.json."""

from identification.diagnose.diagnose import Diagnosis
from identification.diagnose.search.fits import Fit
from identification.diagnose.search.rounds import Tried
from identification.worth.prediction import predict


def summary(found: Diagnosis) -> dict:
    """As CONTRACT.md names it."""
    return {
        "verdict": found.verdict,
        "quality": [finding.summary() for finding in found.quality],
        "effects": [_effect(found, name) for name in found.final.effects],
        "family": {name: others for name, others in found.family.items() if others},
        "next_experiment": "next_experiment.csv" if found.verdict != "none" else None,
        "before": _errors(found, found.base),
        "after": _errors(found, found.final),
        **({"given": _given(found)} if found.given else {}),
        "noise_floor_thrust": found.noise.floor,
        "noise_floor_verified": found.noise.verified,
        "explained_fraction": found.explained and found.explained.share,
        "explained_fraction_std": found.explained and found.explained.error,
        "repeatable_error_over_noise_power": {"before": found.before_left.share, "after": found.left.share},
        "base_parameters": _shift(found),
        "candidates": [_tried(found, t) for tried in found.selection.rounds for t in tried],
        "cannot_be_seen": found.apart.invisible(),
        "cannot_be_told_apart": [{"effects": [a, b], "overlap": overlap} for a, b, overlap in found.apart.alike()],
        "unexplained": {
            "share_left": found.explained and 1.0 - found.explained.share,
            "follows_commands": {"log_likelihood": found.following.gain, "significant": found.following.significant},
            **found.location,
        },
    }


def _effect(found: Diagnosis, name: str) -> dict:
    units = {p.name: p.unit for p in found.final.evidence.model.parameters}
    judged = found.selection.judgements[name]
    own = [n for n in (*found.final.free, *found.final.forms) if n.startswith(f"{name}.")]
    values = {n.partition(".")[2]: {"value": found.final.values[n], "std": found.doubt.get(n), "unit": units[n]} for n in own}
    evidence = {
        "delta_bic": judged.delta_bic,
        "held_out_gain": dict(judged.held_out_gain),
        "explained_fraction": found.explained and found.explained.share,
    }
    intervals = {n.partition(".")[2]: list(i) for n, i in found.final.thresholds.items() if n.startswith(f"{name}.")}
    placed = [n.partition(".")[2] for n in found.selection.placed if n.startswith(f"{name}.")]
    found_in = {"artefact": judged.artefact} if judged.artefact else {}
    return {
        "name": name,
        "parameters": values,
        "intervals": intervals,
        "placed_by_unseen_data": placed,
        "evidence": evidence,
        **found_in,
    }


def _errors(found: Diagnosis, fit: Fit) -> list[dict]:
    """One entry a record: unseen ones first."""
    entries = []
    for role, records in (("held out", found.held), ("fitted", (found.campaign.open_loop,))):
        for record in records:
            entries.append({"record": record.source, "role": role, **found.prediction(fit, record).summary()})
    return entries


def _given(found: Diagnosis) -> list[dict]:
    """The errors of a model that was brought, as it was brought."""
    model, values = found.given.model, found.given.values
    return [{"record": r.source, "role": "held out", **predict(model, values, r).summary()} for r in found.held]


def _shift(found: Diagnosis) -> dict:
    names = found.base.evidence.coordinates.names
    return {n: {"before": found.base.values[n], "after": found.final.values[n], "std": found.doubt.get(n)} for n in names}


def _tried(found: Diagnosis, tried: Tried) -> dict:
    name = tried.candidate.name
    entry = {"name": name, "form": dict(tried.candidate.form), "beside": list(tried.beside), "promised_gain": tried.fall}
    if tried.fit is None:
        return entry | {"why_not": "promised less than the candidates that were refitted"}
    entry |= {"delta_bic": tried.delta_bic, "parameters": {n: tried.fit.values[n] for n in tried.candidate.free}}
    refused = found.selection.refused.get(name)
    if name in found.final.effects:
        mine = all(found.final.forms.get(n) == v for n, v in tried.candidate.form.items())
        return entry | {"why_not": None if mine else "another form of it explains more"}
    if name in found.selection.final.effects:
        return entry | {"why_not": f"removes only {100 * found.explained.share:.0f} % of the explainable error on unseen data"}
    if refused is not None:
        return entry | {"why_not": "; ".join(refused.refused)}
    return entry | {"why_not": "another candidate explains more"}
