"""Selection of the static map's terms, and the meaning of the scores."""

from dataclasses import replace

import numpy as np
import pytest

from identification.static.selection import CANDIDATES, CRITERIA, PAPER, select_terms
from identification.static.static_map import design, fit_static_map
from vpp_fmu.campaign import StaticMap
from vpp_fmu.errors import BadInput
from vpp_fmu.kernel.plant import BASE

SCALES = BASE.values()


def campaign(noise: float, seed: int = 0, terms=PAPER, values=None, scales=SCALES, speeds: int = 10) -> StaticMap:
    """Points of a polynomial of these terms, by default the paper's; each mean has an error of `noise` [N]."""
    axes = np.linspace(2000.0, 6000.0, speeds), np.linspace(-5.0, 10.0, 8)
    omega, beta = (axis.ravel() for axis in np.meshgrid(*axes))
    values = [SCALES[f"c{i}{j}"] for i, j in terms] if values is None else values
    thrust = design(omega, beta, scales, terms) @ values * scales["thrust_scale"]
    rng = np.random.default_rng(seed)
    spread = rng.uniform(5.0, 15.0, len(omega)) * max(noise, 1e-3)
    thrust = thrust + noise / max(noise, 1e-3) * spread / 10.0 * rng.standard_normal(len(omega))
    return StaticMap(omega, beta, omega, thrust, spread, np.full(len(omega), 100.0), "made up")


def test_candidates_vanish_at_standstill():
    assert len(CANDIDATES) == len(set(CANDIDATES)) == 10
    assert all(i >= 1 and j >= 0 and i + j <= 4 for i, j in CANDIDATES)
    assert set(PAPER) < set(CANDIDATES)


@pytest.mark.parametrize("noise", [0.0, 0.02])
def test_the_papers_terms_are_selected_when_they_made_the_data(noise):
    found = select_terms(campaign(noise), SCALES)
    assert len(found.tried) == 2**10 - 1
    assert set(found.best().terms) == set(PAPER)
    assert found.rank(found.of()) == found.rank(found.of(), same_size=False) == 1
    for criterion in CRITERIA:
        assert set(found.best_of_each_size(criterion)[4].terms) == set(PAPER)


def test_other_terms_are_selected_when_those_made_the_data():
    terms = ((1, 0), (2, 0), (2, 2), (1, 3))
    found = select_terms(campaign(0.01, terms=terms, values=[0.1, 0.4, 0.3, -0.2]), SCALES)
    assert set(found.best().terms) == set(terms)
    order = [found.best().terms.index(term) for term in terms]
    np.testing.assert_allclose(np.array(found.best().coefficients)[order], [0.1, 0.4, 0.3, -0.2], atol=0.02)
    assert found.rank(found.of()) > 1


def test_chance_adds_a_term_no_more_often_than_bic_allows():
    chosen = [set(select_terms(campaign(0.05, seed), SCALES).best().terms) == set(PAPER) for seed in range(8)]
    assert sum(chosen) >= 5


def test_scores_are_what_their_names_say():
    static = campaign(0.1, 3)
    found = select_terms(static, SCALES)
    paper, fit = found.of(), fit_static_map(static, SCALES)
    told = {f"c{i}{j}": value for (i, j), value in zip(paper.terms, paper.coefficients, strict=True)}
    for name, value in fit.coefficients.items():
        assert told[name] == pytest.approx(value, rel=1e-9)
    assert paper.r2_adjusted == pytest.approx(fit.r2_adjusted, rel=1e-12)
    errors = []
    for left_out in range(found.points):
        rest = np.arange(found.points) != left_out
        columns = {n: getattr(static, n)[rest] for n in ("omega_ref", "beta_ref", "omega", "thrust", "thrust_std", "samples")}
        values = np.array(list(fit_static_map(replace(static, **columns), SCALES).coefficients.values()))
        one = static.omega[[left_out]], static.beta_ref[[left_out]]
        errors.append(static.thrust[left_out] - float(design(*one, SCALES)[0] @ values) * SCALES["thrust_scale"])
    assert paper.loo == pytest.approx(np.sqrt(np.mean(np.square(errors))), rel=1e-9)
    one_more = next(c for c in found.tried if set(c.terms) == {*PAPER, (1, 3)})
    more = design(static.omega, static.beta_ref, SCALES, one_more.terms) @ one_more.coefficients * SCALES["thrust_scale"]
    error = static.thrust_std / 10.0
    gain = np.sum((fit.residual / error) ** 2) / np.sum(((static.thrust - more) / error) ** 2)
    assert paper.bic - one_more.bic == pytest.approx(80 * np.log(gain) - np.log(80), abs=1e-9)


def test_the_table_has_the_best_of_each_size_and_the_papers():
    rows = select_terms(campaign(0.05), SCALES).rows()
    assert [row[0] for row in rows] == [*range(1, 11), 5]
    assert rows[-1][1] == "c20 c11 c30 c21 c12 (the paper's)"
    assert all(row[4] > 0 for row in rows)


def test_a_shift_of_the_pitch_scale_needs_other_terms():
    """A polynomial in degrees, rewritten with the paper's origin of -5 deg, has a term in the speed alone, (1, 0)."""
    degrees = {**SCALES, "beta_offset": 0.0}
    static = campaign(0.002, values=[-0.2, -0.2, 0.4, 0.3, -0.1], scales=degrees)
    assert set(select_terms(static, degrees).best().terms) == set(PAPER)
    shifted = select_terms(static, SCALES)
    assert set(shifted.best_of_each_size()[5].terms) == {*PAPER, (1, 0)}
    assert shifted.of().loo > 10.0 * shifted.of((*PAPER, (1, 0))).loo


def test_terms_that_the_grid_does_not_distinguish_are_left_out():
    found = select_terms(campaign(0.02, speeds=3), SCALES)
    assert found.points == 24
    assert found.of(((1, 0), (2, 0), (3, 0))) is not None
    assert found.of(((1, 0), (2, 0), (3, 0), (4, 0))) is None
    for static in (campaign(0.02, speeds=1), replace(campaign(0.0), beta_ref=np.full(80, 50.0))):
        with pytest.raises(BadInput, match="made up: steady points"):
            select_terms(static, SCALES)
