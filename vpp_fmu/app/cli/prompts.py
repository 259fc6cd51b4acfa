"""Questions to the operator at the rig; the answers are typed, or lines of a file."""

import sys
from collections.abc import Callable, Sequence
from typing import TypeVar

from vpp_fmu.app.cli.options import shortened
from vpp_fmu.errors import BadInput
from vpp_fmu.files import read_text

Answer = TypeVar("Answer")


class Prompts:
    """Asks, and waits for an answer. On a terminal a wrong answer is asked for again; otherwise BadInput names its line.

    `path`: a file of answers, one per line; lines that begin with `#` are ignored (None: standard input).
    """

    def __init__(self, path: str | None):
        self._source, self._line, self._again = path or "standard input", 0, path is None and sys.stdin.isatty()
        self._lines = iter(sys.stdin if path is None else read_text(path).splitlines())

    def do(self, what: str) -> None:
        """Wait until an action is done, confirmed by Enter."""
        self._asked(f"{what}, then Enter", self._nothing, "an empty line")

    def read(self, what: str) -> float:
        return self._asked(what, float, "a number")

    def choice(self, what: str, words: Sequence[str]) -> str:
        shown = "/".join(words)
        return self._asked(f"{what}: type {shown}", lambda text: words[words.index(text)], " or ".join(words))

    def numbers(
        self, what: str, default: Sequence[float], good: Callable[[Sequence[float]], bool], allowed: str
    ) -> tuple[float, ...]:
        """Ask for numbers separated by spaces; Enter for the default."""

        def read(text: str) -> tuple[float, ...]:
            found = tuple(map(float, text.split())) or tuple(default)
            if not good(found):
                raise ValueError
            return found

        return self._asked(f"{what} (Enter: {' '.join(f'{value:g}' for value in default)})", read, allowed)

    @staticmethod
    def _nothing(text: str) -> None:
        if text:
            raise ValueError

    def _asked(self, question: str, read: Callable[[str], Answer], allowed: str) -> Answer:
        while True:
            print(f"{question}: ", end="", flush=True)
            text = self._next(question)
            try:
                return read(text)
            except ValueError as error:
                if not self._again:
                    raise BadInput(self._source, f"line {self._line}, {question}", shortened(text), allowed) from error
                print(f"found {shortened(text)}, expected {allowed}")

    def _next(self, question: str) -> str:
        for line in self._lines:
            self._line += 1
            if not line.lstrip().startswith("#"):
                if not self._again:
                    print(line.strip())
                return line.strip()
        raise BadInput(self._source, question, "the end of the input", "an answer")
