"""Tables and figures of the blind study, from its cases' rows (`diagnosis.outcome`)."""

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import beta, kstest

from .detectable import LIMIT
from .hidden_effects import HIDDEN

NAMED = ("attributed", "family")
"""Verdicts that name effects."""

ALWAYS = frozenset({"rotor_vibration"})
"""Effects of every rig of the study: naming them is never wrong."""

Rows = Sequence[dict]


def interval(k: int, n: int) -> tuple[float, float]:
    """95 % interval of a share, k of n (Clopper and Pearson)."""
    low = beta.ppf(0.025, k, n - k + 1) if k else 0.0
    high = beta.ppf(0.975, k + 1, n - k) if k < n else 1.0
    return float(low), float(high)


def found(c: dict) -> set[str]:
    """Effects that the diagnosis put into the model, less those of every rig."""
    return set(c["effects"]) - (ALWAYS - set(c["hidden"]))


def named(c: dict) -> set[str]:
    """Named effects: those of the model and their families, if the verdict names effects."""
    return found(c).union(*c["family"].values()) if c["verdict"] in NAMED else set()


def right(c: dict) -> set[str]:
    """Correct names: the hidden effects, those that these data cannot distinguish from them, and relatives of unlisted ones."""
    is_unlisted = c["kind"] in ("outside", "deleted")
    relatives = {r for h in c["hidden"] for r in HIDDEN[h].relatives} if is_unlisted else set()
    return {*c["hidden"], *relatives}.union(*c["equal"].values())


def hit(c: dict) -> bool:
    """Every hidden effect is named, or one that these data cannot distinguish from it, and the model has no other effect."""
    known = all({h, *c["equal"].get(h, ())} & named(c) for h in c["hidden"])
    return known and len(found(c)) == len(c["hidden"])


def wrong(c: dict) -> bool:
    """Names effects, but one of them and its whole family are false, or there are more than are hidden."""
    if c["verdict"] not in NAMED:
        return False
    return any(not right(c) & {name, *c["family"].get(name, ())} for name in found(c)) or len(found(c)) > max(
        1, len(c["hidden"])
    )


def passed_over(c: dict) -> bool:
    """Names effects, but misses a hidden one; no name is wrong."""
    return c["verdict"] in NAMED and not wrong(c) and not hit(c)


def honest(c: dict) -> bool:
    """Says that something is missing, and names nothing false."""
    return c["verdict"] not in (*NAMED, "none") and found(c) <= right(c)


def detectable(c: dict) -> bool:
    """Whether the open-loop records could show the hidden effect; of a pair, both."""
    return c["evidence"] >= LIMIT


def betrayed(c: dict) -> bool:
    """Wrong, with a model that these records distinguish from the truth."""
    return wrong(c) and c["behind"] >= LIMIT


def removed(c: dict) -> float:
    """Share of the true error's power that the final model removes on a hold-out record."""
    before, after = c["true_error"]
    return 1.0 - (after / before) ** 2


def ships(c: dict) -> bool:
    """Whether effects went into the model."""
    return bool(c["effects"])


def worse(c: dict) -> bool:
    """The final model is worse than its base."""
    return ships(c) and removed(c) < 0.0


@dataclass(frozen=True)
class Column:
    """A column of the tables, under the heads `group` and `head`: how many of the rows selected by `of` pass the `test`."""

    group: str
    head: str
    of: Callable[[dict], bool]
    test: Callable[[dict], bool]

    def cell(self, part: Rows) -> str:
        """`k/n`, empty if there are no rows."""
        own = [c for c in part if self.of(c)]
        return f"{sum(map(self.test, own))}/{len(own)}" if own else ""


def _none(c):
    return c["kind"] == "none"


def _single(c):
    return c["kind"] == "single" and detectable(c)


def _pair(c):
    return c["kind"] == "pair" and detectable(c)


def _unlisted(c):
    return c["kind"] in ("outside", "deleted") and detectable(c)


COLUMNS = (
    Column("none", "named", _none, lambda c: bool(found(c))),
    Column("", "missing", _none, lambda c: not found(c) and c["verdict"] not in (*NAMED, "none")),
    Column("single", "named", _single, hit),
    Column("", "wrong", _single, wrong),
    Column("", "none", _single, lambda c: c["verdict"] == "none"),
    Column("", "open", _single, lambda c: not hit(c) and not wrong(c) and c["verdict"] != "none"),
    Column("pair", "both", _pair, hit),
    Column("", "honest", _pair, honest),
    Column("", "passed", _pair, lambda c: passed_over(c) or c["verdict"] == "none"),
    Column("", "wrong", _pair, wrong),
    Column("no list", "wrong", _unlisted, wrong),
    Column("ships", "worse", ships, worse),
)
"""Singles, pairs, and effects in no list count if they are detectable. `missing`: false "something is missing"; `open`: neither
named, wrong nor none; `honest`: says that something is missing and names nothing false; `passed`: an effect is passed over."""

FACTORS: dict[str, Callable[[dict], object]] = {
    "all": lambda c: "",
    "size": lambda c: c["factors"]["size"],
    "rate": lambda c: f"{c['factors']['rate']} Hz",
    "noise": lambda c: c["factors"]["noise"],
    "noise level": lambda c: _band(c["factors"]["level"], (0.8, 1.25), ""),
    "length": lambda c: _band(c["factors"]["seconds"], (30.0, 60.0), " s"),
    "records": lambda c: ", ".join(f"{'' if c['factors'][n] else 'no '}{n}" for n in ("repeat", "validation")),
    "start": lambda c: ", ".join(f"{'' if c['factors'][n] else 'no '}{n}" for n in ("static", "steps")),
    "vibration": lambda c: "in phase" if c["factors"]["locked"] else "free",
    "strength": lambda c: _band(c["factors"]["strength"], (1 / 3, 2 / 3), "") if c["hidden"] else "",
    "evidence": lambda c: _band(c["evidence"], (LIMIT, 100.0, 1000.0), "") if c["hidden"] else "",
}


def _band(value: float, edges: Sequence[float], unit: str) -> str:
    for low, high in zip((-np.inf, *edges), edges, strict=False):
        if value < high:
            return f"< {_short(high)}{unit}" if np.isinf(low) else f"{_short(low)} to {_short(high)}{unit}"
    return f"> {_short(edges[-1])}{unit}"


def _short(edge: float) -> str:
    return f"{edge:.0f}" if edge >= 10.0 else f"{edge:.3g}"


def tables(rows: Rows) -> str:
    """The printed tables."""
    done = [c for c in rows if not c["failed"]]
    lines = [*_noteworthy(rows), "", *by_factor(done), "", *by_effect(done), "", *figures(done)]
    if len(done) < len(rows):
        lines.append(f"not done: {len(rows) - len(done)} of {len(rows)} cases")
    return "\n".join(lines)


def by_factor(rows: Rows, factors: Mapping[str, Callable] = FACTORS, columns: Sequence[Column] = COLUMNS) -> list[str]:
    """One line for each level of a factor, with the columns."""
    lines = _head("factor", columns)
    for factor, level in factors.items():
        levels = sorted({level(c) for c in rows}, key=_order)
        for value in [value for value in levels if value != "" or factor == "all"]:
            lines.append(_cells(f"{factor}: {value}".removesuffix(": "), [c for c in rows if level(c) == value], columns))
    return lines


def _order(level: str) -> tuple[float, str]:
    """Sort key: numbers by size, levels below the first edge first; words last."""
    number = re.match(r"[<>]? ?(\d[\d.]*)", level)
    place = float(number[1]) + {"<": -1e-6, ">": 1e-6}.get(level[0], 0.0) if number else np.inf
    return place, level


def by_effect(rows: Rows) -> list[str]:
    """One line for each hidden effect or pair."""
    lines = _head("hidden", COLUMNS)
    for hidden in dict.fromkeys(tuple(c["hidden"]) for c in rows):
        lines.append(_cells(" + ".join(hidden) or "-", [c for c in rows if tuple(c["hidden"]) == hidden], COLUMNS))
    return lines


def _head(what: str, columns: Sequence[Column]) -> list[str]:
    lines = ("", [c.group for c in columns]), (what, [c.head for c in columns])
    return [f"{label:44}" + "".join(f"{head:>9}" for head in heads).rstrip() for label, heads in lines]


def _cells(what: str, part: Rows, columns: Sequence[Column]) -> str:
    return (f"{what[:43]:44}" + "".join(f"{c.cell(part):>9}" for c in columns)).rstrip()


def _noteworthy(rows: Rows) -> list[str]:
    """A line for each case that is not as it should be, with what is needed to run it again."""
    lines = []
    for c in rows:
        if c["failed"]:
            lines.append(f"FAILED  {_case(c)}: {c['failed']}")
        elif c["kind"] == "none" and (found(c) or c["verdict"] != "none"):
            lines.append(f"{'FALSE' if found(c) else 'missing':7} {_case(c)}: {_said(c)}")
        elif wrong(c):
            own = f"; with its own name in the list: {', '.join(c['with_own_name'])}" if "with_own_name" in c else ""
            lines.append(f"WRONG   {_case(c)}: {_said(c)}; {c['behind']:.0f} behind the truth{own}")
        elif c["kind"] in ("single", "pair") and detectable(c) and not hit(c):
            lines.append(f"missed  {_case(c)}: {_said(c)}")
        if not c["failed"] and worse(c):
            before, after = c["true_error"]
            lines.append(f"WORSE   {_case(c)}: {_said(c)}; {before:.3g} N became {after:.3g} N where nobody looked")
    return lines


def _case(c: dict) -> str:
    f = c["factors"]
    files = " ".join(n for n in ("repeat", "validation", "static", "steps") if f[n])
    rig = f"{f['size']} {f['rate']} Hz {f['seconds']:.0f} s, {f['noise']} x {f['level']:.2f}, {files or 'open loop only'}"
    return f"{c['name']} ({rig}" + (f"; evidence {c['evidence']:.0f})" if c["hidden"] and "evidence" in c else ")")


def _said(c: dict) -> str:
    rivals = sorted({name for others in c["family"].values() for name in others})
    return f"{c['verdict']} {' + '.join(c['effects'])}{' ~ ' + ', '.join(rivals) if rivals else ''}".strip()


def figures(rows: Rows) -> list[str]:
    """The study's figures, one a line, with counts and intervals."""
    singles, none = [c for c in rows if _single(c)], [c for c in rows if _none(c)]
    pairs, unlisted = [c for c in rows if _pair(c)], [c for c in rows if _unlisted(c)]
    lines = [f"detectable: log-likelihood of {LIMIT:g} or more over the best base model in the open-loop records, noise-free"]
    lines.append(share("false name where nothing is hidden (aim <= 1 %)", COLUMNS[0].test, none))
    lines.append(share("false 'something is missing' there (aim <= 2 %)", COLUMNS[1].test, none))
    lines.append(share("detectable single effects named (aim >= 95 %)", hit, singles))
    lines.append(share("  called wrong (aim <= 1 %)", wrong, singles))
    lines.append(
        share("  undetectable ones called wrong", wrong, [c for c in rows if c["kind"] == "single" and not detectable(c)])
    )
    lines.append(share("pairs: both", hit, pairs))
    lines.append(share("  one or none, and says so", honest, pairs))
    lines.append(share("  called wrong", wrong, pairs))
    lines.append(share("    by a model that these records tell from the truth", betrayed, pairs))
    lines.append(share("in no list, or deleted from it: called wrong (aim <= 1 %)", wrong, unlisted))
    lines.append(share("  by a model that these records tell from the truth", betrayed, unlisted))
    repeated = [c for c in unlisted if "with_own_name" in c]
    lines.append(
        share("  of these, with its own name in the list called so", lambda c: c["hidden"][0] in c["with_own_name"], repeated)
    )
    claimed = [c for c in rows if c["kind"] == "single" and c["verdict"] in NAMED and detectable(c)]
    lines.append(
        share("what is named, family and all, holds the truth (aim >= 95 %)", lambda c: bool(right(c) & named(c)), claimed)
    )
    compared = [p for c in singles if hit(c) for p in c["parameters"].values()]
    lines.append(share("parameters within 10 % or covered, of singles named", lambda p: p[3], compared))
    # The phase of the vibration differs on another record.
    kept = [c for c in rows if not ALWAYS & {*c["effects"], *c["hidden"]}]
    lines.append(_removed("detectable singles, named or not", [c for c in singles if c in kept]))
    lines.append(_removed("all that ships", [c for c in kept if ships(c)]))
    lines.append(share("what ships is worse than its base (aim: none)", worse, [c for c in rows if ships(c)]))
    lines += _calibration("no effect, before", _p_values(none, "before"))
    lines += _calibration("singles named, after", _p_values([c for c in singles if hit(c)], "after"))
    return lines + _costs(rows)


def _removed(what: str, part: Rows) -> str:
    if not part:
        return f"removed of the true error on a record that nobody saw, {what}: no cases"
    values = np.array([removed(c) for c in part])
    middle, low = np.quantile(values, [0.5, 0.1])
    worst = part[int(np.argmin(values))]["name"]
    text = f"median {middle:.3f}, a tenth below {low:.3f}, worst {values.min():.3f} ({worst})"
    return f"removed of the true error on a record that nobody saw, {what}: {text}, of {len(part)}"


def _p_values(part: Rows, when: str) -> list[float]:
    """p-values of the diagnosis' own test of lack of fit, if it reports them."""
    tests = ((c["lack_of_fit"] or {}).get(when) for c in part)
    return [t["p"] for t in tests if isinstance(t, dict) and t.get("p") is not None]


def _calibration(what: str, p: Sequence[float]) -> list[str]:
    """Whether p-values are uniform: counts by tenths as a plot, and the Kolmogorov-Smirnov test's own p."""
    if not p:
        return [f"lack of fit, {what}: no p-values in diagnosis.json"]
    counts, _ = np.histogram(p, np.linspace(0.0, 1.0, 11))
    bars = "\n".join(f"  {k / 10:.1f} to {(k + 1) / 10:.1f} {'#' * n} {n}" for k, n in enumerate(counts))
    return [f"lack of fit, {what}: {len(p)} p-values, uniform with p = {kstest(p, 'uniform').pvalue:.3f}", bars]


def _costs(rows: Rows) -> list[str]:
    """Seconds and memory by the number of readings."""
    lines = []
    for band in sorted({_readings(c) for c in rows}, key=_order):
        part = [c for c in rows if _readings(c) == band]
        costs = ((np.array([c[n] for c in part]), unit) for n, unit in (("seconds", "s"), ("cpu", "s of CPU"), ("mb", "MB")))
        text = "; ".join(f"{np.median(values):.0f} {unit}, at most {values.max():.0f}" for values, unit in costs)
        lines.append(f"a diagnosis of {band} readings ({len(part)}): median {text}")
    return lines


def _readings(c: dict) -> str:
    return _band(c["readings"], (10_000, 30_000, 100_000), "")


def share(what: str, test: Callable[[dict], bool], of: Iterable) -> str:
    """`what: k of n (share, interval)`."""
    of = list(of)
    k, n = sum(map(test, of)), len(of)
    if not n:
        return f"{what}: no cases"
    low, high = interval(k, n)
    return f"{what}: {k} of {n} ({100 * k / n:.0f} %, 95 % interval {100 * low:.0f}-{100 * high:.0f} %)"
