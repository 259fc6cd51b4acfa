"""Checks of the data by a fit: bounds, identifiability, sampling period, errors above the noise, and an offset."""

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
from identification.gate.finding import Finding
from identification.gate.zero import FAR, OFFSET
from identification.static.static_map import TERMS, design
from vpp_fmu.rig import Rig

HALF = 50.0
"""%: below, the error exceeds half the thrust's standard deviation."""

FIFTH = 5.0
"""Minimum number of rows that a lag should span: with fewer it depends on the signal between readings."""

NOISE = 3.0
"""Ratio of error to noise above which the fit is poor: 8/9 of the mean square are then not noise."""

LAG_KNOWN, MAP_KNOWN = 0.1, 0.05
"""Maximum relative standard deviation of a channel's total lag, and maximum standard deviation of the map in the commanded
range as a share of the largest thrust."""

MOST = 0.5
"""Minimum share of the residual power above the noise that an offset must explain."""

SECOND = 1.0
"""s over which the score of an offset is summed: longer than the correlation time of thrust noise."""


@ThreadpoolController().wrap(limits=1)  # on matrices this narrow one thread is faster
def of_fit(
    found: Refinement, predictions: Mapping[str, Prediction], fitted: tuple[str, ...], noise: ReadingNoise, rig: Rig
) -> tuple[Finding, ...]:
    """All findings of a fit. `predictions` by record, including the `fitted` ones; `noise` of one reading; `rig`: its ranges
    are those of the map."""
    where = predictions[fitted[0]].record.source
    return (
        *_bounds(found, where),
        *_errors(predictions, fitted, noise.high),
        *_thin(found, where, rig),
        *_sampling(found, predictions, fitted),
        *_offset(found, where, noise.std, rig),
    )


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
            cause = "one lag instead of the model's two, or a sampling period too long to identify it"
        else:
            cause = "time in another unit, or commands that do not belong to these readings"
        message = f"the estimate is at a bound, {value:.4g} ({ends})"
        yield Finding("on_bound", where, name, value, p.unit, message, cause)


def _errors(predictions: Mapping[str, Prediction], fitted: tuple[str, ...], noise: float) -> Iterator[Finding]:
    for name, p in predictions.items():
        fit = p.fit_thrust
        moved = any(np.ptp(p.record[n]) > 0.0 for n in ("omega_ref", "beta_ref"))
        if moved and fit < HALF:
            message = f"the fit explains {fit:.1f} %"
            cause = "columns that do not belong together, a wrong unit, or a rig that this model does not describe"
            yield Finding("poor_fit", p.record.source, "thrust", fit, "%", message, cause)
        elif noise and name in fitted and p.rmse_thrust > NOISE * noise:
            ratio = p.rmse_thrust / noise
            message = f"the error is {p.rmse_thrust:.3g} N, {ratio:.1f} times the noise of at most {noise:.3g} N"
            yield Finding(
                "above_noise", p.record.source, "thrust", ratio, "1", message, "an effect that the model does not have"
            )


def _thin(found: Refinement, where: str, rig: Rig) -> Iterator[Finding]:
    """Parameters that the commands do not identify: held ones, and lags and a map with large standard deviations."""
    if found.held:
        reasons: dict[str, list[str]] = {}
        for name, why in found.held.items():
            reasons.setdefault(why, []).append(name)
        message = "; ".join(f"{', '.join(names)} not identifiable, {why}" for why, names in reasons.items())
        field, count = ", ".join(found.held), len(found.held)
        yield Finding("thin", where, field, count, "1", message, "a command that does not move enough")
    known = _from_commands(found)
    for channel, functions in forms(known).items():
        relative = functions["sum"]["std"] / functions["sum"]["value"]
        if relative > LAG_KNOWN:
            name = "speed" if channel == "omega" else "pitch"
            message = f"the sum of lags of {name} is {functions['sum']['value']:.3g} s, ± {100 * relative:.0f} %"
            yield Finding("thin", where, f"{channel}_ref", relative, "1", message, f"few moves of {name}")
    if set(TERMS) <= set(known.names):
        at = [known.names.index(n) for n in TERMS]
        omega, beta = (m.ravel() for m in np.meshgrid(np.linspace(*rig.speed, 5), np.linspace(*rig.pitch, 5)))
        a = design(omega, beta, found.values)
        std = np.sqrt(np.einsum("ni,ij,nj->n", a, known.covariance[np.ix_(at, at)], a))
        largest, k = float(np.abs(a @ [found.values[n] for n in TERMS]).max()), int(np.argmax(std))
        share = float(std[k]) / largest if largest > 0.0 else 0.0  # a map of zero thrust is certain
        if share > MAP_KNOWN:
            size = std[k] * found.values["thrust_scale"]
            there = f"thrust at {omega[k]:.4g} rpm and {beta[k]:.3g} deg"
            message = f"{there} has a standard deviation of {size:.2g} N, {100 * share:.0f} % of the largest"
            yield Finding("thin", where, "omega_ref and beta_ref", share, "1", message, "a part of the range without commands")


def _from_commands(found: Refinement) -> Uncertainty:
    """Uncertainty of the fit's parameters if the residual were white noise: model error is no fault of the commands."""
    solution, coordinates = found.solution, found.problem.coordinates
    free = np.flatnonzero(~solution.active)
    normal = solution.jacobian.T @ solution.jacobian
    inverse = np.linalg.pinv(normal[np.ix_(free, free)], hermitian=True)
    tangent = coordinates.jacobian(solution.value)[:, free]
    return replace(found.uncertainty, covariance=tangent @ inverse @ tangent.T, reach=None)


def _sampling(found: Refinement, predictions: Mapping[str, Prediction], fitted: tuple[str, ...]) -> Iterator[Finding]:
    """A sampling period longer than a fifth of the fastest lag, or than a tenth of the sum of both, which is best identified.

    Lags shorter than the sampling period are ignored. Of records with equal periods, the first is reported.
    """
    reported: set[float] = set()
    for name in fitted:
        record = predictions[name].record
        row = float(np.median(np.diff(record.time[np.isfinite(record["thrust"])])))
        if row in reported:
            continue
        reported.add(row)
        for channel in CHANNELS:
            pair = [f"tau_{channel}_1", f"tau_{channel}_2"]
            if not set(pair) <= set(found.names):
                continue
            fastest = min((found.values[n] for n in pair if found.values[n] > row), default=np.inf)
            both = sum(found.values[n] for n in pair)
            if row > min(fastest / FIFTH, both / (2.0 * FIFTH)):
                lags = " and ".join(f"{found.values[n]:.3g}" for n in pair)
                message = (
                    f"the sampling period is {row:.3g} s, the lags of {'speed' if channel == 'omega' else 'pitch'} are {lags} s"
                )
                enough = min(fastest, 0.5 * both) / FIFTH
                cause = (
                    f"a logger that is slow or averages ({enough:.2g} s would be enough), or one lag instead of the model's two"
                )
                yield Finding("slow_sampling", record.source, "time", row, "s", message, cause)


def _offset(found: Refinement, where: str, noise: float, rig: Rig) -> Iterator[Finding]:
    """An offset of the thrust, by its score at the solution, orthogonal to the fitted parameters.

    If it explains less than MOST of the residual power above the noise, the cause is another model error.
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
    if information < 1e-3 * whole:  # not distinguishable from the map
        return
    score = own * solution.residual
    parts = [p.sum() for b in blocks for p in np.array_split(score[b.at], max(2, int(np.ptp(b.time) / SECOND)))]
    offset = -float(score.sum()) / information
    std = float(np.sqrt(len(parts)) * np.std(parts, ddof=1)) / information  # an offset is constant and adds no scatter
    mean_square = np.mean(np.concatenate(problem.thrust_errors(found.values)) ** 2)  # N^2 a reading
    above, explained = float(mean_square) - noise**2, offset**2 * information / whole
    if abs(offset) > max(OFFSET * max(map(abs, rig.thrust)), FAR * std) and explained > MOST * above:
        message = f"the reading differs from the map by {offset:+.3g} ± {std:.1g} N at all commands"
        yield Finding("tare", where, "thrust", offset, "N", message, "the sensor was not tared")
