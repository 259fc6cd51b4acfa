"""What is known of a parameter set beside its values: the identification.json that is named, or that stands beside its file."""

from identification.assessment.information import read_knowledge
from identification.fit.problem import Prior
from vpp_fmu.errors import BadInput
from vpp_fmu.parameters import ParameterSet, beside, check_same_model


def knowledge_of(options, parameters: ParameterSet) -> tuple[str | None, tuple[Prior, float] | None]:
    """(the file, as --knowledge or beside --parameters; what `read_knowledge` finds in it); twice None where neither is there.

    BadInput for a named file that can't be read, or is of another model. One that nobody named is then passed over, which is
    printed.
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
        print(f"not used: {' '.join(str(error).split())}")
        return None, None
