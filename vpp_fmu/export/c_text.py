"""The C file of a native FMU: FMI's declarations, the traced model with tables and tangents, schedule and FMI functions."""

from collections.abc import Mapping
from hashlib import sha256
from importlib.resources import files
from math import isinf

from vpp_fmu.export.description import allowed, in_unit, start_values, variable_names, variable_types
from vpp_fmu.kernel import calls
from vpp_fmu.kernel.types import Model, show, start, step
from vpp_fmu.tracer import Layout, c_source, trace
from vpp_fmu.tracer.emit import c_function
from vpp_fmu.tracer.graph import Graph, needed
from vpp_fmu.tracer.tangents import tangents

COMPILERS = """\
/* Fused multiply-adds round once where the model rounds twice: results would differ from machine to machine. */
#if defined(__clang__)
#pragma STDC FP_CONTRACT OFF
#elif defined(__GNUC__)
#pragma GCC optimize("fp-contract=off")
#elif defined(_MSC_VER)
#pragma fp_contract(off)
#endif

#ifdef __GNUC__ /* what one model needs of the common texts, another does not */
#pragma GCC diagnostic ignored "-Wunused-function"
#pragma GCC diagnostic ignored "-Wunused-parameter"
#pragma GCC diagnostic ignored "-Wunused-const-variable"
#endif
"""


SHELLS = {"2.0": ("fmi2.h", "shell2.c"), "3.0": ("fmi3.h", "shell3.c")}
"""Declarations and functions of each version of the standard; the parts between them are common."""

TYPES = {kind: kind.upper() for kind in ("Real", "Integer", "Boolean", "Enumeration", "String")}


def c_text(model: Model, values: Mapping[str, float], guid: str, version: str = "2.0") -> str:
    """`values`: every parameter's start value. `version`: of FMI, one of SHELLS."""
    title = f"/* {model.name}: {model.description}.\n *\n * Generated; compiles alone with any C99 compiler. */\n"
    header, shell = SHELLS[version]
    return "\n".join(
        (
            title + COMPILERS,
            _text("fmu_src", header),
            c_source(trace(model)) + tangent_source(model),
            _tables(model, values, guid),
            _calls(),
            _text("vpp_fmu.kernel", "schedule.c"),
            *(_text("fmu_src", name) for name in ("slave.h", "sensitivity.c", "saved_state.c", "protocol.c", shell)),
        )
    )


def tangent_source(model: Model) -> str:
    """`start_along(v, a)`, `step_along(v, dt, dt_along, a)`: directional derivatives of outputs and states; and
    `show_along(v, a)`: those of the outputs at given states.

    `a` has the layout of the values and holds the direction in inputs, parameters and, before a step, states; the derivatives
    of outputs and states are filled in. `v` holds the values before the step.
    """
    layout, graph = Layout.of(model), Graph()
    inputs, parameters, states = (
        {name: graph.node("v", layout.index[kind, name]) for name in names}
        for kind, names in (("input", layout.inputs), ("parameter", layout.parameters), ("state", layout.states))
    )
    dt = graph.node("dt")
    leaves = {v: graph.node("a", *v.args) for v in (*inputs.values(), *parameters.values())}
    from_start = dict(leaves)
    leaves |= {v: graph.node("a", *v.args) for v in states.values()}
    from_step = leaves | {dt: graph.node("dt_along")}

    def writes(signals, ahead, leaves):
        reached = [signals[n] for n in layout.outputs] + [ahead[n] for n in layout.states]
        moves = tangents(graph, leaves, reached, needed(reached))
        return tuple((("a", i), move) for i, move in zip(layout.moving, moves, strict=True))

    def name(target):
        kind, *i = target
        return f"{kind}[{i[0]}]" if i else kind

    begun = writes(*start(model, graph, inputs, parameters), from_start)
    moved = writes(*step(model, graph, inputs, states, parameters, dt), from_step)
    seen = writes(show(model, graph, inputs, states, parameters), states, leaves)[: len(layout.outputs)]
    return (
        c_function("void start_along(const double *v, double *a)", begun, name)
        + c_function("void step_along(const double *v, double dt, double dt_along, double *a)", moved, name)
        + c_function("void show_along(const double *v, double *a)", seen, name)
    )


def _tables(model: Model, values: Mapping[str, float], guid: str) -> str:
    """Names, types, start values and ranges, for checks and messages."""
    ranges = [
        f"{{{_number(p.minimum)}, {_number(p.maximum)}, {_string(in_unit(p))}, {_string(allowed(p))}}}"
        for p in model.parameters
    ]
    defined = {
        "MODEL_NAME": _string(model.name),
        "MODEL_GUID": _string(guid),
        "MODEL_TAG": f"{int(sha256(guid.encode()).hexdigest()[:12], 16)}.0",  # 48 bits: a double holds it exactly
        "EXACT": int(is_exact(model)),
        "N_PARAMETERS_OR_1": max(1, len(model.parameters)),
        "N_STATES_OR_1": max(1, len(model.states)),
        "SLACK": calls.SLACK,
    }
    quantities = (*model.inputs, *model.outputs, *model.parameters)
    items = {r: q.items for r, q in enumerate(quantities) if q.items}
    sizes = [0 if q.place > 1 else max(1, q.size) for q in (*quantities, *model.states)]
    types = ", ".join(TYPES[kind] for kind in variable_types(model))
    tunable = ", ".join(str(int(p.tunable)) for p in model.parameters)
    return "".join(
        (
            *(f"#define {name} {value}\n" for name, value in defined.items()),
            f"enum {{ {', '.join(TYPES.values())} }};\n",
            f"static const char *const TYPE_NAMES[] = {{{', '.join(map(_string, TYPES))}}};\n",
            f"static const char *const NAMES[] = {{{', '.join(map(_string, variable_names(model)))}}};\n",
            f"static const unsigned char TYPES[] = {{{types}}};\n",
            *(
                f"static const char *const ITEMS_{r}[] = {{{', '.join(map(_string, texts))}, 0}};\n"
                for r, texts in items.items()
            ),
            f"static const char *const *const ITEMS[N_VALUES] = {{{', '.join(f'[{r}] = ITEMS_{r}' for r in items) or 0}}};\n",
            f"static const int SIZES[] = {{{', '.join(map(str, sizes))}}}; /* elements from here; 0: inside a vector */\n",
            f"static const unsigned char TUNABLE[] = {{{tunable or 0}}};\n",
            f"static const double START[] = {{{', '.join(map(_number, start_values(model, values)))}}};\n",
            "static const struct {\n  double minimum, maximum;\n  const char *unit, *text;\n} RANGES[] = {\n",
            *(f"  {line},\n" for line in ranges or ['{0.0, 0.0, "", ""}']),
            "};\n#define OBSERVED\n",
        )
    )


def _calls() -> str:
    """The table of calls, with its states in words."""
    numbers = {name: value for name, value in vars(calls).items() if isinstance(value, int) and name.isupper()}
    words = ", ".join(f"[{state}] = {_string(text)}" for state, text in calls.IN_WORDS.items())
    categories = [name for name in calls.LOG_CATEGORIES if name != "logAll"]
    kinds = [name.removeprefix("log").removeprefix("Status").upper() for name in categories]
    return "".join(
        (
            f"enum {{ {', '.join(f'{name} = {value}' for name, value in numbers.items())} }};\n",
            f"static const char *const IN_WORDS[] = {{{words}}};\n",
            f"enum {{ {', '.join(kinds)}, N_CATEGORIES }};\n",
            f"static const char *const CATEGORIES[] = {{{', '.join(map(_string, categories))}}};\n",
        )
    )


def is_exact(model: Model) -> bool:
    """Whether one communication step is one step of the chain."""
    return not (model.sample_time or model.delays or model.sampled or any(e.largest_step is not None for e in model.effects))


def _string(text: str) -> str:
    return '"' + text.replace("\\", "\\\\").replace('"', '\\"') + '"'


def _number(x: float) -> str:
    return ("-" if x < 0 else "") + "INFINITY" if isinf(x) else repr(float(x))


def _text(package: str, name: str) -> str:
    return (files(package) / name).read_text(encoding="utf-8")
