"""The study of the rules: each rule is in the diagnosis, observed if it decides, and inactive if it is removed."""

import importlib

import pytest

from identification.diagnose import acceptance
from identification.diagnose.lack_of_fit import LackOfFit
from tests.studies.rules import RULES


@pytest.mark.parametrize("name", RULES)
def test_each_rule_is_in_the_diagnosis(name):
    module, _, place = RULES[name].place.partition(":")
    owner = importlib.import_module(module)
    for part in place.split("."):
        owner = getattr(owner, part)


@pytest.mark.parametrize(
    ("evidence", "gain", "refused", "decided"),
    [(9.0, 50.0, 0, 0), (1.0, 50.0, 1, 1), (1.0, -1.0, 2, 0)],
    ids=["accepted", "by this rule alone", "by another one too"],
)
def test_a_reason_decides_where_it_is_the_only_one(evidence, gain, refused, decided):
    rule, seen = RULES["evidence"], []
    given = (50.0, 10.0, evidence, {"thrust": gain}, 1, True)
    with rule.observed(lambda: seen.append(1)):
        assert len(acceptance.refusals(*given)) == refused
    assert len(seen) == decided
    with rule.removed():
        assert len(acceptance.refusals(*given)) == max(refused - 1, 0)
    assert len(acceptance.refusals(*given)) == refused


def test_a_check_of_the_lack_of_fit_is_removed_and_comes_back():
    found = LackOfFit((), None, 1.0, 0.0, 0.1, True, moving=0.9, transient_size=0.2)
    with RULES["transient thrust"].removed():
        assert not found.significant
    assert found.significant
