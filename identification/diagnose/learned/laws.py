"""Replace a learned curve by a simple law: a line, a square, a hinge, a step, a limit or a sign.

Each law is fitted to the curve by weighted least squares; the best few are refitted to the records. A law replaces the curve
if its BIC is not larger. Of laws that the records do not distinguish, the one with the fewest parameters is taken: a limit that
few moments reach extrapolates badly.
"""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from identification.diagnose.judgement import MIN_EVIDENCE
from identification.diagnose.learned.refit import Term, refitted
from identification.diagnose.learned.screening import Lead
from identification.diagnose.search.fits import Fit, Searcher
from identification.diagnose.search.refits import evidence_over
from vpp_fmu.kernel.learned.shapes import knots
from vpp_fmu.kernel.scales import Scales

REFITTED = 2
"""Laws that are refitted: those of the smallest error on the curve."""

GRID = 24
"""Grid points of a law's threshold."""


def curve_of(term: Term) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(knots, values, standard errors) of a curve; 0 for pinned values."""
    values, count = term.values, knots(term.values)
    at, f = (np.array([values[f"{part}_{k + 1}"] for k in range(count)]) for part in ("at", "value"))
    names = [term.effect.full(f"value_{k + 1}") for k in range(count)]
    covariance = covariance_of(term.fit, names)
    return at, f, np.sqrt(np.maximum(np.diag(covariance), 0.0))


def covariance_of(fit: Fit, names: list[str]) -> np.ndarray:
    """Covariance (k, k) of parameters by full name; 0 for those that were not fitted."""
    _, jacobian = fit.tangent()
    coordinates = fit.problem.coordinates
    inner = coordinates.jacobian(fit.solution.value)
    whole = inner @ np.linalg.pinv(jacobian.T @ jacobian, rcond=1e-12, hermitian=True) @ inner.T
    places = [coordinates.names.index(n) if n in coordinates.names else -1 for n in names]
    found = np.zeros((len(names), len(names)))
    for i, p in enumerate(places):
        for j, q in enumerate(places):
            if p >= 0 and q >= 0:
                found[i, j] = whole[p, q]
    return found


def laws_of(searcher: Searcher, beside: Fit, curve: Term, scales: Scales, pool) -> tuple[Term, tuple[tuple[str, float], ...]]:
    """(the term in its simplest form; the refitted laws with their evidence over the curve)."""
    if curve.lead.shape != "curve":
        return curve, ()
    leads = nearest(curve)
    found = pool.map(lambda lead: refitted(searcher, beside, lead, curve.effect.name, scales, curve.fit), leads)
    terms = [t for t in found if t is not None]
    laws = tuple((t.lead.shape, evidence_over(t.fit, curve.fit)) for t in terms)
    least = max(0.0, max((evidence for _, evidence in laws), default=0.0) - MIN_EVIDENCE)
    near = [t for t, (_, evidence) in zip(terms, laws, strict=True) if evidence >= least]
    return min(near, key=lambda t: (len(t.values), t.fit.bic()), default=curve), laws


def nearest(curve: Term) -> list[Lead]:
    """The laws of the smallest error on a curve."""
    at, f, std = curve_of(curve)
    known = std > 0.0
    weight = 1.0 / np.where(known, std, np.median(std[known]) if known.any() else 1.0)
    fine = np.linspace(at[0], at[-1], 200)
    target, weigh = np.interp(fine, at, f), np.interp(fine, at, weight)
    best: dict[str, tuple[float, dict[str, float]]] = {}
    for shape, point, column in _columns(fine):
        # A constant is free unless the curve is pinned at one value: the base model absorbs it.
        columns = (
            [column] if curve.lead.pinned[-1:] and curve.lead.pinned[-1].startswith("value") else [column, np.ones(len(fine))]
        )
        a = np.stack(columns, axis=1) * weigh[:, None]
        shares, *_ = np.linalg.lstsq(a, target * weigh, rcond=1e-9)
        error = float(np.sum((target * weigh - a @ shares) ** 2))
        if shape not in best or error < best[shape][0]:
            best[shape] = error, {**point, "gain": float(shares[0])}
    ranked = sorted(best.items(), key=lambda item: item[1][0])[:REFITTED]
    lead = curve.lead
    lag = curve.values.get("lag")
    return [replace(lead, shape=shape, values=values, pinned=(), lag=lag) for shape, (_, values) in ranked]


def _columns(v: np.ndarray) -> Iterator[tuple[str, dict[str, float], np.ndarray]]:
    """(shape, its parameters without the gain, its values at v (n,)) of every law."""
    yield "line", {}, v
    yield "square", {}, v * np.abs(v)
    levels = np.linspace(v[0], v[-1], GRID + 2)[1:-1].tolist()
    for level in levels:
        for side in (1.0, -1.0):
            yield "hinge", {"knee": level, "side": side}, np.maximum(side * (v - level), 0.0)
        yield "threshold", {"level": level}, (v > level).astype(float)
    reach, span = float(np.max(np.abs(v))), float(np.ptp(v))
    if v[0] < 0.0 < v[-1]:
        for share in np.geomspace(0.01, 0.7, GRID).tolist():
            yield "saturation", {"limit": share * reach}, np.clip(v, -share * reach, share * reach)
        for share in (0.01, 0.03, 0.1):
            yield "sign", {"width": share * span}, np.tanh(v / (share * span))
