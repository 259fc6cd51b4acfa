"""Uncertainty of a parameter set: from the named identification.json, or the one beside the parameter file."""

import warnings

from identification.assessment.information import read_knowledge
from identification.fit.problem import Prior
from vpp_fmu.errors import BadInput
from vpp_fmu.parameters import ParameterSet, beside, check_same_model
from vpp_fmu.record import RecordWarning


def knowledge_of(options, parameters: ParameterSet) -> tuple[str | None, tuple[Prior, float] | None]:
    """(the file, from --knowledge or beside --parameters; its content by `read_knowledge`); None twice if neither exists.

    BadInput for a named file that can't be read, or is of another model. Such a file that is not named is ignored with a note.
    """
    of = options.parameters or "the paper's fine-tuned set"
    if options.knowledge:
        check_same_model(options.knowledge, parameters, of)
        return options.knowledge, read_knowledge(options.knowledge)
    if not options.parameters or not (found := beside(options.parameters)).is_file():
        return None, None
    try:
        check_same_model(found, parameters, of)
        return str(found), read_knowledge(found)
    except BadInput as error:
        warnings.warn(f"not used: {' '.join(str(error).split())}", RecordWarning, stacklevel=2)
        return None, None
