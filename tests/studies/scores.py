"""Tables and figures of the blind study, from its cases' outcomes."""

from collections import Counter
from collections.abc import Callable, Sequence

import numpy as np
from scipy.stats import beta

from .detectable import LIMIT
from .missing import HIDDEN

VERDICTS = ("attributed", "family", "partly", "unexplained", "none")
NAMED = ("attributed", "family")
"""Verdicts that claim to know the name."""

KNOWABLE = ("singles", "pairs", "faint")
"""Kinds in which the library has what is hidden."""

ENOUGH = (LIMIT, 100.0, 1000.0)
"""Evidence from which on cases are counted apart."""


def interval(k: int, n: int) -> tuple[float, float]:
    """95 % interval of a share, k of n (Clopper and Pearson)."""
    low = beta.ppf(0.025, k, n - k + 1) if k else 0.0
    high = beta.ppf(0.975, k + 1, n - k) if k < n else 1.0
    return float(low), float(high)


def named(c: dict) -> set[str]:
    """What the diagnosis claims: its effects, and what it can't tell from them."""
    return set(c["effects"]).union(*c["family"].values()) if c["verdict"] in NAMED else set()


def hit(c: dict) -> bool:
    """Every hidden effect claimed, or what these data can't tell from it, no other found beside."""
    right = set(c["hidden"]) <= named(c) or set(c["equal"]) & named(c)
    return bool(right) and len(c["effects"]) == len(c["hidden"])


def wrong(c: dict) -> bool:
    """Claims to know, and no true name is in it, nor a relative of what is in no list."""
    right = {*c["hidden"], *(r for h in c["hidden"] for r in HIDDEN[h].relatives)}
    return c["verdict"] in NAMED and not right & named(c)


def tables(found: Sequence[dict]) -> str:
    """All that is printed."""
    lines = []
    for kind in dict.fromkeys(c["kind"] for c in found):
        part = [c for c in found if c["kind"] == kind]
        lines += ["", f"{kind}: {len(part)} cases", _verdicts(part)]
        lines += [_line(c) for c in part if c["kind"] != "none" or c["effects"] or c["verdict"] != "none"]
    return "\n".join([*lines, "", *figures(found)])


def _verdicts(part: Sequence[dict]) -> str:
    names = dict.fromkeys(" + ".join(c["hidden"]) or "-" for c in part)
    rows = [f"  {'hidden':40}" + "".join(f"{v:>12}" for v in VERDICTS) + f"{'named':>8}"]
    for name in names:
        own = [c for c in part if (" + ".join(c["hidden"]) or "-") == name]
        count = Counter(c["verdict"] for c in own)
        right = f"{sum(map(hit, own))}/{len(own)}" if part[0]["kind"] in KNOWABLE else ""
        rows.append(f"  {name[:40]:40}" + "".join(f"{count[v] or '.':>12}" for v in VERDICTS) + f"{right:>8}")
    return "\n".join(rows)


def _line(c: dict) -> str:
    mark = "ok   " if hit(c) and c["kind"] in KNOWABLE else "WRONG" if wrong(c) else "     "
    family = {n: o for n, o in c["family"].items() if o}
    share = "" if c["explained"] is None else f" explained {c['explained']:.2f}"
    truth = "" if c["removed"] is None else f" removed {c['removed']:.3f}"
    sizes = " ".join(f"{k}={v:.3g}" for k, v in c["sizes"].items())
    head = f"  {mark} {'+'.join(c['hidden']) or '-'} #{c['seed']} ({sizes}; evidence {c['evidence']:.0f}): {c['verdict']}"
    return f"{head} {'+'.join(c['effects'])}{' ~ ' + str(family) if family else ''}{share}{truth} {c['seconds']:.0f} s"


def figures(found: Sequence[dict]) -> list[str]:
    """The study's figures, one a line, with counts and intervals."""
    of = {k: [c for c in found if c["kind"] == k] for k in ("singles", "none", "outside", "deleted", "pairs", "faint")}
    seen = [c for c in of["singles"] if c["evidence"] >= LIMIT]
    lines = [f"detectable: log-likelihood of {LIMIT:g} or more over the best base model, noise-free, two records of 90 s"]
    lines.append(share("detectable single effects named", hit, seen))
    for low, high in zip(ENOUGH, (*ENOUGH[1:], np.inf), strict=True):
        lines.append(share(f"  of evidence {low:g} to {high:g}", hit, [c for c in seen if low <= c["evidence"] < high]))
    first = lambda c: bool(c["rounds"]) and c["rounds"][0][0][0].split(" ")[0] in c["hidden"]  # noqa: E731
    lines.append(share("  first by BIC in the first round", first, seen))
    lines.append(share("  among the effects found, whatever the verdict", lambda c: c["hidden"][0] in c["effects"], seen))
    lines.append(share("  with a second, superfluous name", lambda c: c["verdict"] in NAMED and len(c["effects"]) > 1, seen))
    lines.append(share("  confidently wrong", wrong, seen))
    faint = [c for c in of["singles"] if c["evidence"] < LIMIT]
    lines.append(share("confidently wrong below the limit", wrong, faint))
    lines.append(share("false effect where there is none", lambda c: bool(c["effects"]), of["none"]))
    for kind in ("outside", "deleted"):
        shown = [c for c in of[kind] if c["evidence"] >= LIMIT]
        lines.append(share(f"confident wrong name, {kind}", wrong, shown))
        if kind == "deleted":
            told = lambda c: wrong(c) and c["own_name_gains"] >= LIMIT  # noqa: E731
            lines.append(share("  where its own name would fit detectably better", told, shown))
        if kind == "outside":
            lines.append(share("  any confident name", lambda c: c["verdict"] in NAMED, shown))
    for low, high in ((20.0, 60.0), (60.0, 200.0)):
        near = [c for c in of["faint"] if low <= c["evidence"] < high]
        lines.append(share(f"faint effects of evidence {low:g} to {high:g} named", hit, near))
    lines.append(share("  confidently wrong", wrong, of["faint"]))
    exact = [c for c in of["pairs"] if c["evidence"] >= LIMIT]
    lines.append(share("pairs exact", hit, exact))
    compared = [p for c in seen if hit(c) for p in c["parameters"].values()]
    lines.append(share("parameters within 10 % or covered, of singles named", lambda p: p[3], compared))
    for what, key in (("explainable error removed, held out", "explained"), ("true error removed, held out", "removed")):
        values = [c[key] for c in seen if hit(c) and c[key] is not None]
        lines.append(f"{what}, median of singles named: " + (f"{np.median(values):.3f} of {len(values)}" if values else "-"))
    lines.append(f"median seconds: {np.median([c['seconds'] for c in found]):.1f}" if found else "no cases")
    return lines


def share(what: str, test: Callable[[dict], bool], of: Sequence) -> str:
    """`what: k of n (share, interval)`."""
    k, n = sum(map(test, of)), len(of)
    if not n:
        return f"{what}: no cases"
    low, high = interval(k, n)
    return f"{what}: {k} of {n} ({100 * k / n:.0f} %, 95 % interval {100 * low:.0f}-{100 * high:.0f} %)"


def confusion(found: Sequence[dict]) -> str:
    """CSV: one row a hidden effect or pair and kind, one column a named set, counts."""
    rows = [(c["kind"], " + ".join(c["hidden"]) or "-", _said(c)) for c in found]
    said = sorted({r[2] for r in rows})
    lines = [",".join(["kind", "hidden", *said])]
    for kind, hidden in dict.fromkeys(r[:2] for r in rows):
        counts = Counter(r[2] for r in rows if r[:2] == (kind, hidden))
        lines.append(",".join([kind, hidden, *(str(counts[s]) for s in said)]))
    return "\n".join(lines) + "\n"


def _said(c: dict) -> str:
    return " + ".join(sorted(c["effects"])) if c["verdict"] in NAMED else c["verdict"]
