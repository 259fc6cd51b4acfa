"""Allowed calls of an FMU's instance by state: the common table of all flavours' state machines.

From FMI 2.0.4, section 4.2.4, and FMI 3.0, section 4.2; where these are ambiguous, the stricter reading. After an error the
state is FAILED: values can still be read, and a reset or a saved state restores the instance. A state is a bit, so that a set
of states is a number. This file is part of the Python FMU; `vpp_fmu.export` writes the same table as C.
"""

INSTANTIATED, INITIALISING, STEPPING, TERMINATED, FAILED = STATES = 1, 2, 4, 8, 16
ANY = sum(STATES)

SETUP_STATES = ENTER_STATES = INSTANTIATED
EXIT_STATES = INITIALISING
TERMINATE_STATES = STEP_STATES = STEPPING
CANCEL_STATES = 0  # a step is done when its call returns: none is ever in progress
GET_STATES = DERIVATIVE_STATES = INITIALISING | STEPPING | TERMINATED | FAILED
SET_STATES = INPUT_DERIVATIVES_STATES = INSTANTIATED | INITIALISING | STEPPING
STATUS_STATES = OUTPUT_DERIVATIVES_STATES = STEPPING | TERMINATED | FAILED
RESET_STATES = STATE_STATES = LOG_STATES = ANY

IN_WORDS = {
    INSTANTIATED: "before the initialization mode",
    INITIALISING: "in initialization mode",
    STEPPING: "after the initialization mode",
    TERMINATED: "after it was terminated",
    FAILED: "after an error (a reset or a saved state mends it)",
}

SLACK = 1e-3
"""Maximum distance, in communication steps, between the end of a step and the start of the next: importers round time in
different ways. For very short steps, a nanosecond per second of time is allowed in addition."""

LOG_CATEGORIES = {
    "logEvents": "what the instance was brought to: initialised, tuned, terminated; only if logging is on",
    "logStatusWarning": "what was ignored, and why",
    "logStatusDiscard": "questions without an answer",
    "logStatusError": "calls that failed, and why",
    "logStatusFatal": "calls after which the instance is lost",
    "logAll": "all of them",
}
"""Names as FMI 2.0 standardises them. Errors are logged unless they are switched off, also without debug logging."""
