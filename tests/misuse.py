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

    def __init__(self, folder: Path):
        root = ElementTree.parse(folder / "modelDescription.xml").getroot()
        name = root.find("CoSimulation").get("modelIdentifier")
        self.vr = {v.get("name"): int(v.get("valueReference")) for v in root.iter("ScalarVariable")}
        self.reals = [v.get("name") for v in root.iter("ScalarVariable") if v.find("Real") is not None]
        self.library = ctypes.CDLL(str(folder / "binaries" / "linux64" / f"{name}.so"))
        self.said: list[str] = []
        self._log = self.LOGGER(lambda _env, _name, _status, _category, text: self.said.append(text.decode()))
        allocate, free = (ctypes.cast(getattr(ctypes.CDLL(None), f), ctypes.c_void_p).value for f in ("calloc", "free"))
        self.callbacks = (ctypes.c_void_p * 5)(ctypes.cast(self._log, ctypes.c_void_p).value, allocate, free)
        self.library.fmi2Instantiate.restype = ctypes.c_void_p
        where = (folder / "resources").as_uri().encode()
        at = self.library.fmi2Instantiate(b"a", 1, root.get("guid").encode(), where, self.callbacks, 0, 1)
        self.instance = ctypes.c_void_p(at)
        self.states: dict[str, ctypes.c_void_p] = {}

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
    """`way`: calls that must be accepted first. `call`: the call under test, on `fmu`. `words`: words of the refusal."""

    name: str
    way: Sequence[Callable[[Host], int]]
    call: Callable[[Host], int]
    outcome: str
    words: str = ""
    fmu: str = "plain"


SETUP, ENTER, LEAVE, STEP, TERMINATE, RESET = (
    lambda h: h.setup(),
    lambda h: h.enter(),
    lambda h: h.leave(),
    lambda h: h.step(),
    lambda h: h.terminate(),
    lambda h: h.reset(),
)
INIT = (SETUP, ENTER)
RUN = (SETUP, ENTER, LEAVE)
ENDED = (*RUN, TERMINATE)
READ, WRITE = (lambda h: h.get("Real", "thrust")), (lambda h: h.set("Real", omega_ref=1000.0))
NOT = "found a call"

CASES = (
    # the order of calls
    Case("step before the initialisation", (), STEP, REFUSED, f"fmi2DoStep: {NOT} before the initialization mode"),
    Case("step in the initialisation", INIT, STEP, REFUSED, f"fmi2DoStep: {NOT} in initialization mode"),
    Case("step after the end", ENDED, STEP, REFUSED, f"fmi2DoStep: {NOT} after it was terminated"),
    Case("read before the initialisation", (), READ, REFUSED, f"fmi2GetReal: {NOT} before the initialization mode"),
    Case("read in the initialisation", INIT, READ, TAKEN),
    Case("read after the end", ENDED, READ, TAKEN),
    Case("write before the initialisation", (), WRITE, TAKEN),
    Case("write after the end", ENDED, WRITE, REFUSED, f"fmi2SetReal: {NOT} after it was terminated"),
    Case("enter twice", INIT, ENTER, REFUSED, f"fmi2EnterInitializationMode: {NOT} in initialization mode"),
    Case("enter while running", RUN, ENTER, REFUSED, f"fmi2EnterInitializationMode: {NOT} after the initialization mode"),
    Case("enter without set-up", (), ENTER, TAKEN),
    Case("leave before entering", (SETUP,), LEAVE, REFUSED, f"fmi2ExitInitializationMode: {NOT} before"),
    Case("leave twice", RUN, LEAVE, REFUSED, f"fmi2ExitInitializationMode: {NOT} after the initialization mode"),
    Case("terminate before the initialisation", (), TERMINATE, REFUSED, f"fmi2Terminate: {NOT} before"),
    Case("terminate in the initialisation", INIT, TERMINATE, REFUSED, f"fmi2Terminate: {NOT} in initialization mode"),
    Case("terminate twice", ENDED, TERMINATE, REFUSED, f"fmi2Terminate: {NOT} after it was terminated"),
    Case("reset before the initialisation", (), RESET, TAKEN),
    Case("reset after the end", ENDED, RESET, TAKEN),
    Case("start again after a reset", (*ENDED, RESET, *RUN), STEP, TAKEN),
    Case("booleans before the initialisation", (), lambda h: h.get("Boolean", "speed_only"), REFUSED, NOT, "controller"),
    Case("integers after the end", ENDED, lambda h: h.set("Integer"), REFUSED, f"fmi2SetInteger: {NOT}"),
    Case("keep a state before the initialisation", (), lambda h: h.keep(), TAKEN),
    Case("logging before the initialisation", (), lambda h: h.log(1), TAKEN),
    # what is set
    Case("NaN as an input", RUN, lambda h: h.set("Real", omega_ref=NAN), REFUSED, "omega_ref: found nan"),
    Case("infinity as an input", RUN, lambda h: h.set("Real", beta_ref=-INF), REFUSED, "beta_ref: found -inf"),
    Case("NaN before the initialisation", (), lambda h: h.set("Real", omega_ref=NAN), REFUSED, "expected a finite number"),
    Case(
        "set an output",
        INIT,
        lambda h: h.set("Real", thrust=1.0),
        REFUSED,
        "VppPlant: thrust: found a value, expected none: it is computed",
    ),
    Case(
        "set a state while running",
        RUN,
        lambda h: h.set("Real", ("state.omega_inner", 1.0)),
        REFUSED,
        "state.omega_inner: found a value after initialisation, expected it before: it is computed",
    ),
    Case("set a state before", (), lambda h: h.set("Real", ("state.omega_inner", 1.0)), TAKEN),
    Case(
        "set a fixed parameter while running",
        RUN,
        lambda h: h.set("Real", c20=0.3),
        REFUSED,
        "c20: found a value after initialisation, expected it before: it is fixed",
    ),
    Case("set a parameter before", (), lambda h: h.set("Real", c20=0.3), TAKEN),
    Case("NaN as a parameter", INIT, lambda h: h.set("Real", c20=NAN), REFUSED, "c20: found nan"),
    Case("tune a gain while running", RUN, lambda h: h.set("Real", kp_omega=2.0), TAKEN, "", "controller"),
    Case(
        "tune a gain out of range",
        RUN,
        lambda h: h.set("Real", kp_omega=-1.0),
        REFUSED,
        "expected 0.0 to 10000.0",
        "controller",
    ),
    Case("switch while running", RUN, lambda h: h.set("Boolean", speed_only=1), TAKEN, "", "controller"),
    Case(
        "a switch as a number",
        RUN,
        lambda h: h.set("Real", speed_only=1.0),
        REFUSED,
        "found speed_only of type Boolean",
        "controller",
    ),
    Case("a number as a switch", RUN, lambda h: h.set("Boolean", omega_ref=1), REFUSED, "found omega_ref of type Real"),
    Case("a number as an integer", RUN, lambda h: h.get("Integer", "thrust"), REFUSED, "found thrust of type Real"),
    Case("a number as text", RUN, lambda h: h.get("String", "thrust"), REFUSED, "found thrust of type Real"),
    Case("text for a number", INIT, lambda h: h.set("String", omega_ref="fast"), REFUSED, "found omega_ref of type Real"),
    Case("no variables at all", RUN, lambda h: h.get("Real"), TAKEN),
    Case(
        "read an unknown reference",
        RUN,
        lambda h: h.get("Real", 999),
        REFUSED,
        "value reference: found 999, expected 0 to",
    ),
    Case("set an unknown reference", RUN, lambda h: h.set("Real", (999, 1.0)), REFUSED, "value reference: found 999"),
    Case("read the largest reference", RUN, lambda h: h.get("Real", 2**32 - 1), REFUSED, "value reference: found 4294967295"),
    Case(
        "a parameter out of range", (*INIT, lambda h: h.set("Real", tau_omega_1=35.0)), LEAVE, REFUSED, "omega_1: found 35.0 s"
    ),
    # steps
    Case("no step", RUN, lambda h: h.step(0.0, 0.0), REFUSED, "communication step: found 0.0 s, expected a positive number"),
    Case("a negative step", RUN, lambda h: h.step(0.0, -0.004), REFUSED, "communication step: found -0.004 s"),
    Case("NaN as a step", RUN, lambda h: h.step(0.0, NAN), REFUSED, "communication step: found nan s"),
    Case("an infinite step", RUN, lambda h: h.step(0.0, INF), REFUSED, "communication step: found inf s"),
    Case("the plain plant's step of 30 years", RUN, lambda h: h.step(0.0, 1e9), REFUSED, "expected up to 100000.0 s"),
    Case("a step of 30 years", RUN, lambda h: h.step(0.0, 1e9), REFUSED, "expected up to 100.0 s", "all_on"),
    Case("a controller's step of 30 years", RUN, lambda h: h.step(0.0, 1e9), REFUSED, "expected up to 400.0 s", "controller"),
    Case("a step at another time", RUN, lambda h: h.step(777.0), REFUSED, "found 777.0 s, expected the instance's time, 0.0 s"),
    Case("a step at no time", RUN, lambda h: h.step(NAN), REFUSED, "start of the step: found nan s"),
    Case("the same step again", (*RUN, STEP), STEP, REFUSED, "found 0.0 s, expected the instance's time, 0.004 s"),
    Case("the next step", (*RUN, STEP), lambda h: h.step(0.004), TAKEN),
    Case("the next step, a rounding off", (*RUN, STEP), lambda h: h.step(0.004 + 1e-9), TAKEN),
    Case("a start at another time", (lambda h: h.setup(10.0), ENTER, LEAVE), lambda h: h.step(10.0), TAKEN),
    Case(
        "no numbers come out",
        (*RUN, lambda h: h.set("Real", omega_ref=1e300)),
        STEP,
        REFUSED,
        "found no finite numbers from omega_ref = 1e+300",
    ),
    Case(
        "no numbers at the start",
        (*INIT, lambda h: h.set("Real", omega_ref=1e300)),
        LEAVE,
        REFUSED,
        "found no finite numbers from",
    ),
    Case(
        "no numbers to read at the start",
        (*INIT, lambda h: h.set("Real", omega_ref=1e300)),
        READ,
        REFUSED,
        "found no finite numbers from",
    ),
    # after an error
    Case(
        "step after an error",
        (*RUN, lambda h: not h.step(777.0)),
        STEP,
        REFUSED,
        f"{NOT} after an error (a reset or a saved state mends it)",
    ),
    Case("write after an error", (*RUN, lambda h: not h.step(777.0)), WRITE, REFUSED, f"{NOT} after an error"),
    Case("read after an error", (*RUN, lambda h: not h.step(777.0)), READ, TAKEN),
    Case("reset after an error", (*RUN, lambda h: not h.step(777.0)), RESET, TAKEN),
    Case("three errors in a row", (*RUN, *[lambda h: not h.step(777.0)] * 3, RESET, *RUN), STEP, TAKEN),
    Case(
        "a saved state after an error", (*RUN, lambda h: h.keep(), lambda h: not h.step(777.0), lambda h: h.back()), STEP, TAKEN
    ),
    # states
    Case("a saved state goes back in time", (*RUN, lambda h: h.keep(), STEP, lambda h: h.back()), STEP, TAKEN),
    Case("a state through bytes", (*RUN, lambda h: h.keep()), lambda h: h.through_bytes(), TAKEN),
    Case(
        "a flipped bit in a state",
        (*RUN, lambda h: h.keep()),
        lambda h: h.through_bytes(lambda b: b[:60] + bytes([b[60] ^ 1]) + b[61:]),
        REFUSED,
        "bytes that hold none",
    ),
    Case(
        "half a state",
        (*RUN, lambda h: h.keep()),
        lambda h: h.through_bytes(lambda b: b[: len(b) // 2]),
        REFUSED,
        "expected a serialised state",
    ),
    Case(
        "text for a state",
        (*RUN, lambda h: h.keep()),
        lambda h: h.through_bytes(lambda b: b"not a state"),
        REFUSED,
        "expected a serialised state",
    ),
    # logging
    Case("all categories", RUN, lambda h: h.log(1, "logAll"), TAKEN),
    Case("one category", RUN, lambda h: h.log(0, "logStatusError"), TAKEN),
    Case("an unknown category", RUN, lambda h: h.log(1, "logEverything"), TAKEN),
)


def run(case: Case, folder: Path) -> dict:
    """The result of a case, and whether the instance survived."""
    host = Host(folder)
    problem = next((f"call {i} on the way was refused" for i, call in enumerate(case.way) if call(host)), "")
    host.said.clear()
    status = case.call(host)
    said = host.said[-1].strip().splitlines()[-1] if host.said else ""
    lost = [] if host.get("Real", *host.reals) else [n for n, x in zip(host.reals, host.got, strict=True) if not isfinite(x)]
    first = (lambda h: h.set("Real", (0, 1.0))), STEP, (lambda h: h.get("Real", 2))  # an input, an output
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
