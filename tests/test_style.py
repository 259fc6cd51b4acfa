"""The project's former private words are gone from names and texts, and do not come back.

Ordinary English is allowed: "stands for", "data sheet", "what the model lacks".
"""

import io
import re
import tokenize
from functools import cache
from pathlib import Path

import pytest

PRODUCT = Path(__file__).parents[1]
FOLDERS = (".", "docs", "vpp_fmu", "identification", "hil", "fmu_src")

ANYWHERE = {
    "untold": "untold",
    "told": "told",
    "borne out": "borne",
    "remainders": "remainders",
    "lacking": "lacking",
    "lacks": "(?<!model )lacks",
    "senses": "senses",
    "stands": "(?:stands|stood)(?! (?:in )?for| still)",
    "at its word": "at (?:its|their) word",
    "what is left": "what (?:is|was) left|what (?:it|that|an?|the)(?: [a-z]+)? leaves",
    "by itself": "by (?:itself|themselves)",
    "rises, falls": "(?:likelihood|error|residual|evidence|variance|cost)s? (?:rises?|rose|falls?|fell)|falling evidence",
    "sheet": "(?<!data )(?<!style )(?<!excel )(?<![.])sheets?",
    "following": "(?:the|its|of|by) following(?= of|[.,;:)]|$)",
}
"""Pattern of each word in identifiers, strings, comments and Markdown. Underscores separate words."""

IN_NAMES = {"rises, falls": "rises|falls?|fallen", "following": "following", "worth": "worth"}
"""The same for words that are ordinary English in a text, and private only as names."""

PUBLIC = {
    ("told", "identification/gate/"): "key of a finding in check.json",
    ("told", "vpp_fmu/app/report/pages/identification.py"): "key of a finding in check.json",
    ("told", "vpp_fmu/app/report/summary.py"): "key cannot_be_told_apart of diagnosis.json",
    ("told", "hil/page/"): "key of the operator's page's messages",
    ("told", "vpp_fmu/app/report/drawing.py"): "key of the figures' data, which draw.js reads",
}
"""Where a word is allowed, with the reason."""

READ = {getattr(tokenize, kind) for kind in ("NAME", "COMMENT", "STRING", "FSTRING_MIDDLE") if hasattr(tokenize, kind)}


def _pattern(words):
    return re.compile(rf"(?<![A-Za-z])(?:{words})(?![A-Za-z])", re.IGNORECASE)


def _texts(path):
    """(line, text, whether it is a name) of all that a reader reads in a file."""
    content = path.read_text(encoding="utf-8")
    if path.suffix == ".md":
        yield from ((number, line, False) for number, line in enumerate(content.splitlines(), 1))
        return
    for token in tokenize.generate_tokens(io.StringIO(content).readline):
        name = token.type == tokenize.NAME
        if token.type in READ:
            yield from ((token.start[0] + below, line, name) for below, line in enumerate(token.string.splitlines()))


@cache
def places():
    """Places (file, line, text) of each word."""
    found = {word: [] for word in ANYWHERE | IN_NAMES}
    anywhere = {word: _pattern(words) for word, words in ANYWHERE.items()}
    in_names = {word: _pattern(words) for word, words in IN_NAMES.items()}
    for folder in FOLDERS:
        for path in sorted((PRODUCT / folder).glob("*.md" if folder == "." else "**/*")):
            if path.suffix not in (".py", ".md"):
                continue
            for line, text, name in _texts(path):
                place = f"{path.relative_to(PRODUCT).as_posix()}:{line}: {text.strip()}"
                for word, pattern in [*anywhere.items(), *(in_names.items() if name else ())]:
                    found[word] += [place] * len(pattern.findall(text))
    return found


@pytest.mark.parametrize("word", sorted(ANYWHERE | IN_NAMES))
def test_a_private_word_does_not_come_back(word):
    allowed = tuple(where for other, where in PUBLIC if other == word)
    found = [place for place in places()[word] if not place.startswith(allowed)]
    assert not found, "\n".join(found)


def test_the_patterns_spare_ordinary_english():
    for text in ("x stands for y", "the data sheet", "what the model lacks", "the following table", "a thrust stand", "retold"):
        assert not any(_pattern(words).search(text) for words in ANYWHERE.values()), text
    for text in ("left_told", "what the pitch leaves", "each is fitted by itself", "the error falls", "it stands in rig.json"):
        assert any(_pattern(words).search(text) for words in ANYWHERE.values()), text


def test_each_allowed_place_has_its_word():
    for word, where in PUBLIC:
        assert any(place.startswith(where) for place in places()[word]), f"{word}: {where}"
