"""The answer of a verb, and the options that select its printed part, the same for all verbs.

The first line is the finding in a sentence; warnings and figures follow. --quiet prints the first line only, --verbose all
notes, --json the answer's object alone on standard output, with everything else on standard error.
"""

import argparse
import contextlib
import sys
import warnings
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from importlib.resources import files
from typing import Any, TextIO

from vpp_fmu.errors import RecordWarning, VppError
from vpp_fmu.structured import as_json

SCHEMAS = files("vpp_fmu.app.cli") / "schemas"
"""A JSON Schema for each verb's object, by the verb's name: `hil-run.json` for `vpp hil run`."""

LEVELS = {"json": False, "quiet": False, "verbose": False}
"""Defaults of the options of `add_levels`."""


@dataclass(frozen=True)
class Answer:
    """`text`: the finding in a sentence. `content`: the object of --json, as in the verb's JSON file; the
    sentence and the parts of the failure are added. `lines`: warnings and
    other important lines; `figures`: (label, value, note); `more`: lines for --verbose only; `written`: lines about the files.
    `failure`: an error that is reported after the answer."""

    text: str
    content: Mapping[str, Any]
    lines: Sequence[str] = ()
    figures: Sequence[tuple[str, str, str]] = ()
    more: Sequence[str] = ()
    written: Sequence[str] = ()
    failure: VppError | None = None

    def printed(self, options: argparse.Namespace) -> Iterator[str]:
        """The lines for standard output."""
        if options.json:
            why = {"error": self.failure.parts} if self.failure else {}
            yield as_json({"sentence": self.text, **self.content, **why}).rstrip("\n")
            return
        yield self.text
        if options.quiet:
            return
        yield from self.lines
        for label, value, note in self.figures:
            yield f"{label}: {value}" + (f" ({note})" if note and options.verbose else "")
        yield from self.more if options.verbose else ()
        yield from self.written


def add_levels(parser, answers: bool) -> None:
    """Add the options that select what is printed. `answers`: whether the verb has an object to print."""
    if answers:
        parser.add_argument("--json", **_flag("print one JSON object and nothing else on standard output"))
    either = parser.add_mutually_exclusive_group()
    either.add_argument("--quiet", **_flag("print the answer and errors only: no progress, no figures, no hints"))
    either.add_argument("--verbose", **_flag("print all figures with their notes"))


def _flag(text: str) -> dict[str, Any]:
    return {"action": "store_true", "default": argparse.SUPPRESS, "help": text}  # else a sub-verb's parser would reset it


def say(options: argparse.Namespace, text: str) -> None:
    """Print a line about the work on standard error; not with --quiet."""
    if not options.quiet:
        print(text, file=sys.stderr, flush=True)


class Lines(list[str]):
    """Lines about long work: shown on standard error as they come if that is a terminal, else kept for the answer."""

    def __init__(self, options: argparse.Namespace):
        super().__init__()
        self._options, self._live = options, sys.stderr.isatty()

    def __call__(self, text: str) -> None:
        if self._live:
            say(self._options, text)
        else:
            self.append(text)

    def __enter__(self) -> "Lines":
        return self

    def __exit__(self, kind: type | None, *_: object) -> None:
        """After an error the answer is not printed, but the lines are."""
        if kind is not None and not self._options.quiet:
            print(*self, sep="\n", end="\n" * bool(self))


@contextlib.contextmanager
def level(options: argparse.Namespace) -> Iterator[None]:
    """A context in which --json reserves standard output for the answer, and --quiet hides progress."""
    with contextlib.ExitStack() as stack:
        if options.json:
            stack.enter_context(contextlib.redirect_stdout(sys.stderr))
        if options.quiet:
            warnings.simplefilter("ignore", RecordWarning)
            stack.enter_context(contextlib.redirect_stderr(_NoTerminal(sys.stderr)))
        yield


class _NoTerminal:
    """A stream that is not a terminal for progress bars, which then print nothing."""

    def __init__(self, stream: TextIO):
        self._stream = stream

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    def isatty(self) -> bool:
        return False
