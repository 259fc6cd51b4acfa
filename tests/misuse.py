"""A table of calls out of order or with bad arguments, and the required answer of both flavours.

python tests/misuse.py FMU... prints a line of JSON for each case, from a process that may crash

The required answers are those of the standard (FMI 2.0.4, sections 2.1.3, 2.1.7 and 4.2.4). A refusal is fmi2Error from the
native flavour and fmi2Fatal from the Python one, since pythonfmu's binary has no other answer to an exception. In both the
instance must survive: its values can be read and are finite, and a reset makes a fresh one. The table omits what pythonfmu's
binary answers without asking the slave: null pointers and callbacks (it reads them), a wrong GUID (it accepts any), set-up at
the wrong time (it stores the start time for later), unknown log categories, derivatives and pending steps (fmi2Error, as
natively).
"""

import ctypes
import json
import re
import subprocess
import sys
import tempfile
import zipfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from math import isfinite
from pathlib import Path
from xml.etree import ElementTree

NAN, INF = float("nan"), float("inf")
TAKEN, REFUSED = "taken", "refused"
OUTCOMES = {0: TAKEN, 3: REFUSED, 4: REFUSED}


class Host:
    """The calls on one instance, as an importer in C makes them."""

    LOGGER = ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_char_p, ctypes.c_int, ctypes.c_char_p, ctypes.c_char_p)

    def __init__(self, folder: Path, library: Path | None = None, logging: int = 1):
        root = ElementTree.parse(folder / "modelDescription.xml").getroot()
        name, self.guid = root.find("CoSimulation").get("modelIdentifier"), root.get("guid").encode()
        self.vr = {v.get("name"): int(v.get("valueReference")) for v in root.iter("ScalarVariable")}
        self.reals = [v.get("name") for v in root.iter("ScalarVariable") if v.find("Real") is not None]
        self.library = ctypes.CDLL(str(library or folder / "binaries" / "linux64" / f"{name}.so"))
        self.library.fmi2Instantiate.restype = ctypes.c_void_p
        self.said: list[tuple[int, str, str]] = []  # status, category, text
        self._log = self.LOGGER(
            lambda _env, _name, *said: self.said.append((said[0], *((x or b"").decode() for x in said[1:])))
        )
        allocate, free = (ctypes.cast(getattr(ctypes.CDLL(None), f), ctypes.c_void_p).value for f in ("calloc", "free"))
        logger = ctypes.cast(self._log, ctypes.c_void_p).value
        self.callbacks, self.logging = (ctypes.c_void_p * 5)(logger, allocate, free), logging
        self.resources = (folder / "resources").as_uri().encode()
        self.instance = self.instantiate()
        self.states: dict[str, ctypes.c_void_p] = {}

    def instantiate(self, name=b"a", kind=1, guid=None, callbacks=True) -> ctypes.c_void_p:
        given = self.callbacks if callbacks else None
        return ctypes.c_void_p(
            self.library.fmi2Instantiate(name, kind, guid or self.guid, self.resources, given, 0, self.logging)
        )

    def call(self, name: str, *arguments) -> int:
        return getattr(self.library, f"fmi2{name}")(self.instance, *arguments)

    def setup(self, time=0.0):
        return self.call("SetupExperiment", 0, ctypes.c_double(0.0), ctypes.c_double(time), 0, ctypes.c_double(0.0))

    def enter(self):
        return self.call("EnterInitializationMode")

    def leave(self):
        return self.call("ExitInitializationMode")

    def terminate(self):
        return self.call("Terminate")

    def reset(self):
        return self.call("Reset")

    def free(self):
        self.library.fmi2FreeInstance(self.instance)

    def step(self, time=0.0, size=0.004):
        return self.call("DoStep", ctypes.c_double(time), ctypes.c_double(size), 1)

    def get(self, kind, *names):
        values = ({"Real": ctypes.c_double, "String": ctypes.c_char_p}.get(kind, ctypes.c_int) * len(names))()
        status = self.call(f"Get{kind}", self._references(names), ctypes.c_size_t(len(names)), values)
        self.got = list(values)
        return status

    def set(self, kind, *values, **named):
        pairs = [*values, *named.items()]
        c_type, convert = {"Real": (ctypes.c_double, float), "String": (ctypes.c_char_p, str.encode)}.get(
            kind, (ctypes.c_int, int)
        )
        array = (c_type * len(pairs))(*(convert(value) for _, value in pairs))
        return self.call(f"Set{kind}", self._references([n for n, _ in pairs]), ctypes.c_size_t(len(pairs)), array)

    def log(self, on, *categories):
        array = (ctypes.c_char_p * len(categories))(*(c.encode() for c in categories))
        return self.call("SetDebugLogging", on, ctypes.c_size_t(len(categories)), array)

    def keep(self, name="kept"):
        self.states[name] = ctypes.c_void_p()
        return self.call("GetFMUstate", ctypes.byref(self.states[name]))

    def back(self, name="kept"):
        return self.call("SetFMUstate", self.states[name])

    def through_bytes(self, change: Callable[[bytes], bytes] = bytes):
        """Serialise the kept state, change the bytes, and deserialise them."""
        size = ctypes.c_size_t()
        self.call("SerializedFMUstateSize", self.states["kept"], ctypes.byref(size))
        data = (ctypes.c_char * size.value)()
        self.call("SerializeFMUstate", self.states["kept"], data, size)
        changed = change(bytes(data))
        self.states["read"] = ctypes.c_void_p()
        return self.call("DeSerializeFMUstate", changed, ctypes.c_size_t(len(changed)), ctypes.byref(self.states["read"]))

    def _references(self, names):
        return (ctypes.c_uint * len(names))(*(self.vr.get(n, n) for n in names))


@dataclass(frozen=True)
class Case:
    """`way`: calls that must be accepted first. `call`: the call under test, on `fmu`. `words`: words of the refusal, none if
    it is accepted."""

    name: str
    way: Sequence[Callable[[Host], int]]
    call: Callable[[Host], int]
    words: str = ""
    fmu: str = "plain"

    @property
    def outcome(self) -> str:
        """The required answer."""
        return REFUSED if self.words else TAKEN


def _set(kind: str = "Real", *values, **named) -> Callable[[Host], int]:
    return lambda h: h.set(kind, *values, **named)


def _get(kind: str, *names) -> Callable[[Host], int]:
    return lambda h: h.get(kind, *names)


def _step(time: float = 0.0, size: float = 0.004) -> Callable[[Host], int]:
    return lambda h: h.step(time, size)


def _changed(change: Callable[[bytes], bytes]) -> Callable[[Host], int]:
    return lambda h: h.through_bytes(change)


SETUP, ENTER, LEAVE, STEP, TERMINATE, RESET = Host.setup, Host.enter, Host.leave, Host.step, Host.terminate, Host.reset
KEEP, BACK, FAIL = Host.keep, Host.back, lambda h: not h.step(777.0)
INIT = (SETUP, ENTER)
RUN = (SETUP, ENTER, LEAVE)
ENDED = (*RUN, TERMINATE)
STATE, C20 = _set("Real", ("state.omega_inner", 1.0)), _set(c20=0.3)
FLIP = _changed(lambda b: b[:60] + bytes([b[60] ^ 1]) + b[61:])
LATE = "found a value after initialisation, expected it before: it is"
READ, WRITE, TOO_FAST = _get("Real", "thrust"), _set(omega_ref=1000.0), _set(omega_ref=1e300)
NOT = "found a call"

CASES = (
    # the order of calls
    Case("step before the initialisation", (), STEP, f"fmi2DoStep: {NOT} before the initialization mode"),
    Case("step in the initialisation", INIT, STEP, f"fmi2DoStep: {NOT} in initialization mode"),
    Case("step after the end", ENDED, STEP, f"fmi2DoStep: {NOT} after it was terminated"),
    Case("read before the initialisation", (), READ, f"fmi2GetReal: {NOT} before the initialization mode"),
    Case("read in the initialisation", INIT, READ),
    Case("read after the end", ENDED, READ),
    Case("write before the initialisation", (), WRITE),
    Case("write after the end", ENDED, WRITE, f"fmi2SetReal: {NOT} after it was terminated"),
    Case("enter twice", INIT, ENTER, f"fmi2EnterInitializationMode: {NOT} in initialization mode"),
    Case("enter without set-up", (), ENTER),
    Case("leave before entering", (SETUP,), LEAVE, f"fmi2ExitInitializationMode: {NOT} before"),
    Case("leave twice", RUN, LEAVE, f"fmi2ExitInitializationMode: {NOT} after the initialization mode"),
    Case("terminate before the initialisation", (), TERMINATE, f"fmi2Terminate: {NOT} before"),
    Case("terminate twice", ENDED, TERMINATE, f"fmi2Terminate: {NOT} after it was terminated"),
    Case("reset before the initialisation", (), RESET),
    Case("reset after the end", ENDED, RESET),
    Case("start again after a reset", (*ENDED, RESET, *RUN), STEP),
    Case("booleans before the initialisation", (), _get("Boolean", "speed_only"), NOT, "controller"),
    Case("integers after the end", ENDED, _set("Integer"), f"fmi2SetInteger: {NOT}"),
    Case("keep a state before the initialisation", (), KEEP),
    Case("logging before the initialisation", (), lambda h: h.log(1)),
    # what is set
    Case("NaN as an input", RUN, _set(omega_ref=NAN), "omega_ref: found nan"),
    Case("set an output", INIT, _set(thrust=1.0), "VppPlant: thrust: found a value, expected none: it is computed"),
    Case("set a state while running", RUN, STATE, f"state.omega_inner: {LATE} computed"),
    Case("set a state before", (), STATE),
    Case("set a fixed parameter while running", RUN, C20, f"c20: {LATE} fixed"),
    Case("set a parameter before", (), C20),
    Case("tune a gain while running", RUN, _set(kp_omega=2.0), fmu="controller"),
    Case("tune a gain out of range", RUN, _set(kp_omega=-1.0), "expected 0.0 to 10000.0", "controller"),
    Case("switch while running", RUN, _set("Boolean", speed_only=1), fmu="controller"),
    Case("a switch as a number", RUN, _set(speed_only=1.0), "found speed_only of type Boolean", "controller"),
    Case("a number as a switch", RUN, _set("Boolean", omega_ref=1), "found omega_ref of type Real"),
    Case("a number as an integer", RUN, _get("Integer", "thrust"), "found thrust of type Real"),
    Case("text for a number", INIT, _set("String", omega_ref="fast"), "found omega_ref of type Real"),
    Case("no variables at all", RUN, _get("Real")),
    Case("read an unknown reference", RUN, _get("Real", 999), "value reference: found 999, expected 0 to"),
    Case("read the largest reference", RUN, _get("Real", 2**32 - 1), "value reference: found 4294967295"),
    Case("a parameter out of range", (*INIT, _set(tau_omega_1=35.0)), LEAVE, "omega_1: found 35.0 s"),
    # steps
    Case("no step", RUN, _step(0.0, 0.0), "communication step: found 0.0 s, expected a positive number"),
    Case("NaN as a step", RUN, _step(0.0, NAN), "communication step: found nan s"),
    Case("a step of 30 years", RUN, _step(0.0, 1e9), "expected up to 100.0 s", "all_on"),
    Case("a controller's step of 30 years", RUN, _step(0.0, 1e9), "expected up to 400.0 s", "controller"),
    Case("a step at another time", RUN, _step(777.0), "found 777.0 s, expected the instance's time, 0.0 s"),
    Case("a step at no time", RUN, _step(NAN), "start of the step: found nan s"),
    Case("the same step again", (*RUN, STEP), STEP, "found 0.0 s, expected the instance's time, 0.004 s"),
    Case("the next step", (*RUN, STEP), _step(0.004)),
    Case("the next step, a rounding off", (*RUN, STEP), _step(0.004 + 1e-9)),
    Case("a start at another time", (lambda h: h.setup(10.0), ENTER, LEAVE), _step(10.0)),
    Case("no numbers come out", (*RUN, TOO_FAST), STEP, "found no finite numbers from omega_ref = 1e+300"),
    Case("no numbers at the start", (*INIT, TOO_FAST), LEAVE, "found no finite numbers from"),
    # after an error
    Case("step after an error", (*RUN, FAIL), STEP, f"{NOT} after an error (a reset or a saved state mends it)"),
    Case("write after an error", (*RUN, FAIL), WRITE, f"{NOT} after an error"),
    Case("read after an error", (*RUN, FAIL), READ),
    Case("reset after an error", (*RUN, FAIL), RESET),
    Case("a saved state after an error", (*RUN, KEEP, FAIL, BACK), STEP),
    # states
    Case("a saved state goes back in time", (*RUN, KEEP, STEP, BACK), STEP),
    Case("a state through bytes", (*RUN, KEEP), Host.through_bytes),
    Case("a flipped bit in a state", (*RUN, KEEP), FLIP, "bytes that hold none"),
    Case("half a state", (*RUN, KEEP), _changed(lambda b: b[: len(b) // 2]), "expected a serialised state"),
    # logging
    Case("an unknown category", RUN, lambda h: h.log(1, "logEverything")),
)


def run(case: Case, folder: Path) -> dict:
    """The result of a case, and whether the instance survived."""
    host = Host(folder)
    problem = next((f"call {i} on the way was refused" for i, call in enumerate(case.way) if call(host)), "")
    host.said.clear()
    status = case.call(host)
    said = host.said[-1][2].strip().splitlines()[-1] if host.said else ""
    lost = [] if host.get("Real", *host.reals) else [n for n, x in zip(host.reals, host.got, strict=True) if not isfinite(x)]
    first = _set("Real", (0, 1.0)), STEP, _get("Real", 2)  # an input, an output
    restarted = [call(host) for call in (RESET, *RUN, *first, TERMINATE)]
    host.free()
    lived = not problem and not any(restarted) and all(map(isfinite, host.got))
    if lost:
        problem = f"afterwards no number is read of {', '.join(lost)}"
    said = re.sub(r"\d+ bytes", "these bytes", said) if status else ""
    return {"case": case.name, "status": status, "said": said, "lived": lived, "problem": problem}


def outcomes(fmus: Mapping[str, Path]) -> list[dict]:
    """Results of all cases on FMUs by name, in order; fewer than CASES if the process crashed."""
    named = [f"{name}={path}" for name, path in fmus.items()]
    done = subprocess.run([sys.executable, __file__, *named], check=False, capture_output=True, text=True)
    return [json.loads(line) for line in done.stdout.splitlines()]


def verdict(case: Case, native: dict, python: dict) -> str:
    """What is wrong with the two results of a case; empty if nothing."""
    for flavour, found in (("native", native), ("python", python)):
        if found["problem"]:
            return f"{flavour}: {found['problem']}"
        if OUTCOMES.get(found["status"]) != case.outcome:
            return f"{flavour}: status {found['status']} instead of {case.outcome}"
        if case.words not in found["said"]:
            return f"{flavour}: said {found['said']!r} instead of {case.words!r}"
        if not found["lived"]:
            return f"{flavour}: the instance is lost"
    return "" if native["said"] == python["said"] else f"said {native['said']!r} and {python['said']!r}"


def main(fmus: Sequence[str]) -> None:
    """Run each case on its FMU among `name=path`."""
    with tempfile.TemporaryDirectory() as work:
        folders = {}
        for name, path in (text.split("=", 1) for text in fmus):
            folders[name] = Path(work, name)
            with zipfile.ZipFile(path) as packed:
                packed.extractall(folders[name])
        for case in CASES:
            print(json.dumps(run(case, folders[case.fmu])), flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
