"""The entries of a JSON file, each checked when it is read; BadInput names a wrong one."""

import json
import os
from collections.abc import Iterable, Sequence
from typing import NamedTuple

from vpp_fmu.errors import BadInput
from vpp_fmu.structured import shown


class NumberEntry(NamedTuple):
    """Unit and range of a number, ends included. In the file it is {"value": x, "unit": u}."""

    unit: str
    lowest: float
    highest: float

    @property
    def allowed(self) -> str:
        return f"a number from {self.lowest:g} to {self.highest:g} {self.unit}"


class Entries:
    """An object of the file `path` with the keys `wanted`, and `optional` ones; `name` is its place in the file."""

    def __init__(self, path: str | os.PathLike, content: object, wanted: Iterable[str], optional=(), name: str = ""):
        self._path, self._name = path, name
        wanted, known = list(wanted), [*wanted, *optional]
        if not isinstance(content, dict):
            raise BadInput(path, name or "file", shown(content), "an object in braces { }")
        for key in wanted:
            if key not in content:
                raise self.wrong(key, "nothing", f"all of {', '.join(wanted)}")
        for key in content:
            if key not in known:
                raise self.wrong(shown(key), "an unknown field", ", ".join(known))
        self._content = content

    def wrong(self, key: str, found: object, allowed: str) -> BadInput:
        return BadInput(self._path, self._place(key), found, allowed)

    def choice(self, key: str, allowed: Sequence):
        """An entry that is one of `allowed`; 860.0 counts as 860."""
        found = self._content[key]
        if isinstance(found, bool) or found not in allowed:
            raise self.wrong(key, shown(found), " or ".join(json.dumps(one) for one in allowed))
        return allowed[allowed.index(found)]

    def number(self, key: str, number: NumberEntry) -> float:
        """A number with its unit."""
        entry = self._measured(key, "value", number)
        return _checked(entry, "value", entry._content["value"], number)

    def numbers(self, key: str, number: NumberEntry) -> tuple[float, ...]:
        """Numbers with their unit: {"values": [...], "unit": u}."""
        entry = self._measured(key, "values", number)
        values = entry._content["values"]
        if not isinstance(values, list):
            raise entry.wrong("values", shown(values), "a list of numbers")
        return tuple(_checked(entry, f"values, {k}", value, number) for k, value in enumerate(values, 1))

    def entries(self, key: str, wanted: Iterable[str]) -> "Entries":
        """An object within this one."""
        return Entries(self._path, self._content[key], wanted, name=self._place(key))

    def free(self, key: str) -> dict:
        """An object that may hold anything, or be missing."""
        found = self._content.get(key, {})
        if not isinstance(found, dict):
            raise self.wrong(key, shown(found), "an object in braces { }")
        return found

    def _measured(self, key: str, values: str, number: NumberEntry) -> "Entries":
        entry = self.entries(key, (values, "unit"))
        entry.choice("unit", (number.unit,))
        return entry

    def _place(self, key: str) -> str:
        return f"{self._name}, {key}" if self._name else key


def _checked(entry: Entries, key: str, value: object, number: NumberEntry) -> float:
    right = isinstance(value, int | float) and not isinstance(value, bool)
    if not right or not number.lowest <= value <= number.highest:
        raise entry.wrong(key, shown(value), number.allowed)
    return float(value)
