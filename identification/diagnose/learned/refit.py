"""Refit leads beside a fit with all parameters free. A term is fitted like any other effect."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from identification.diagnose.learned.screening import Lead
from identification.diagnose.search.fits import Fit, Searcher
from identification.fit.problem import Prior
from identification.static.at_rest import Knowledge
from vpp_fmu.kernel.learned import PORTS, learned, placed
from vpp_fmu.kernel.scales import Scales
from vpp_fmu.kernel.types import Effect, Model

WILD = 2.0
"""Prior standard deviation of a term's sizes, as a multiple of the largest size in screening."""


@dataclass(frozen=True, eq=False)
class Term:
    """A refitted lead. `library`: the library with the term inserted."""

    lead: Lead
    effect: Effect
    library: tuple[Effect, ...]
    fit: Fit

    @property
    def values(self) -> dict[str, float]:
        """Values of the effect's parameters, by bare name."""
        return {p.name: self.fit.values[self.effect.full(p.name)] for p in self.effect.parameters}

    @property
    def free(self) -> tuple[str, ...]:
        """Bare names of the effect's fitted parameters."""
        head = f"{self.effect.name}."
        return tuple(n.removeprefix(head) for n in self.fit.free if n.startswith(head))

    def searcher(self, other: Searcher) -> Searcher:
        """A searcher that fits models with the term where another one fits them without it."""
        return _searcher(other, self.effect, self.lead)


def _searcher(other: Searcher, effect: Effect, lead: Lead) -> Searcher:
    sizes = {effect.full(n): effect.probe[n] for n in effect.off if n not in _fixed(lead)}
    library = placed(other.library, effect, PORTS[lead.port])
    return Searcher(other.experiments, other.names, _with_prior_of_sizes(other, sizes), library)


def _fixed(lead: Lead) -> set[str]:
    return {"form", "side", *lead.pinned}


def effect_of(lead: Lead, name: str, scales: Scales) -> Effect:
    """The effect of a lead, scaled for a rig; values are clipped to their bounds."""
    effect = learned(name, lead.port, lead.driver, lead.shape, lead.values, lead.span, lead.lag, lead.times, lead.form, scales)
    bounds = {p.name: (p.minimum, p.maximum) for p in effect.parameters}
    return replace(effect, probe={n: min(max(v, bounds[n][0]), bounds[n][1]) for n, v in effect.probe.items()})


def refitted(searcher: Searcher, beside: Fit, lead: Lead, name: str, scales: Scales, start: Fit | None = None) -> Term | None:
    """Refit with the term added; None if the model diverges from its start values.

    `start`: the fit that gives start values of the base; None: `beside`.
    """
    effect = effect_of(lead, name, scales)
    fixed, own = _fixed(lead), _searcher(searcher, effect, lead)
    forms = {effect.full(n): v for n, v in effect.probe.items() if n in fixed}
    free = [effect.full(n) for n in effect.probe if n not in fixed]
    values = {**beside.values, **(start.values if start else {}), **{effect.full(n): v for n, v in effect.probe.items()}}
    order, u = dict(beside.slow_first), PORTS[lead.port].channel
    if u:
        order[u] = order.get(u, True) != lead.swapped
        one, two = f"tau_{u}_1", f"tau_{u}_2"
        if order[u] != (values[one] >= values[two]):
            values |= {one: values[two], two: values[one]}
    effects, forms, free = [*beside.effects, name], {**beside.forms, **forms}, [*beside.free, *free]
    try:
        with np.errstate(over="ignore", invalid="ignore"):  # an unstable loop diverges
            fit = own.fit(effects, forms, free, values, order, not beside.thresholds)
            slopes = fit.tangent()[1]
            finite = np.isfinite(fit.deviance) and np.isfinite(np.vdot(slopes, slopes))  # sensitivities may diverge alone
    except np.linalg.LinAlgError:
        return None
    return Term(lead, effect, own.library, fit) if finite else None


def _with_prior_of_sizes(searcher: Searcher, sizes: Mapping[str, float]) -> Knowledge:
    """A searcher's prior, extended by a prior of the term's sizes, which are hardly identifiable: mean 0, standard deviation
    WILD times the largest size in screening."""
    wide = WILD * max(abs(v) for v in sizes.values()) or 1.0

    def knowledge(model: Model, values: Mapping[str, float], names: Sequence[str]) -> Prior:
        known = searcher.known(model, values, names) or Prior((), np.zeros(0), np.zeros((0, 0)))
        further = [n for n in sizes if n not in known.names]
        count = len(known.names)
        covariance = np.zeros((count + len(further), count + len(further)))
        covariance[:count, :count] = known.covariance
        covariance[count:, count:] = wide**2 * np.eye(len(further))
        return Prior((*known.names, *further), np.append(known.mean, np.zeros(len(further))), covariance)

    return knowledge
