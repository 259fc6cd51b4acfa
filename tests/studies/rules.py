"""python -m tests.studies rules: what each rule of a diagnosis is worth.

Each case of the study `diagnosis` runs with all rules, and then without one of them in turn, unless the rule decided nothing in
the case. The table counts the cases in which a rule decided, and those in which the verdict or the names differ without it:
right to wrong, wrong to right, or neither. A rule that changes no verdict can be deleted.
"""

import argparse
import importlib
import json
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from unittest.mock import patch

from vpp_fmu.kernel.plant import LIBRARY

from . import diagnosis, scores
from .cases import Case


@dataclass(frozen=True)
class Rule:
    """A rule is a function of the diagnosis; `place`: module:name or module:class.name. `without(original, *arguments)` returns
    two functions: one gives the value without the rule, one tells from the value with it whether the rule decided anything."""

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
    """The rule's value is `neutral` without it; it decides where it is another one."""
    return lambda original, *given, **named: (lambda: neutral, lambda value: value != neutral)


def _unchanged(position: int) -> Callable:
    """Without the rule, an argument is returned as it is; it decides where it returns something else."""
    return lambda original, *given, **named: (lambda: given[position], lambda value: value is not given[position])


def _reason(text: str) -> Callable:
    """A reason to reject an effect; it decides where it is the only one."""

    def without(original, *given, **named):
        return (
            lambda: [one for one in original(*given, **named) if text not in one],
            lambda value: len(value) == 1 and text in value[0],
        )

    return without


def _flag(*others: str) -> Callable:
    """A check of lack of fit; it decides where it alone finds something."""
    return lambda original, lack: (lambda: False, lambda value: value and not any(getattr(lack, name) for name in others))


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
    "transient thrust": Rule(f"{HERE}.lack_of_fit:LackOfFit.transient_lack_of_fit", _flag("speed_lack_of_fit")),
    "structured speed": Rule(f"{HERE}.lack_of_fit:LackOfFit.speed_lack_of_fit", _flag("transient_lack_of_fit")),
    "rotor order": Rule(f"{HERE}.lack_of_fit:LackOfFit.turns", _flag("significant")),
    "near the leader": Rule(f"{HERE}.search.refits:_near", _constant([])),
    "other order of lags": Rule(f"{HERE}.search.refits:_reordered", _constant([])),
    "from a special case": Rule(f"{HERE}.search.refits:_narrowed", _constant(None)),
    "sizes on again": Rule(f"{HERE}.search.refits:_revived", _unchanged(2)),
    "superfluous sizes": Rule(f"{HERE}.search.refits:simplified", _unchanged(2)),
}


def configure(parser: argparse.ArgumentParser) -> None:
    """Options of the study."""
    diagnosis.configure(parser)
    parser.set_defaults(output="out/rules.jsonl", limit=3600.0)
    parser.add_argument("--rules", default=",".join(RULES), metavar="A,B", help="to remove (default: all)")


def main(arguments: list[str]) -> None:
    """`python -m tests.studies rules`."""
    parser = argparse.ArgumentParser(prog="python -m tests.studies rules", description=__doc__)
    configure(parser)
    options = parser.parse_args(arguments)
    path = Path(options.output)
    rows = diagnosis.read(path)
    if not options.only_table:
        path.parent.mkdir(parents=True, exist_ok=True)
        done, asked = {row["name"] for row in rows}, options.rules.split(",")
        todo = [Asked(case, asked) for case in diagnosis.chosen(options) if case.name not in done]
        with path.open("a") as file:
            for row in diagnosis.rows(todo, options.workers, options.threads, options.limit, work=ablated):
                rows.append(row)
                file.write(json.dumps(row) + "\n")
                file.flush()
    print(table(rows))


@dataclass(frozen=True)
class Asked:
    """A case, and the rules to remove."""

    case: Case
    rules: Sequence[str]

    def summary(self) -> dict:
        """That of the case."""
        return self.case.summary()


def ablated(asked: Asked, threads: int) -> dict:
    """The outcome of a case, and `without`: by rule that decided something, the outcome without it."""
    decided: set[str] = set()
    with ExitStack() as stack:
        for name in asked.rules:
            stack.enter_context(RULES[name].observed(lambda name=name: decided.add(name)))
        row = diagnosis.outcome(asked.case, threads, LIBRARY)
    row["without"] = {}
    for name in (name for name in asked.rules if name in decided):
        began = time.perf_counter()
        with RULES[name].removed():
            try:
                other = diagnosis.outcome(asked.case, threads, LIBRARY)
            except Exception as error:  # without a rule anything may happen: the table says so
                other = row | {"verdict": f"{type(error).__name__}: {error}"}
        kept = ("verdict", "effects", "family", "true_error")
        row["without"][name] = {key: other[key] for key in kept} | {"seconds": time.perf_counter() - began}
    return row


def table(rows: Sequence[dict]) -> str:
    """One line a rule."""
    good = [row for row in rows if not row["failed"]]
    lines = [f"{len(good)} cases, {len(rows) - len(good)} not done", ""]
    lines += [
        "| rule | decided | verdict or names differ | worse without | better without | seconds, ratio |",
        "| --- |" + " --- |" * 5,
    ]
    for name in RULES:
        pairs = [(row, row | row["without"][name]) for row in good if name in row["without"]]
        changed = [(old, new) for old, new in pairs if _said(old) != _said(new)]
        worse = [old["name"] for old, new in changed if _fine(old) and not _fine(new)]
        better = [old["name"] for old, new in changed if _fine(new) and not _fine(old)]
        ratio = sum(new["seconds"] for _, new in pairs) / sum(old["seconds"] for old, _ in pairs) if pairs else 1.0
        cells = (
            name,
            len(pairs),
            len(changed),
            f"{len(worse)} {', '.join(worse[:4])}",
            f"{len(better)} {', '.join(better[:4])}",
        )
        lines.append("| " + " | ".join(map(str, cells)) + f" | {ratio:.2f} |")
    return "\n".join(lines)


def _said(row: dict) -> tuple:
    return row["verdict"], sorted(row["effects"]), {k: sorted(v) for k, v in row["family"].items()}


def _fine(row: dict) -> bool:
    """Whether the diagnosis is right: nothing false is named, and what is missing is named or said to be missing."""
    if row["kind"] == "none":
        return row["verdict"] == "none"
    return scores.hit(row) if row["kind"] in ("single", "pair") else not scores.wrong(row)
