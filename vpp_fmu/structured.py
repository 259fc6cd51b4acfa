"""JSON and TOML files: read within bounds of size and depth, each name once, numbers finite. Whatever else is a BadInput."""

import json
import os
import sys

from vpp_fmu.errors import BadInput
from vpp_fmu.files import read_text

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

DEEPEST = 50
"""Objects and lists within each other. What this project writes has 8 at most."""

LARGEST_JSON = 20 * 2**20
"""Characters. An identification.json has some 100 000."""

LARGEST_TOML = 128 * 2**10
LONGEST_LINE = 4096
"""Characters. Readers of TOML take a time that is quadratic in the parts of a dotted key."""

GREATEST = 1e300

LONGEST_NUMBER = 400
"""Digits of whole numbers, which Python reads in a time that is quadratic in them."""


def read_json(path: str | os.PathLike, allowed: str = "JSON") -> object:
    """What a JSON file holds. BadInput; `allowed`: what the file should be."""

    def once(pairs: list[tuple[str, object]]) -> dict:
        found = dict(pairs)
        if len(found) < len(pairs):
            names = [name for name, _ in pairs]
            (twice, *_) = (name for k, name in enumerate(names) if name in names[:k])
            raise BadInput(path, shown(twice), "this name more than once", "each name once")
        return found

    def whole(text: str) -> int | float:
        return int(text) if len(text) < LONGEST_NUMBER else float(text)

    text = _text(path, LARGEST_JSON, allowed)
    try:
        found = json.loads(text, object_pairs_hook=once, parse_int=whole)
    except json.JSONDecodeError as error:
        where = f"no JSON from column {error.colno} on ({error.msg})"
        raise BadInput(path, f"line {error.lineno}", where, allowed) from error
    except RecursionError as error:
        raise _too_deep(path) from error
    _check(path, found)
    return found


def read_object(path: str | os.PathLike, form: str | None = None, allowed: str = "JSON") -> dict:
    """What a JSON file holds that is one object, of the format `form` where that is given. BadInput."""
    found = read_json(path, allowed)
    if not isinstance(found, dict):
        raise BadInput(path, "file", shown(found), "an object in braces { }")
    if form is not None and found.get("format") != form:
        raise BadInput(path, "format", shown(found.get("format")), json.dumps(form))
    return found


def read_toml(path: str | os.PathLike, allowed: str = "TOML") -> dict:
    """What a TOML file holds. BadInput; `allowed`: what the file should be."""
    text = _text(path, LARGEST_TOML, allowed)
    longest, line = max((len(line), k) for k, line in enumerate(text.split("\n"), 1))
    if longest > LONGEST_LINE:
        raise BadInput(path, f"line {line}", f"{longest} characters", f"{LONGEST_LINE} at most")
    try:
        found = tomllib.loads(text)
    except RecursionError as error:
        raise _too_deep(path) from error
    except ValueError as error:  # not of TOML's own kind where a number or a date is none
        raise BadInput(path, "file", f"no TOML ({' '.join(str(error).split())[:120]})", allowed) from error
    _check(path, found)
    return found


KINDS = {
    str: "a text",
    bool: "true or false",
    int: "a whole number",
    float: "a number",
    dict: "an object in braces { }",
    list: "a list",
}


def check_kinds(path: str | os.PathLike, content: object, kinds: object, place: tuple = ()) -> None:
    """BadInput where a part of what a file holds is missing or of another kind.

    `kinds`: a type (None: anything); `[kinds]` for a list; `{name: kinds}` for an object, in which names that end in "?" may be
    missing or null and "*" is every name.
    """
    if kinds is None:
        return
    kind = kinds if isinstance(kinds, type) else type(kinds)
    whole = isinstance(content, int) and not isinstance(content, bool)
    if not (whole if kind is int else whole or isinstance(content, float) if kind is float else isinstance(content, kind)):
        raise BadInput(path, _field(place), shown(content), KINDS[kind])
    if isinstance(kinds, list):
        for k, each in enumerate(content, 1):
            check_kinds(path, each, kinds[0], (place, k))
    elif isinstance(kinds, dict):
        for name, inner in kinds.items():
            for key in content if name == "*" else [name.removesuffix("?")]:
                if key not in content and not name.endswith("?"):
                    raise BadInput(
                        path, _field((place, key)), "nothing", KINDS[inner if isinstance(inner, type) else type(inner)]
                    )
                if key in content and not (name.endswith("?") and content[key] is None):
                    check_kinds(path, content[key], inner, (place, key))


def as_json(content: dict) -> str:
    """JSON as this project writes it. What is not known is null where the number is made: NaN here is a program's fault."""
    return json.dumps(content, indent=2, allow_nan=False, ensure_ascii=False) + "\n"


def shown(found: object) -> str:
    """A value as a message shows it: on one line, not too long."""
    text = json.dumps(found, default=str)
    return text if len(text) <= 60 else f"{text[:57]}..."


def _text(path: str | os.PathLike, most: int, allowed: str) -> str:
    text = read_text(path)
    if len(text) > most:
        raise BadInput(path, "file", f"{len(text)} characters", f"{most} at most, {allowed}")
    return text


def _check(path: str | os.PathLike, content: object) -> None:
    """BadInput where it is too deep, a number is not finite, or a text holds half a character, which no file could take."""
    level: list[tuple[tuple, object]] = [((), content)]
    for _ in range(DEEPEST):
        below: list[tuple[tuple, object]] = []
        for place, each in level:
            if isinstance(each, dict):
                below += [((place, name), value) for name, value in each.items()]
                _check_text(path, place, "".join(each))
            elif isinstance(each, list):
                below += [((place, k), value) for k, value in enumerate(each, 1)]
            elif isinstance(each, str):
                _check_text(path, place, each)
            elif isinstance(each, int | float) and not -GREATEST < each < GREATEST:
                raise BadInput(path, _field(place), shown(each), "finite numbers")
        level = below
        if not level:
            return
    raise _too_deep(path)


def _check_text(path: str | os.PathLike, place: tuple, text: str) -> None:
    try:
        text.encode()
    except UnicodeEncodeError as error:
        raise BadInput(path, _field(place), f"half a character: {shown(text)}", "whole characters") from error


def _field(place: tuple) -> str:
    """Where a value stands, from names and numbers that are nested from the last one outwards."""
    names: list[str] = []
    while place:
        place, name = place
        names.insert(0, str(name))
    text = ", ".join(names)
    return (text if len(text) <= 80 and text.isprintable() else shown(text)) or "file"


def _too_deep(path: str | os.PathLike) -> BadInput:
    return BadInput(path, "file", f"objects or lists more than {DEEPEST} deep", f"{DEEPEST} at most")
