"""python -m tests.studies rules: the effect of each rule of a diagnosis.

Each case of the study `diagnosis` runs with all rules, and then without each rule that decided something in the case. The table
counts the cases in which a rule decided, those that ran without it, and those in which the verdict or the names then differ:
right to wrong, wrong to right, or neither. A rule that decides in no case, or that changes no verdict, can be deleted.
"""

import importlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from unittest.mock import patch

from identification.diagnose.lack_of_fit import LackOfFit
from vpp_fmu.kernel.plant import LIBRARY

from . import diagnosis, scores
from .cases import Case
from .row_file import kept, read


@dataclass(frozen=True)
class Rule:
    """A rule is a function of the diagnosis; `place`: module:name or module:class.name. `without(original, *arguments)` returns
    two functions: one gives the value without the rule, the other decides from the value with it whether it had an effect."""

    place: str
    without: Callable

    @contextmanager
    def removed(self) -> Iterator[None]:
        """Run without the rule."""
        with self._replaced(lambda called, value_without, decided: value_without()):
            yield

    @contextmanager
    def observed(self, decides: Callable[[], None]) -> Iterator[None]:
        """Run with the rule; `decides` is called where it decides anything."""

        def kept(called, value_without, decided):
            value = called()
            if decided(value):
                decides()
            return value

        with self._replaced(kept):
            yield

    @contextmanager
    def _replaced(self, by: Callable) -> Iterator[None]:
        module, _, name = self.place.partition(":")
        owner = importlib.import_module(module)
        *outer, name = name.split(".")
        for each in outer:
            owner = getattr(owner, each)
        original = owner.__dict__[name]
        called = original.fget if isinstance(original, property) else original

        def replaced(*given, **named):
            return by(lambda: called(*given, **named), *self.without(called, *given, **named))

        with patch.object(owner, name, property(replaced) if isinstance(original, property) else replaced):
            yield


def _constant(neutral) -> Callable:
    """The rule's value is `neutral` without it; the rule decides if its value is another one."""
    return lambda original, *given, **named: (lambda: neutral, lambda value: value != neutral)


def _unchanged(position: int) -> Callable:
    """Without the rule, an argument is returned unchanged; the rule decides if it returns another object."""
    return lambda original, *given, **named: (lambda: given[position], lambda value: value is not given[position])


def _reason(text: str) -> Callable:
    """A reason to reject an effect; the rule decides if this is the only reason."""

    def without(original, *given, **named):
        return (
            lambda: [one for one in original(*given, **named) if text not in one],
            lambda value: len(value) == 1 and text in value[0],
        )

    return without


def _flag(*others: property) -> Callable:
    """A check of lack of fit; the rule decides if this check alone finds something."""
    return lambda original, lack: (lambda: False, lambda value: value and not any(check.fget(lack) for check in others))


HERE = "identification.diagnose"
RULES: Mapping[str, Rule] = {
    "gain above chance and form": Rule(f"{HERE}.acceptance:refusals", _reason("chance and errors of form")),
    "evidence": Rule(f"{HERE}.acceptance:refusals", _reason("evidence too weak")),
    "cross-validation gains": Rule(f"{HERE}.acceptance:refusals", _reason("cross-validation gains nothing")),
    "thrust not worse": Rule(f"{HERE}.acceptance:refusals", _reason("thrust is predicted worse")),
    "size": Rule(f"{HERE}.acceptance:refusals", _reason("below the least size of interest")),
    "noise again from a fit": Rule(f"{HERE}.diagnose:with_lower_noise", _constant(None)),
    "noise again at the start": Rule(f"{HERE}.initial_model:with_lower_noise", _constant(None)),
    "second start": Rule(f"{HERE}.selection:_next_best", _constant(None)),
    "special case ranked first": Rule(
        f"{HERE}.selection:_ranked",
        lambda original, tried: (
            lambda: sorted(tried, key=lambda t: -t.evidence),
            lambda value: bool(value) and value[0].evidence < max(t.evidence for t in value),
        ),
    ),
    "exchange": Rule(f"{HERE}.selection:_exchanged", _constant(False)),
    "rival with all sizes": Rule(f"{HERE}.selection:_all_on", _unchanged(2)),
    "step responses confirm a phase": Rule(f"{HERE}.validation:without", _unchanged(2)),
    "prior weighed again": Rule(f"{HERE}.search.fits:Fit.agreed", _unchanged(0)),
    "estimates of the identification": Rule(f"{HERE}.search.fits:Fit.as_identified", _unchanged(0)),
    "map of the identification": Rule(f"{HERE}.search.fits:Fit.with_map_of", _unchanged(0)),
    "size as estimated for prediction": Rule(f"{HERE}.acceptance:Judge.matters", _constant(True)),
    "base predicts better": Rule(f"{HERE}.validation:base_predicts_better", _constant("")),
    "significantly worse": Rule(f"{HERE}.validation:significantly_worse", _constant("")),
    "part does not carry over": Rule(f"{HERE}.validation:part_does_not_carry_over", _constant("")),
    "steps lose more": Rule(f"{HERE}.validation:steps_lose_more", _constant("")),
    "reported error increases": Rule(f"{HERE}.validation:reported_error_increases", _constant("")),
    "family tried when refuted": Rule(f"{HERE}.diagnose:next_valid_alternative", _constant(None)),
    "transient thrust": Rule(f"{HERE}.lack_of_fit:LackOfFit.transient_lack_of_fit", _flag(LackOfFit.speed_lack_of_fit)),
    "structured speed": Rule(f"{HERE}.lack_of_fit:LackOfFit.speed_lack_of_fit", _flag(LackOfFit.transient_lack_of_fit)),
    "rotor order": Rule(f"{HERE}.lack_of_fit:LackOfFit.turns", _flag(LackOfFit.significant)),
    "near the leader": Rule(f"{HERE}.search.refits:_near", _constant([])),
    "other order of lags": Rule(f"{HERE}.search.refits:_reordered", _constant([])),
    "from a special case": Rule(f"{HERE}.search.refits:_narrowed", _constant(None)),
    "sizes on again": Rule(f"{HERE}.search.refits:_revived", _unchanged(2)),
    "superfluous sizes": Rule(f"{HERE}.search.refits:simplified", _unchanged(2)),
}


@dataclass(frozen=True)
class Asked:
    """A case, and the rule to remove; None: all rules apply."""

    case: Case
    rule: str | None = None

    def summary(self) -> dict:
        """Summary of the case, and the rule."""
        return self.case.summary() | {"without": self.rule}


def main(parser, arguments):
    diagnosis.configure(parser)
    parser.set_defaults(output="out/rules.jsonl", limit=3600.0)
    parser.add_argument("--rules", default=",".join(RULES), metavar="A,B", help="to remove (default: all)")
    parser.add_argument(
        "--removals", type=int, metavar="N", help="cases to run without each rule, of those in which it decides (default: all)"
    )
    options = parser.parse_args(arguments)
    path = Path(options.output)
    found = {_key(row): row for row in read(path)}
    if not options.only_table:
        cases = diagnosis.chosen(options)

        def run(asked: Sequence[Asked]) -> None:
            missing = [one for one in asked if _key(one.summary()) not in found]
            for row in kept(path, diagnosis.rows(missing, options.workers, options.threads, options.limit, work=outcome)):
                found[_key(row)] = row

        run([Asked(case) for case in cases])
        for rule in options.rules.split(","):
            decided = [case for case in cases if rule in found[_key(Asked(case).summary())].get("decided", ())]
            run([Asked(case, rule) for case in decided[: options.removals]])
    print(scores.tables([row for row in found.values() if row["without"] is None]), table(list(found.values())), sep="\n\n")


def _key(row: dict) -> tuple:
    return row["name"], row["without"]


def outcome(asked: Asked, threads: int) -> dict:
    """The outcome of a case. With all rules, `decided` lists those that decided something."""
    decided: set[str] = set()
    with ExitStack() as stack:
        if asked.rule is None:
            for name, rule in RULES.items():
                stack.enter_context(rule.observed(lambda name=name: decided.add(name)))
            return diagnosis.outcome(asked.case, threads, LIBRARY) | {"without": None, "decided": sorted(decided)}
        stack.enter_context(RULES[asked.rule].removed())
        try:
            return diagnosis.outcome(asked.case, threads, LIBRARY) | {"without": asked.rule}
        except Exception as error:  # without a rule any error may occur; the table has it
            nothing = {"failed": None, "verdict": type(error).__name__, "effects": [], "family": {}, "seconds": 0.0}
            return asked.summary() | nothing


def table(rows: Sequence[dict]) -> str:
    """One line for each rule."""
    found = {_key(row): row for row in rows if not row["failed"]}
    all_rules = [row for row in found.values() if row["without"] is None]
    lines = [f"{len(all_rules)} cases with all rules, {len(rows) - len(found)} runs failed", ""]
    heads = "rule", "decided", "removed", "verdict or names differ", "worse without", "better without", "seconds, ratio"
    lines += [f"| {' | '.join(heads)} |", "| --- |" + " --- |" * (len(heads) - 1)]
    for name in RULES:
        decided = [row for row in all_rules if name in row["decided"]]
        pairs = [(row, found[row["name"], name]) for row in decided if (row["name"], name) in found]
        changed = [(old, new) for old, new in pairs if _said(old) != _said(new)]
        worse = [old["name"] for old, new in changed if _fine(old) and not _fine(new)]
        better = [old["name"] for old, new in changed if _fine(new) and not _fine(old)]
        ratio = sum(new["seconds"] for _, new in pairs) / sum(old["seconds"] for old, _ in pairs) if pairs else 1.0
        named = (f"{len(names)} {', '.join(names[:4])}".rstrip() for names in (worse, better))
        cells = (name, len(decided), len(pairs), len(changed), *named, f"{ratio:.2f}")
        lines.append(f"| {' | '.join(map(str, cells))} |")
    return "\n".join(lines)


def _said(row: dict) -> tuple:
    return row["verdict"], sorted(row["effects"]), {k: sorted(v) for k, v in row["family"].items()}


def _fine(row: dict) -> bool:
    """Whether the diagnosis is right: no false name, and the hidden effects are named or said to be missing."""
    if row["kind"] == "none":
        return row["verdict"] == "none"
    return scores.hit(row) if row["kind"] in ("single", "pair") else not scores.wrong(row)
