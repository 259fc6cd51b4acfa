"""What a fit says of the data behind it: bounds, what the commands leave open, rows too far apart, errors above the noise."""

from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np
from threadpoolctl import ThreadpoolController

from identification.assessment.pairs import forms
from identification.assessment.prediction import Prediction
from identification.assessment.reading_noise import ReadingNoise
from identification.fit.coordinates import CHANNELS
from identification.fit.refine import Refinement
from identification.fit.uncertainty import Uncertainty
from identification.gate.files import FAR, OFFSET
from identification.gate.finding import Finding
from identification.static.static_map import TERMS, design
from vpp_fmu.rig import Rig

HALF = 50.0
"""%: a fit below leaves an error of half the thrust's own standard deviation."""

FIFTH = 5.0
"""Rows that a lag should span: with fewer, what happens between two readings decides it."""

NOISE = 3.0
"""Error over noise from which the fit is far off: of its mean square eight parts in nine are not noise."""

LAG_KNOWN, MAP_KNOWN = 0.1, 0.05
"""Relative standard deviation of a channel's whole lag, and standard deviation of the map anywhere in the commanded range as a
share of the largest thrust, from which the commands told too little."""

MOST = 0.5
"""Share of what a fit leaves above the noise, that an offset takes if it is what is wrong."""

SECOND = 1.0
"""s over which the score of an offset is summed: longer than thrust noise remembers."""


def of_fit(
    found: Refinement, predictions: Mapping[str, Prediction], fitted: tuple[str, ...], noise: ReadingNoise, rig: Rig
) -> tuple[Finding, ...]:
    """Everything that a fit shows. `predictions` by record, those `fitted` to among them; `noise` of one reading; `rig`: whose
    ranges the map should hold in."""
    where = predictions[fitted[0]].record.source
    with _BLAS.limit(limits=1):  # threads cost more than they bring on matrices this narrow
        return (
            *_bounds(found, where),
            *_errors(predictions, fitted, noise.high),
            *_thin(found, where, rig),
            *_sampling(found, predictions, fitted),
            *_offset(found, where, noise.std, rig),
        )


_BLAS = ThreadpoolController()


def _bounds(found: Refinement, where: str) -> Iterator[Finding]:
    bounds = {p.name: p for p in found.problem.model.parameters}
    for name in found.names:
        p, value = bounds[name], found.values[name]
        near = 1e-6 * (p.maximum - p.minimum)
        if p.minimum + near < value < p.maximum - near:
            continue
        ends = f"{p.minimum:g} to {p.maximum:g}" + ("" if p.unit == "1" else f" {p.unit}")
        if p.unit != "s":
            cause = "columns in another unit, or scales of another size"
        elif value < p.minimum + near:
            cause = "one lag where the model has two, or rows too far apart to show it"
        else:
            cause = "time in another unit, or commands that do not belong to these readings"
        told = f"the fit ends at {value:.4g}, a bound ({ends})"
        yield Finding("on_bound", where, name, value, p.unit, told, cause)


def _errors(predictions: Mapping[str, Prediction], fitted: tuple[str, ...], noise: float) -> Iterator[Finding]:
    for name, p in predictions.items():
        fit = p.fit_thrust
        moved = any(np.ptp(p.record[n]) > 0.0 for n in ("omega_ref", "beta_ref"))  # else there is nothing to explain
        if moved and fit < HALF:
            told = f"the fit explains {fit:.1f} %"
            cause = "columns that do not belong together, a wrong unit, or a rig that this model does not describe"
            yield Finding("poor_fit", p.record.source, "thrust", fit, "%", told, cause)
        elif noise and name in fitted and p.rmse_thrust > NOISE * noise:
            ratio = p.rmse_thrust / noise
            told = f"the error is {p.rmse_thrust:.3g} N, {ratio:.1f} times the noise of at most {noise:.3g} N"
            yield Finding("above_noise", p.record.source, "thrust", ratio, "1", told, "an effect that the model lacks")


def _thin(found: Refinement, where: str, rig: Rig) -> Iterator[Finding]:
    """What the commands leave open: parameters that were held, lags and a map that are hardly known."""
    if found.held:
        reasons: dict[str, list[str]] = {}
        for name, why in found.held.items():
            reasons.setdefault(why, []).append(name)
        told = "; ".join(f"{', '.join(names)} can't be told, {why}" for why, names in reasons.items())
        field, count = ", ".join(found.held), len(found.held)
        yield Finding("thin", where, field, count, "1", told, "a command that does not move enough")
    known = _from_commands(found)
    for channel, told_of in forms(known).items():
        relative = told_of["sum"]["std"] / told_of["sum"]["value"]
        if relative > LAG_KNOWN:
            name = "speed" if channel == "omega" else "pitch"
            told = f"the lags of {name} are {told_of['sum']['value']:.3g} s together, ± {100 * relative:.0f} %"
            yield Finding("thin", where, f"{channel}_ref", relative, "1", told, f"few moves of {name}")
    if set(TERMS) <= set(known.names):
        at = [known.names.index(n) for n in TERMS]
        omega, beta = (m.ravel() for m in np.meshgrid(np.linspace(*rig.speed, 5), np.linspace(*rig.pitch, 5)))
        a = design(omega, beta, found.values)
        std = np.sqrt(np.einsum("ni,ij,nj->n", a, known.covariance[np.ix_(at, at)], a))
        largest, k = float(np.abs(a @ [found.values[n] for n in TERMS]).max()), int(np.argmax(std))
        share = float(std[k]) / largest if largest > 0.0 else 0.0  # a map of nothing is known to be one
        if share > MAP_KNOWN:
            size = std[k] * found.values["thrust_scale"]
            there = f"thrust at {omega[k]:.4g} rpm and {beta[k]:.3g} deg"
            told = f"{there} is known to ± {size:.2g} N, {100 * share:.0f} % of the largest"
            yield Finding("thin", where, "omega_ref and beta_ref", share, "1", told, "a part of the range that is not visited")


def _from_commands(found: Refinement) -> Uncertainty:
    """What the fit's parameters would be known to if all that is left were white noise: a lack of the model is no fault of
    the commands."""
    solution, coordinates = found.solution, found.problem.coordinates
    free = np.flatnonzero(~solution.active)
    normal = solution.jacobian.T @ solution.jacobian
    inverse = np.linalg.pinv(normal[np.ix_(free, free)], hermitian=True)
    tangent = coordinates.jacobian(solution.value)[:, free]
    return replace(found.uncertainty, covariance=tangent @ inverse @ tangent.T, reach=None)


def _sampling(found: Refinement, predictions: Mapping[str, Prediction], fitted: tuple[str, ...]) -> Iterator[Finding]:
    """Readings further apart than a fifth of the fastest lag, or than a tenth of both, whose sum is what is known best.

    A lag shorter than a row shows in nothing and may as well be none. Of records with equal rows, the first is told.
    """
    told_of: set[float] = set()
    for name in fitted:
        record = predictions[name].record
        row = float(np.median(np.diff(record.time[np.isfinite(record["thrust"])])))
        if row in told_of:
            continue
        told_of.add(row)
        for channel in CHANNELS:
            pair = [f"tau_{channel}_1", f"tau_{channel}_2"]
            if not set(pair) <= set(found.names):
                continue
            fastest = min((found.values[n] for n in pair if found.values[n] > row), default=np.inf)
            both = sum(found.values[n] for n in pair)
            if row > min(fastest / FIFTH, both / (2.0 * FIFTH)):
                lags = " and ".join(f"{found.values[n]:.3g}" for n in pair)
                told = f"readings are {row:.3g} s apart, the lags of {'speed' if channel == 'omega' else 'pitch'} are {lags} s"
                enough = min(fastest, 0.5 * both) / FIFTH
                cause = f"a logger that is slow or averages (every {enough:.2g} s would do), or one lag where the model has two"
                yield Finding("slow_sampling", record.source, "time", row, "s", told, cause)


def _offset(found: Refinement, where: str, noise: float, rig: Rig) -> Iterator[Finding]:
    """A constant in the thrust, by the score of one at the solution: what is left, along what no other parameter explains.

    Where it takes less than MOST of what is left above the noise, the model lacks something else, of which this is a part.
    """
    problem, solution = found.problem, found.solution
    constant = np.zeros(len(solution.residual))
    blocks = [b for b in problem.blocks if b.channel == "thrust"]
    for block in blocks:
        e = problem.experiments[block.experiment]
        constant[block.at] = e.thrust_columns(np.ones(len(e.record))) / problem.scale["thrust"]
    jacobian, free = solution.jacobian, np.ix_(~solution.active, ~solution.active)
    inverse = np.zeros((jacobian.shape[1], jacobian.shape[1]))
    inverse[free] = np.linalg.pinv((jacobian.T @ jacobian)[free], hermitian=True)
    own = constant - jacobian @ (inverse @ (jacobian.T @ constant))
    information, whole = float(own @ own), float(constant @ constant)
    if information < 1e-3 * whole:  # all of it goes as well with the map
        return
    score = own * solution.residual
    parts = [p.sum() for b in blocks for p in np.array_split(score[b.at], max(2, int(np.ptp(b.time) / SECOND)))]
    offset = -float(score.sum()) / information
    std = float(np.sqrt(len(parts)) * np.std(parts, ddof=1)) / information  # an offset itself does not scatter
    left = np.mean(np.concatenate(problem.thrust_errors(found.values)) ** 2)  # N^2 a reading
    above, taken = float(left) - noise**2, offset**2 * information / whole
    if abs(offset) > max(OFFSET * max(map(abs, rig.thrust)), FAR * std) and taken > MOST * above:
        told = f"the reading is {offset:+.3g} ± {std:.1g} N off the map, whatever is commanded"
        yield Finding("tare", where, "thrust", offset, "N", told, "the sensor was not tared")
