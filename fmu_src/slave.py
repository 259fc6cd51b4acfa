"""The Python FMU's slave: a traced model under pythonfmu's calls, as strict as the native flavour (`protocol.c`).

An export has one file of code: schedule.py, the table of calls, this file, the generated functions and a class that names
them (`vpp_fmu.export`). Another file, which the binary executes for each instance, imports that class. The code may import only
the standard library and pythonfmu, which is also in the FMU. The export removes the imports of this project below, since their
code is in the same file.

All values live in one list `v`, in the order of the value references: inputs, outputs, parameters, states.

pythonfmu's binary returns fmi2Fatal for an exception. With each exception it drops its references to the instance, the class
and the messages, but uses and drops them again later (`upstream/` has a patch). `_kept` therefore adds as many references
before an exception leaves.

At the end of the process the binary releases the interpreter twice, the second time through freed memory (`upstream/` has a
patch). `_release_at_exit` makes it release once, before that.
"""

import atexit
import ctypes
import glob
import json
import os
import pickle
import weakref
import zlib
from contextlib import suppress
from functools import wraps
from math import inf, isfinite

from pythonfmu.enums import Fmi2Status
from pythonfmu.fmi2slave import Fmi2Slave

from vpp_fmu.kernel.calls import (
    ENTER_STATES,
    EXIT_STATES,
    FAILED,
    GET_STATES,
    IN_WORDS,
    INITIALISING,
    INSTANTIATED,
    LOG_CATEGORIES,
    SET_STATES,
    SLACK,
    STEP_STATES,
    STEPPING,
    TERMINATE_STATES,
    TERMINATED,
)
from vpp_fmu.kernel.schedule import LONGEST_EXACT, NOW, PIECES, DelayFull, DelayLine, next_sample, run_held, run_sampled

TYPE_NAMES = ("Real", "Integer", "Boolean", "Enumeration", "String")
REAL, INTEGER, BOOLEAN, ENUMERATION, STRING = TYPE_NAMES
SAVED = ("time", "state", "settled", "scheduled", "wait")


ALIVE = weakref.WeakSet()
"""All instances of this FMU."""


RELEASED = set()
"""Folders of resources beside which the binary is released at exit."""


def _release_at_exit(resources):
    """Make pythonfmu's binary release the interpreter when Python ends, which is before the process ends.

    Its release at the end of the process then has nothing to do. Only ELF and Mach-O systems release in the wrong order,
    and only they have RTLD_NOLOAD, which returns the loaded library and loads no second one.
    """
    if resources in RELEASED or not hasattr(os, "RTLD_NOLOAD"):
        return
    RELEASED.add(resources)
    for path in glob.glob(os.path.join(glob.escape(resources), os.pardir, "binaries", "*", "*")):
        with suppress(OSError, AttributeError):  # a library of another system, or not pythonfmu's
            atexit.register(ctypes.CDLL(path, os.RTLD_NOLOAD).finalizePythonInterpreter)


class Refused(ValueError):
    """A refused call. pythonfmu logs the repr, so the repr is the message."""

    def __repr__(self):
        return str(self)


def _kept(*instances):
    """Add a reference to each object of these instances that pythonfmu's binary drops on an exception."""
    for instance in instances:
        for held in (type(instance), instance, instance.log_queue):
            ctypes.pythonapi.Py_IncRef(ctypes.py_object(held))


def own(names):
    """Add a reference to the global names of the file that the binary executes: it drops one that it does not own."""
    ctypes.pythonapi.Py_IncRef(ctypes.py_object(names))


def call(method):
    """Decorate a method that pythonfmu's binary calls: after any exception, even Ctrl-C, the instance remains usable."""

    @wraps(method)
    def guarded(self, *arguments):
        try:
            return method(self, *arguments)
        except BaseException:
            self._fail()
            raise

    return guarded


class TracedSlave(Fmi2Slave):
    """One instance of a traced model. A generated subclass sets these attributes and inherits from a step class below."""

    NAME = ""
    TAG = ""  # hash of the content: saved states of other FMUs are refused
    VARIABLES = ()  # name of each value
    TYPES = ()  # type of each value
    ITEMS = ()  # texts of each value that is an Enumeration or a String
    START = ()  # each value at instantiation
    RANGES = ()  # (minimum, maximum, unit for messages, range in words) of each parameter
    TUNABLE = ()  # which parameters may change while the model runs
    N_INPUTS = N_OUTPUTS = N_PARAMETERS = 0
    SAMPLES = ()  # (position of the time to its next sample, position of its period) of each sampled effect
    DELAYS = ()  # (position of the input, position of its delay)
    SAMPLE_TIME = None  # position of the period of a sampled model
    start = prepare = step = largest_step = show = total = None  # see vpp_fmu.tracer.emit.python_source

    log_categories = LOG_CATEGORIES

    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.modelName = self.NAME
        self.v = list(self.START)
        self.first_parameter = self.N_INPUTS + self.N_OUTPUTS
        self.first_state = self.first_parameter + self.N_PARAMETERS
        self.reals = frozenset(i for i, kind in enumerate(self.TYPES) if kind == REAL)
        self.real_inputs = self.reals & frozenset(range(self.N_INPUTS))
        self.state, self.settled, self.scheduled, self.chosen, self.time = INSTANTIATED, False, False, {}, 0.0
        self.prepared_for = self.constants = None
        self.lines, self.wait, self.longest = [], 0.0, 0.0
        ALIVE.add(self)
        if self.resources is not None:
            _release_at_exit(self.resources)

    @call
    def setup_experiment(self, start_time, *_):
        """pythonfmu passes the start time when the initialization begins."""
        self._allow("fmi2EnterInitializationMode", ENTER_STATES)
        if not isfinite(start_time):
            raise Refused(f"{self.NAME}: start time: found {start_time} s, expected a finite number")
        self.time = start_time

    @call
    def enter_initialization_mode(self):
        self._allow("fmi2EnterInitializationMode", ENTER_STATES)
        self.state = INITIALISING

    @call
    def exit_initialization_mode(self):
        """Start at rest on the present inputs."""
        self._allow("fmi2ExitInitializationMode", EXIT_STATES)
        for k in range(self.N_PARAMETERS):
            self._check_range(k)
        self._settle()
        self._schedule()
        self.state, self.scheduled = STEPPING, True
        self._report(f"initialised at {self.time} s")

    @call
    def terminate(self):
        self._allow("fmi2Terminate", TERMINATE_STATES)
        self.state = TERMINATED
        self._report(f"terminated at {self.time} s")

    # Called at each step: guarded as by `call`, without the cost of another call.

    def set_real(self, vrs, values):
        try:
            if not self.state & SET_STATES:
                self._allow("fmi2SetReal", SET_STATES)
            v, known = self.v, self.real_inputs
            for vr, value in zip(vrs, values, strict=True):
                if vr in known and value - value == 0.0:  # finite
                    v[vr] = value
                else:
                    self._set("fmi2SetReal", REAL, vr, value)
            self.settled = False
        except BaseException:
            self._fail()
            raise

    def get_real(self, vrs):
        try:
            if self.state != STEPPING:
                self._allow("fmi2GetReal", GET_STATES)
                self._settle()
            if not self.reals.issuperset(vrs):
                for vr in vrs:
                    self._check_type("fmi2GetReal", REAL, vr)
            v = self.v
            return [v[vr] for vr in vrs]
        except BaseException:
            self._fail()
            raise

    def do_step(self, current_time, step_size):
        kept = self.v[:]
        try:
            if self.state != STEPPING:
                self._allow("fmi2DoStep", STEP_STATES)
            if step_size != self.prepared_for:
                self._check_step(step_size)
            if current_time != self.time:
                self._check_time(current_time, step_size)
            self._take(current_time, step_size)
            self.time = current_time + step_size
            return True
        except BaseException:
            self.v[:] = kept  # after a failed step the values are those from before it
            self._fail()
            raise

    @call
    def set_integer(self, vrs, values):
        self._set_all("fmi2SetInteger", INTEGER, vrs, values)

    @call
    def set_boolean(self, vrs, values):
        self._set_all("fmi2SetBoolean", BOOLEAN, vrs, values)

    @call
    def set_string(self, vrs, values):
        self._allow("fmi2SetString", SET_STATES)
        for vr, text in zip(vrs, values, strict=True):
            self._check_type("fmi2SetString", STRING, vr)
            if text not in self.ITEMS[vr]:
                raise Refused(f"{self.NAME}: {self.VARIABLES[vr]}: found {text}, expected one of its items")
            self._set("fmi2SetString", STRING, vr, 1.0 + self.ITEMS[vr].index(text))
        self.settled = False

    @call
    def get_integer(self, vrs):
        return [int(value) for value in self._get_all("fmi2GetInteger", INTEGER, vrs)]

    @call
    def get_boolean(self, vrs):
        return [bool(value) for value in self._get_all("fmi2GetBoolean", BOOLEAN, vrs)]

    @call
    def get_string(self, vrs):
        numbers = self._get_all("fmi2GetString", STRING, vrs)
        for vr, x in zip(vrs, numbers, strict=True):
            self._check_item(vr, x)
        return [self.ITEMS[vr][int(x) - 1] for vr, x in zip(vrs, numbers, strict=True)]

    @call
    def _get_fmu_state(self):
        lines = [None if line is None else dict(vars(line), waits=[*line.waits], values=[*line.values]) for line in self.lines]
        kept = {name: getattr(self, name) for name in SAVED}
        return {"tag": self.TAG, **kept, "v": [*self.v], "chosen": [*self.chosen.items()], "lines": lines}

    @call
    def _set_fmu_state(self, state):
        if not isinstance(state, dict) or state.get("tag") != self.TAG:
            raise Refused(f"{self.NAME}: state: found one of another FMU, expected one of this FMU")
        self.v[:], self.chosen, self.lines = state["v"], dict(state["chosen"]), []
        if state["scheduled"]:
            self._schedule()
        vars(self).update((name, state[name]) for name in SAVED)
        for line, kept in zip(self.lines, state["lines"], strict=True):
            if line is not None:
                vars(line).update(kept, waits=[*kept["waits"]], values=[*kept["values"]])

    @classmethod
    def _fmu_state_to_bytes(cls, state):
        text = json.dumps(state)
        return json.dumps({"sum": zlib.crc32(text.encode()), "state": text}).encode()

    @classmethod
    def _fmu_state_from_bytes(cls, data):
        try:
            packed = json.loads(data.decode())
            if packed["sum"] != zlib.crc32(packed["state"].encode()):
                raise ValueError
            state = json.loads(packed["state"])
            if state["tag"] != cls.TAG:
                raise ValueError
        except (ValueError, KeyError, TypeError, RecursionError):
            # The call does not name the instance, so all are kept.
            _kept(*(instance for instance in ALIVE if type(instance) is cls))
            found = f"{len(data)} bytes that hold none"
            raise Refused(f"{cls.NAME}: state: found {found}, expected a serialised state of this FMU") from None
        return state

    def _fail(self):
        self.state = FAILED
        _kept(self)

    def _allow(self, name, states):
        if not self.state & states:
            raise Refused(f"{self.NAME}: {name}: found a call {IN_WORDS[self.state]}, expected one that is allowed then")

    def _report(self, text):
        self.log(f"{self.NAME}: {text}", Fmi2Status.ok, "logEvents")

    def _set_all(self, name, kind, vrs, values):
        self._allow(name, SET_STATES)
        for vr, value in zip(vrs, values, strict=True):
            self._set(name, kind, vr, value)
        self.settled = False

    def _get_all(self, name, kind, vrs):
        self._allow(name, GET_STATES)
        self._settle()
        for vr in vrs:
            self._check_type(name, kind, vr)
        return [self.v[vr] for vr in vrs]

    def _check_type(self, name, kind, vr):
        if not 0 <= vr < len(self.v):  # pythonfmu passes references as signed numbers
            reference = vr % 2**32
            raise Refused(f"{self.NAME}: value reference: found {reference}, expected 0 to {len(self.v) - 1}")
        if self.TYPES[vr] != kind and (self.TYPES[vr], kind) != (ENUMERATION, INTEGER):
            found = f"{self.VARIABLES[vr]} of type {self.TYPES[vr]}"
            raise Refused(f"{self.NAME}: {name}: found {found}, expected the call's own type")

    def _set(self, name, kind, vr, value):
        self._check_type(name, kind, vr)
        variable, k = self.VARIABLES[vr], vr - self.first_parameter
        is_parameter, is_state = self.first_parameter <= vr < self.first_state, vr >= self.first_state
        if vr >= self.N_INPUTS and not is_parameter and not is_state:
            raise Refused(f"{self.NAME}: {variable}: found a value, expected none: it is computed")
        if is_state and self.state == STEPPING:
            raise Refused(f"{self.NAME}: {variable}: found a value after initialisation, expected it before: it is computed")
        if is_parameter and self.state == STEPPING and not self.TUNABLE[k]:
            raise Refused(f"{self.NAME}: {variable}: found a value after initialisation, expected it before: it is fixed")
        value = float(value)
        if not isfinite(value):
            raise Refused(f"{self.NAME}: {variable}: found {value}, expected a finite number")
        self._check_item(vr, value)
        self.v[vr] = value
        if is_state:
            self.chosen[vr] = value
        if is_parameter and self.state == STEPPING:
            self._check_range(k)
            self.prepared_for = None
            self._retune()
            self._report(f"{variable} set to {value}")

    def _check_item(self, vr, x):
        n = len(self.ITEMS[vr])
        if n and not (1.0 <= x <= n and x == int(x)):
            raise Refused(f"{self.NAME}: {self.VARIABLES[vr]}: found item {x}, expected 1 to {n}")

    def _check_range(self, k):
        (low, high, unit, words), value = self.RANGES[k], self.v[self.first_parameter + k]
        if not low <= value <= high:
            name = self.VARIABLES[self.first_parameter + k]
            raise Refused(f"{self.NAME}: {name}: found {value}{unit}, expected {words}")

    def _settle(self):
        """Compute outputs and states from the values set during initialisation; after it only steps change them."""
        if self.state != INITIALISING or self.settled:
            return
        kept = self.v[:]
        try:
            self.start(self.v, None)
            self._show_chosen()
            self.settled = self._has_numbers()
        except (ArithmeticError, ValueError):
            pass  # then it is not settled
        if not self.settled:
            self.v[:] = kept
            raise self._no_numbers(self.time)

    def _show_chosen(self):
        """Compute the outputs for states that the importer has set. A sampled law has not run yet: its outputs keep their start
        values."""
        for vr, value in self.chosen.items():
            self.v[vr] = value
        if self.chosen and self.SAMPLE_TIME is None:
            self.show(self.v)

    def _has_numbers(self):
        outputs, states = self.v[self.N_INPUTS : self.first_parameter], self.v[self.first_state :]
        return all(map(isfinite, (*outputs, *states)))

    def _no_numbers(self, time):
        inputs = ", ".join(f"{name} = {value}" for name, value in zip(self.VARIABLES, self.v[: self.N_INPUTS], strict=False))
        return Refused(f"{self.NAME}: step at {time} s: found no finite numbers from {inputs}, expected finite ones")

    def _check_step(self, step_size):
        if not (step_size > 0.0 and isfinite(step_size)):
            raise Refused(f"{self.NAME}: communication step: found {step_size} s, expected a positive number")
        if step_size > self.longest:
            raise Refused(f"{self.NAME}: communication step: found {step_size} s, expected up to {self.longest} s")

    def _check_time(self, time, step_size):
        if not abs(time - self.time) <= SLACK * step_size + NOW * abs(time):
            raise Refused(f"{self.NAME}: start of the step: found {time} s, expected the instance's time, {self.time} s")

    def _take(self, time, step_size):
        try:
            self._advance(step_size)
        except DelayFull as full:
            raise Refused(f"{self.NAME}: {full}") from None
        except (ArithmeticError, ValueError):
            raise self._no_numbers(time) from None
        total = self.total(self.v)
        if total - total != 0.0 and not self._has_numbers():
            raise self._no_numbers(time)

    def _prepare(self, dt):
        self.prepared_for, self.constants = dt, self.prepare(self.v, dt, ())

    def _schedule(self):
        """Compute what depends on the parameters, before the first step."""
        self.prepared_for, self.wait = None, 0.0
        self._retune()

    def _retune(self):
        """Compute what depends on the parameters, whenever they change."""


class Exact:
    """Steps of a model that is exact for held inputs: one step of the chain is one communication step."""

    def _retune(self):
        self.longest = LONGEST_EXACT

    def _take(self, time, step_size):
        v = self.v
        try:
            if step_size != self.prepared_for:
                self._prepare(step_size)
            self.step(v, self.constants, None)
        except (ArithmeticError, ValueError):
            raise self._no_numbers(time) from None
        total = self.total(v)
        if total - total != 0.0 and not self._has_numbers():
            raise self._no_numbers(time)


class BlackBox:
    """Steps of a function that keeps what it likes in `memory`, a dictionary."""

    black_box = None

    def _retune(self):
        self.longest = LONGEST_EXACT

    def _schedule(self):
        super()._schedule()
        self.memory = {}

    def _advance(self, step_size):
        v, first = self.v, self.N_INPUTS
        inputs = dict(zip(self.VARIABLES, v, strict=True))
        for name in self.VARIABLES[first : self.first_parameter]:
            del inputs[name]
        outputs = self.black_box(self.memory, inputs, step_size)
        v[first : self.first_parameter] = [float(outputs[name]) for name in self.VARIABLES[first : self.first_parameter]]

    @call
    def _get_fmu_state(self):
        return {**super()._get_fmu_state(), "memory": pickle.dumps(self.memory).hex()}

    @call
    def _set_fmu_state(self, state):
        super()._set_fmu_state(state)
        self.memory = pickle.loads(bytes.fromhex(state["memory"]))


class Scheduled:
    """Steps of a model with delays, or with a largest step."""

    def _schedule(self):
        super()._schedule()
        self.lines = [None] * self.N_INPUTS
        for i, _ in self.DELAYS:
            self.lines[i] = DelayLine(self.v[i])
        self.delays = [None] * self.N_INPUTS
        for i, delay in self.DELAYS:
            self.delays[i] = self.v[delay]

    def _retune(self):
        self.largest = self.largest_step(self.v)
        self.longest = PIECES * min(self.largest, *(self.v[period] for _, period in self.SAMPLES), inf)

    def _advance(self, step_size):
        n = self.N_INPUTS
        held = self.v[:n]
        try:
            run_held(self.lines, self.delays, held, step_size, self.largest, self._piece, None, self._due)
        finally:
            self.v[:n] = held

    def _due(self):
        return [next_sample(self.v[wait], self.v[period]) for wait, period in self.SAMPLES]

    def _piece(self, acting, dt):
        if dt != self.prepared_for:
            self._prepare(dt)
        self.v[: self.N_INPUTS] = acting
        self.step(self.v, self.constants, None)


class Sampled:
    """Steps of a sampled law: it runs when a sample is due, whatever the communication step."""

    def _retune(self):
        self._prepare(self.v[self.SAMPLE_TIME])
        self.longest = PIECES * self.prepared_for

    def _advance(self, step_size):
        self.wait = run_sampled(self.wait, self.prepared_for, step_size, self._sample)

    def _sample(self, period):
        self.step(self.v, self.constants, None)
