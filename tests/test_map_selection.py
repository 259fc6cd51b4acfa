"""Selection of the static map's terms, and the meaning of the scores."""

from dataclasses import replace

import numpy as np
import pytest

from identification.static.selection import CRITERIA, PAPER, select_terms
from identification.static.static_map import design
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
