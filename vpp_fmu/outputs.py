"""The files that one run of a verb writes: a set that replaces the previous one completely, or not at all.

A folder holds one model, so the files of all verbs that write a parameters.json are one set. A new run removes files of an
earlier run that it does not write itself. Files that other verbs made from the parameters (gains, FMUs) stay; a message names
them if they were made from other parameters. A file is removed only if a verb wrote it and it is unchanged. A hidden file in
the folder therefore records the verb, the parameters and the hash of each file. Verbs without parameters (compare, import)
always write the same names and are not recorded.
"""

import hashlib
import json
import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from vpp_fmu.errors import BadInput
from vpp_fmu.files import OutputFolder, as_bytes, holds_other, reason, write_whole
from vpp_fmu.scratch import Scratch
from vpp_fmu.stopping import unbroken
from vpp_fmu.structured import read_object

WRITTEN = ".vpp-written.json"
FORMAT = "vpp-written/1"

MODEL_VERBS = ("identify", "diagnose", "demo")
"""Verbs that write a parameters.json."""


@dataclass(frozen=True)
class _Entry:
    """The verb that wrote a file, the hash of its content, and the identity of the parameters that it is made from."""

    by: str
    sha256: str
    parameters: str


class OutputSet(OutputFolder):
    """The folder that one run of `verb` writes to: as `OutputFolder`, but the files appear in it at `finish` only.

    After `finish`: `removed`, names of an earlier run's files that are deleted; `kept`, those that the user has changed;
    `others`, files of other verbs that were made from other parameters, with the verb.
    """

    def __init__(self, path: str | os.PathLike, verb: str):
        super().__init__(path)
        self._verb, self._scratch, self._hashes = verb, None, {}
        self.removed: tuple[str, ...] = ()
        self.kept: tuple[str, ...] = ()
        self.others: Mapping[str, str] = {}

    def write(self, name: str, data: str | bytes) -> Path:
        """Write the file `name` to a temporary folder; returns its path there until `finish`. BadInput."""
        self._scratch = self._scratch or self._beside()
        content = as_bytes(data)
        write_whole(self._scratch.path / name, content, self.path / name)
        self._hashes[name] = _hash(content)
        self._others[name] = holds_other(self.path / name, content)
        return self._scratch.path / name

    def finish(self, identity: str | None = None) -> None:
        """Put the files into their places. `identity`: of the parameters that they are made from (`ParameterSet.identity`)."""
        for name in self._hashes:
            if (self.path / name).is_dir():
                raise BadInput(self.path / name, "output file", "not writable (is a directory)", "a file that can be written")
        made, new = _read(self.path), self._hashes
        old = {name: entry for name, entry in made.items() if name not in new and os.path.lexists(self.path / name)}
        stale = [name for name, entry in old.items() if _set(entry.by) == _set(self._verb)]
        self.kept = tuple(name for name in stale if _hash_of(self.path / name) != old[name].sha256)
        self.removed = tuple(name for name in stale if name not in self.kept)
        rest = {name: entry for name, entry in old.items() if name not in stale}
        if identity is not None:
            models = {name: entry for name, entry in rest.items() if "--model" not in entry.by + self._verb}  # of our own
            self.others = {name: entry.by for name, entry in models.items() if entry.parameters != identity}
            rest |= {name: _Entry(self._verb, sha256, identity) for name, sha256 in new.items()}
        if rest or made:
            entries = {name: vars(entry) for name, entry in sorted(rest.items())}
            self.write(WRITTEN, json.dumps({"format": FORMAT, "files": entries}, indent=2) + "\n")
            del self._others[WRITTEN]
        with unbroken():
            self._put()
        if self._scratch:
            self._scratch.close()

    def _put(self) -> None:
        try:
            for name in self._hashes:
                os.replace(self._scratch.path / name, self.path / name)
            for name in self.removed:
                (self.path / name).unlink()
        except OSError as error:
            allowed = "a file that can be written"
            raise BadInput(self.path / name, "output file", f"not writable ({reason(error)})", allowed) from error

    def _beside(self) -> Scratch:
        try:
            return Scratch(self.path)
        except OSError as error:
            raise self._refused(f"not writable ({reason(error)})") from error


def _set(verb: str) -> str:
    return "model" if verb in MODEL_VERBS else verb


def _hash(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()


def _hash_of(path: Path) -> str | None:
    try:
        return _hash(path.read_bytes())
    except OSError:
        return None


def _read(folder: Path) -> dict[str, _Entry]:
    """The entries of a folder by file name; empty if there is no record, or an invalid one."""
    try:
        content = read_object(folder / WRITTEN, FORMAT)
        entries = {name: _Entry(e["by"], e["sha256"], e["parameters"]) for name, e in content["files"].items()}
    except (BadInput, KeyError, TypeError, AttributeError):
        return {}
    return {name: entry for name, entry in entries.items() if Path(name).name == name}  # nothing outside of the folder
