"""python -m vpp_fmu.first_step JSON: load an FMI 2.0 FMU, start it and make one step, in a process that may crash.

Prints each stage before it begins, and ALIVE after the last. It imports the standard library only, to start fast.
"""

import ctypes
import json
import os
import sys

ALIVE = "alive"


def main(settings: dict) -> None:
    """`settings`: `library`, `guid`, `resources` (URI), and the communication step `dt` [s]."""
    stages = os.fdopen(os.dup(1), "w", encoding="ascii")
    os.dup2(2, 1)  # keeps the FMU's own output apart from the stages

    def stage(text: str) -> None:
        print(text, file=stages, flush=True)

    logger = ctypes.CFUNCTYPE(None, *[ctypes.c_void_p] * 2, ctypes.c_int, *[ctypes.c_void_p] * 2)(lambda *_: None)
    process = ctypes.CDLL(None) if os.name != "nt" else ctypes.CDLL("msvcrt")
    functions = (ctypes.cast(f, ctypes.c_void_p).value for f in (logger, process.calloc, process.free))
    callbacks = (ctypes.c_void_p * 5)(*functions)
    stage("it was loaded")
    os.chdir(os.path.dirname(settings["library"]))  # as fmpy does
    try:
        library = ctypes.CDLL(settings["library"])
    except OSError:  # the caller loads it again and reports the reason
        stage(ALIVE)
        return
    library.fmi2Instantiate.restype = ctypes.c_void_p
    stage("it was instantiated")
    names = settings["name"].encode(), 1, settings["guid"].encode(), settings["resources"].encode()
    instance = ctypes.c_void_p(library.fmi2Instantiate(*names, callbacks, 0, 1))
    zero = ctypes.c_double(0.0)
    if instance:
        stage("it was started")
        calls = (("SetupExperiment", 0, zero, zero, 0, zero), ("EnterInitializationMode",), ("ExitInitializationMode",))
        failed = any(getattr(library, f"fmi2{name}")(instance, *given) > 1 for name, *given in calls)
        stage("it made its first step")
        if not failed:
            library.fmi2DoStep(instance, zero, ctypes.c_double(settings["dt"]), 1)
    stage(ALIVE)
    os._exit(0)  # the FMU may hold the interpreter, so it is not finalised


if __name__ == "__main__":
    main(json.loads(sys.argv[1]))
