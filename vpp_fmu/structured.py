"""Read JSON and TOML files with bounded size and depth, unique names and finite numbers. All else raises BadInput."""

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
"""Maximum nesting of objects and lists. Files of this project have at most 8."""

LARGEST_JSON = 20 * 2**20
"""Maximum number of characters. An identification.json has some 100 000."""

LARGEST_TOML = 128 * 2**10
LONGEST_LINE = 4096
"""Maximum number of characters of a TOML line: reading time is quadratic in the parts of a dotted key."""

GREATEST = 1e300

LONGEST_NUMBER = 400
"""Maximum digits of whole numbers: Python's reading time is quadratic in them."""


def read_json(path: str | os.PathLike, allowed: str = "JSON") -> object:
    """The content of a JSON file. BadInput; `allowed`: the expected content, in words."""

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
    """The object in a JSON file, of the format `form` if given. BadInput."""
    found = read_json(path, allowed)
    if not isinstance(found, dict):
        raise BadInput(path, "file", shown(found), "an object in braces { }")
    if form is not None and found.get("format") != form:
        raise BadInput(path, "format", shown(found.get("format")), json.dumps(form))
    return found


def read_toml(path: str | os.PathLike, allowed: str = "TOML") -> dict:
    """The content of a TOML file. BadInput; `allowed`: the expected content, in words."""
    text = _text(path, LARGEST_TOML, allowed)
    longest, line = max((len(line), k) for k, line in enumerate(text.split("\n"), 1))
    if longest > LONGEST_LINE:
        raise BadInput(path, f"line {line}", f"{longest} characters", f"{LONGEST_LINE} at most")
    try:
        found = tomllib.loads(text)
    except RecursionError as error:
        raise _too_deep(path) from error
    except ValueError as error:  # an invalid number or date raises a plain ValueError
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
    """BadInput if a part of a file's content is missing or of another type.

    `kinds`: a type; `[kinds]` for a list; `{name: kinds}` for an object, in which names that end in "?" may be
    missing or null and "*" is every name.
    """
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
    """JSON text. Unknown numbers must be None already: NaN is a programming error."""
    return json.dumps(content, indent=2, allow_nan=False, ensure_ascii=False) + "\n"


def shown(found: object) -> str:
    """A value for a message: on one line, shortened."""
    text = json.dumps(found, default=str)
    return text if len(text) <= 60 else f"{text[:57]}..."


def _text(path: str | os.PathLike, most: int, allowed: str) -> str:
    text = read_text(path)
    if len(text) > most:
        raise BadInput(path, "file", f"{len(text)} characters", f"{most} at most, {allowed}")
    return text


def _check(path: str | os.PathLike, content: object) -> None:
    """BadInput if the nesting is too deep, a number is not finite, or a text holds half a surrogate pair."""
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
    """Path of a value, from nested names and numbers, the innermost first."""
    names: list[str] = []
    while place:
        place, name = place
        names.insert(0, str(name))
    text = ", ".join(names)
    return (text if len(text) <= 80 and text.isprintable() else shown(text)) or "file"


def _too_deep(path: str | os.PathLike) -> BadInput:
    return BadInput(path, "file", f"objects or lists more than {DEEPEST} deep", f"{DEEPEST} at most")
