"""The command `vpp`: one verb per file, each a call of the library."""

import argparse
import importlib
import io
import os
import re
import sys
import warnings
from importlib.metadata import entry_points
from pathlib import Path
from typing import TextIO

from vpp_fmu import __version__
from vpp_fmu.app.cli.answer import LEVELS, SCHEMAS, add_levels, level
from vpp_fmu.errors import BadInput, RecordWarning, VppError, near
from vpp_fmu.files import reason
from vpp_fmu.stopping import Stopped, said, stoppable
from vpp_fmu.structured import as_json

VERBS = {
    "demo": "all steps on the campaign that ships with the project",
    "check": "check a campaign: its files, missing data and quality problems",
    "identify": "identify parameters from a campaign",
    "diagnose": "find effects that the model lacks, and add them",
    "allocate": "the pair of speed and pitch of least power for each thrust",
    "tune": "tune controller gains for a model",
    "learn": "learn a control law on plants drawn from the parameters' uncertainty",
    "export": "export parameters as FMUs",
    "cosim": "the closed loop of two FMUs",
    "simulate": "the open-loop response to a record",
    "compare": "compare two records",
    "plan": "plan the next experiment: commands, and the expected accuracy",
    "import": "convert a log to a file of a campaign",
    "effects": "the effects that the model may have, and a page of their theory",
    "check-effect": "check a user-defined effect",
    "twin": "a rig's day: model and controller improve each other, round by round",
    "completion": "a script with which bash, zsh or fish completes verbs and options",
    "cache": "show or delete the cached compiled models",
    "hil": "the loop with the rig, emulated or real, in the plant's place",
}

GROUP = "vpp.verbs"
"""Group of entry points of installed packages: each names a verb, and a module with `configure(parser)`, `run(options)`,
EXAMPLE and a docstring, as in this folder. `run` returns an `Answer`, or None if it prints alone."""

READER_GONE = 141
"""Exit code if the reader of standard output has closed it: 128 + SIGPIPE, as of any other program in a pipe."""


class BadCall(VppError):
    """The command line is invalid. `said`: what argparse, or the type of an option, says of it; `hint`: what to type."""

    def __init__(self, program: str, said: str, hint: str):
        super().__init__(f"{program}: {said} (see {hint})")
        self._said, self._hint = said, hint

    @property
    def parts(self) -> dict[str, str | None]:
        option = re.match(r"argument ([^:]+): ", self._said)
        said = self._said[option.end() :] if option else self._said
        found = re.fullmatch(r"found (.*), expected (.*)", said, re.DOTALL)
        what, expected = found.groups() if found else (said, None)
        field = option and option[1]
        return {"file": "command line", "field": field, "found": what, "expected": expected, "try": self._hint}


class Parser(argparse.ArgumentParser):
    """A parser with messages of one line. Options cannot be abbreviated, since a later option may begin in the same way."""

    answers = True

    def __init__(self, *args, **kwargs):
        super().__init__(*args, allow_abbrev=False, **kwargs)
        add_levels(self, self.answers)

    def parse_known_args(self, args=None, namespace=None):
        known = {name for action in self._actions for name in action.option_strings}
        if self._subparsers is None:  # else they may be options of a sub-verb's parser
            for word in args:  # before argparse reports a misspelt option as missing
                option = word.partition("=")[0]
                if option.startswith("--") and option not in {*known, "--"} and (hint := near(option, known)):
                    self.error(f"unrecognized arguments: {word}{hint}")
        return super().parse_known_args(args, namespace)

    def _check_value(self, action, value):
        if action.choices is not None and value not in action.choices and (hint := near(str(value), map(str, action.choices))):
            raise argparse.ArgumentError(action, f"invalid choice: {value!r}{hint}")
        super()._check_value(action, value)

    def error(self, message):
        raise BadCall(self.prog, message, f"{self.prog} --help")


class SilentParser(Parser):
    """The parser of a verb without an object for --json."""

    answers = False


def main(arguments: list[str] | None = None) -> int:
    """Run one verb; returns the exit code: 0; 2 for bad input, after one line on standard error and, with --json, an object on
    standard output; 128 plus the number of the signal that ended it."""
    _prepare_streams()
    arguments = sys.argv[1:] if arguments is None else arguments
    first = next((word for word in arguments if not word.startswith("-")), "")
    verb = f"vpp {first}" if first in known_verbs() else "vpp"
    try:
        with stoppable(verb), warnings.catch_warnings():
            warnings.simplefilter("always", RecordWarning)
            warnings.showwarning = _one_line
            failure = _run(arguments)
            sys.stdout.flush()  # a full disk or a closed pipe is reported here, not when the interpreter ends
        return _refused(verb, failure) if failure else 0
    except VppError as error:
        return _refused(verb, error, "--json" in arguments)  # the options may be what is refused
    except BrokenPipeError:
        _give_up(sys.stdout)
        return READER_GONE
    except OSError as error:  # errors that no reader or writer of a file has handled
        _give_up(sys.stdout)
        where, field = (error.filename, "file or folder") if error.filename else ("the system", "output")
        refused = BadInput(where, field, f"not usable ({reason(error)})", "what can be read and written")
        return _refused(verb, refused, "--json" in arguments)
    except Stopped as why:
        _complain(said(verb, why))
        return why.code


def _run(arguments: list[str]) -> VppError | None:
    """Run one verb and print its answer; returns the failure that it tells, if any."""
    verbs = known_verbs()
    listing = "\n".join(f"  {verb:13} {text}" for verb, text in verbs.items())
    parser = Parser("vpp", description="Rig data to FMUs.", formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.epilog = f"verbs:\n{listing}\n\nvpp VERB --help tells the rest"
    parser.add_argument("--version", action="version", version=f"vpp {__version__}")
    parser.add_argument("verb", choices=verbs, metavar="VERB")
    if not arguments:
        from vpp_fmu.app.cli.next_command import next_step  # noqa: PLC0415 it imports numpy, which --help does not need

        command, why = next_step(Path())
        raise BadCall("vpp", f"no verb. Next: {command} ({why})", "vpp --help")
    count = next((k for k, word in enumerate(arguments, 1) if not word.startswith("-")), len(arguments))
    verb = parser.parse_args(arguments[:count]).verb
    parser, module = parser_of(verb)
    options = parser.parse_args([*arguments[: count - 1], *arguments[count:]], argparse.Namespace(verb=verb, **LEVELS))
    with level(options):
        answer = module.run(options)
    if answer is None:
        return None
    for line in answer.printed(options):
        print(line)
    return answer.failure


def known_verbs() -> dict[str, str]:
    """A description of each verb, this project's first, then those of installed packages."""
    return {e.name: f"of {e.dist.name if e.dist else e.value}" for e in entry_points(group=GROUP)} | VERBS


def _module(verb: str):
    if verb in VERBS:
        return importlib.import_module(f"vpp_fmu.app.cli.{verb.replace('-', '_')}")
    (entry,) = [e for e in entry_points(group=GROUP) if e.name == verb][:1]
    try:
        module = entry.load()
    except Exception as error:  # a foreign package may raise any exception
        said = f"{type(error).__name__}: {error}".splitlines()[0]
        raise BadInput(f"entry point {verb} of {GROUP}", entry.value, said, "a module that can be imported") from error
    if missing := [name for name in ("configure", "run", "EXAMPLE") if not hasattr(module, name)]:
        raise BadInput(f"entry point {verb} of {GROUP}", entry.value, f"no {', '.join(missing)}", "configure, run and EXAMPLE")
    return module


def parser_of(verb: str):
    """(the parser of a verb's options, its module)."""
    module = _module(verb)
    answers = any(schema.name.startswith((f"{verb}.", f"{verb}-")) for schema in SCHEMAS.iterdir())
    parser = (Parser if answers else SilentParser)(
        f"vpp {verb}", description=module.__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.epilog = f"example:\n  {module.EXAMPLE}"
    module.configure(parser)
    return parser, module


def _prepare_streams() -> None:
    """Replace a closed stream by the null device; a stream that is not UTF-8 writes "?" for unknown characters."""
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        if getattr(sys, name) is None:  # in this order each gets its free descriptor, before a file takes it
            setattr(sys, name, open(os.devnull, mode, encoding="utf-8"))  # noqa: SIM115
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")


def _give_up(stream: TextIO) -> None:
    """Drop output that a stream refuses, because the interpreter would report the error again at its end."""
    try:
        stream.flush()
    except OSError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


def _refused(verb: str, error: VppError, as_object: bool = False) -> int:
    """Print an error, with its object on standard output if the verb has printed none; returns the exit code."""
    words = " ".join(str(error).split())  # they begin with the verb if no file is at fault
    line = words if isinstance(error, BadCall) or words.startswith((f"{verb}:", f"{verb} ")) else f"{verb}: {words}"
    if as_object:
        try:
            print(as_json({"format": "vpp-error/1", "sentence": line, "error": error.parts}), end="", flush=True)
        except OSError:
            _give_up(sys.stdout)
    _complain(line)
    return error.code


def _one_line(message, *_):
    _complain(f"vpp: note: {message}")


def _complain(line: str) -> None:
    """Print on standard error, if it is open."""
    try:
        print(line, file=sys.stderr, flush=True)
    except OSError:
        _give_up(sys.stderr)
