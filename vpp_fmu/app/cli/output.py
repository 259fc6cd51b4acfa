"""Output common to all verbs: the folder, the provenance of results, progress, and the written files."""

import argparse
import contextlib
import os
import sys
import time
from collections.abc import Callable, Iterator
from inspect import signature

from tqdm import tqdm

from vpp_fmu.app.cli.answer import Answer
from vpp_fmu.app.cli.next_command import next_step
from vpp_fmu.app.report.result import Result
from vpp_fmu.errors import ARGUMENT, BadInput
from vpp_fmu.files import OutputFolder
from vpp_fmu.outputs import OutputSet


def called(verb: Callable, options: argparse.Namespace, **more):
    """The result of a verb's function on the options that are named as its arguments. BadInput names the option."""
    given = {name: value for name, value in vars(options).items() if name in signature(verb).parameters}
    try:
        return verb(**given | more)
    except BadInput as error:
        if error.where != ARGUMENT:
            raise
        option = f"--{error.field.replace('_', '-', error.field.partition(' ')[0].count('_'))}"
        raise BadInput("command line", option, error.found, error.allowed, error.hint) from error


@contextlib.contextmanager
def output(options: argparse.Namespace, kind: str = "") -> Iterator[OutputSet | None]:
    """The folder of the verb's files, None if none is named; `kind`: of which files. It is checked before the work; without a
    result none is left."""
    if options.output is None:
        yield None
        return
    there = os.path.lexists(options.output)
    try:
        yield OutputSet(options.output, options.verb + kind)
    except BaseException:
        if not there:
            with contextlib.suppress(OSError):  # not empty
                os.rmdir(options.output)
        raise


def answer(options: argparse.Namespace, verb: Callable, **more) -> Answer:
    """Call a verb's function by `called`, and write the files of its `Result`."""
    with output(options) as folder:
        return answered(options, folder, called(verb, options, **more))


def answered(options: argparse.Namespace, folder: OutputFolder | None, found: Result) -> Answer:
    """Write the files of a result, if there is a folder; returns the answer."""
    place = []
    if folder is not None:
        found.write(folder)
        place = written(options, folder, found.identity)
    figures, more = found.key_figures(), found.details()
    return Answer(found.headline(), found.to_dict(), found.lines(), figures, more, place, found.failure)


@contextlib.contextmanager
def stages(verb: str, quiet: bool = False) -> Iterator["Stages"]:
    """Progress by stage: on a terminal a bar of the present stage, in a pipe a line per stage on standard error."""
    if sys.stderr.isatty():
        with tqdm(leave=False, bar_format="{elapsed}") as bar:
            yield Stages(verb, bar)
    else:
        yield Stages(verb, None, quiet)


class Stages:
    """Call it with the name of a stage that begins; `progress` shows how far the stage is, and the best candidate so far."""

    def __init__(self, verb: str, bar: tqdm | None, quiet: bool = False):
        self._verb, self._bar, self._quiet, self._began = verb, bar, quiet, time.monotonic()

    def __call__(self, text: str) -> None:
        if self._bar is not None:
            self._bar.bar_format = "{desc}{elapsed}"
            self._bar.set_description(text)
        elif not self._quiet:
            print(f"{self._verb}: {text} ({time.monotonic() - self._began:.0f} s)", file=sys.stderr, flush=True)

    def progress(self, done: int, total: int, best: str) -> None:
        """On a terminal, show that `done` of `total` candidates are done, and the best one."""
        if self._bar is None:
            return
        if done == 1:  # the time left is that of the stage
            self._bar.reset(total)
            self._bar.bar_format = "{desc}{n}/{total}, {remaining} left{postfix}"
        self._bar.n = done
        self._bar.set_postfix_str(f"best so far: {best}")


def written(options: argparse.Namespace, folder: OutputFolder, identity: str | None = None) -> list[str]:
    """Put a set of files into its place; returns lines about the written, replaced and removed files, and the next command.
    `identity`: of the results' parameters. Files are in place before anything is printed, since standard output may fail."""
    lines = []
    if isinstance(folder, OutputSet):
        folder.finish(identity)
        notes = {"removed, of an earlier run": folder.removed, "kept, changed since an earlier run wrote it": folder.kept}
        notes["made of other parameters"] = [f"{name} (vpp {verb})" for name, verb in folder.others.items()]
        lines += [f"in {folder.path}, {what}: {', '.join(names)}" for what, names in notes.items() if names]
    if folder.replaced:
        lines.append(f"replaced in {folder.path}: {', '.join(folder.replaced)}")
    return [*lines, f"written to {folder.path}", f"next: {next_step(folder.path, folder.names, options)[0]}"]
