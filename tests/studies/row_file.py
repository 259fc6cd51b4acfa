"""Rows of a study in a file, a line of JSON each, so that an interrupted study continues where it stopped."""

import json
from collections.abc import Iterable, Iterator
from pathlib import Path


def read(path: Path) -> list[dict]:
    """The rows of a file; none if it does not exist."""
    return [json.loads(line) for line in path.read_text().splitlines()] if path.exists() else []


def kept(path: Path, rows: Iterable[dict]) -> Iterator[dict]:
    """The rows, each added to the file as soon as it is there."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("a") as file:
        for row in rows:
            file.write(json.dumps(row) + "\n")
            file.flush()
            yield row
