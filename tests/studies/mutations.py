"""python -m tests.studies mutations: small mutations of the code, and whether the tests that cover it fail.

A mutation negates a comparison or a condition, exchanges `+` and `-`, `*` and `/`, `and` and `or`, changes a number, or drops a
statement. One at a time goes into a copy of the tree, and the tests of its part run there until one fails. A mutation that no
test notices survives. It is printed with its place: either it changes nothing that matters, or a test is missing.
"""

import ast
import os
import random
import resource
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from tests.tables import ROOT, table


@dataclass(frozen=True)
class Part:
    """`modules`: patterns of files; `tests`: files that cover them, the quickest first, and which of their tests count, as
    pytest's -k takes it (default: all)."""

    modules: tuple[str, ...]
    tests: tuple[str, ...]
    keep: str = ""


PARTS = {
    "units": Part(
        ("vpp_fmu/units.py", "identification/logs/units.py"),
        ("test_parameters", "test_import_csv", "test_import_columns"),
        "test_parameters or unit or calibrat or electrical",
    ),
    "rig": Part(
        ("vpp_fmu/rig.py",),
        ("test_logger", "test_commands", "test_campaign"),
        "(rig or unit or scale or span or slew or declares) and not random",
    ),
    "safety": Part(
        ("hil/safety/*.py",),
        (
            *("hil/test_limits", "hil/test_stop", "hil/test_supply", "hil/test_tare", "hil/test_polarity"),
            *("hil/test_plausibility", "hil/test_states", "hil/test_supervisor"),
        ),
    ),
    "kernel": Part(
        ("vpp_fmu/kernel/*.py", "vpp_fmu/kernel/effects/*.py"),
        ("test_controller", "test_duals", "test_converter", "test_tune_loop", "test_effect_physics", "test_kernel"),
    ),
    "export": Part(("vpp_fmu/export/*.py",), ("test_fmu", "test_own_models", "test_fmi3")),
}
"""Learned terms and twin of the kernel are left out, because their tests take minutes."""

SECONDS = 180
"""CPU seconds after which a run of the tests counts as failed, so that an endless loop is noticed."""

NEGATED = {
    **{ast.Lt: ast.GtE, ast.GtE: ast.Lt, ast.Gt: ast.LtE, ast.LtE: ast.Gt, ast.Eq: ast.NotEq, ast.NotEq: ast.Eq},
    **{ast.In: ast.NotIn, ast.NotIn: ast.In, ast.Is: ast.IsNot, ast.IsNot: ast.Is},
}
EXCHANGED = {ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult, ast.Pow: ast.Mult}


@dataclass(frozen=True)
class Mutation:
    """`new` text in the place of bytes `start` to `end` of a file that has `old` there."""

    file: str
    line: int
    start: int
    end: int
    old: str
    new: str

    def __str__(self) -> str:
        old, new = (" ".join(text.split())[:90] for text in (self.old, self.new))
        return f"{self.file}:{self.line}  {old}  ->  {new}"

    def apply(self, tree: Path) -> None:
        """Write it into the file of a tree."""
        source = (ROOT / self.file).read_bytes()
        (tree / self.file).write_bytes(source[: self.start] + self.new.encode() + source[self.end :])


def mutations(file: str, source: str) -> list[Mutation]:
    """All mutations of a module, in its order."""
    lines = [0]
    for line in source.encode().splitlines(keepends=True):
        lines.append(lines[-1] + len(line))
    found = []
    for node in _nodes(ast.parse(source)):
        for new in _mutated(node):
            start, end = lines[node.lineno - 1] + node.col_offset, lines[node.end_lineno - 1] + node.end_col_offset
            old = source.encode()[start:end].decode()
            found.append(Mutation(file, node.lineno, start, end, old, new))
    return sorted(found, key=lambda mutation: mutation.start)


def _nodes(tree: ast.AST) -> Iterator[ast.AST]:
    """All nodes but those of f-strings, which have no place before Python 3.12, and of decorators, as `frozen=True`."""
    for node in ast.iter_child_nodes(tree):
        if not isinstance(node, ast.JoinedStr) and node not in getattr(tree, "decorator_list", ()):
            yield node
            yield from _nodes(node)


def _mutated(node: ast.AST) -> Iterator[str]:
    """The texts that may take the place of a node."""
    match node:
        case ast.Compare(left, [one], [right]) if type(one) in NEGATED:
            yield f"({ast.unparse(ast.Compare(left, [NEGATED[type(one)]()], [right]))})"
        case ast.BinOp(left, operator, right) if type(operator) in EXCHANGED:
            yield f"({ast.unparse(ast.BinOp(left, EXCHANGED[type(operator)](), right))})"
        case ast.BoolOp(operator, values):
            other = ast.Or() if isinstance(operator, ast.And) else ast.And()
            yield f"({ast.unparse(ast.BoolOp(other, values))})"
        case ast.UnaryOp(ast.Not() | ast.USub(), operand):
            yield f"({ast.unparse(operand)})"
        case ast.IfExp(test, body, orelse):
            yield f"({ast.unparse(ast.IfExp(ast.UnaryOp(ast.Not(), test), body, orelse))})"
        case ast.Constant(bool() as value):
            yield str(not value)
        case ast.Constant(int() | float() as value):
            yield repr(value + 1) if isinstance(value, int) or value == 0.0 else repr(2.0 * value)
        case ast.Expr(ast.Call()) | ast.AugAssign() | ast.Raise() | ast.If(orelse=[]):
            yield "pass"


def modules(part: Part) -> list[str]:
    """Files of a part."""
    return sorted(str(path.relative_to(ROOT)) for pattern in part.modules for path in ROOT.glob(pattern))


def passed(tree: Path, part: Part) -> bool:
    """Whether a part's tests pass in a tree."""
    words = [
        sys.executable,
        *["-m", "pytest", "-q", "-x", "-p", "no:cacheprovider", "-n0"],
        *(f"tests/{name}.py" for name in part.tests),
    ]
    words += ["-k", part.keep] if part.keep else []
    environment = os.environ | {"PYTHONPATH": str(tree), "XDG_CACHE_HOME": str(tree / "cache"), "PYTHONDONTWRITEBYTECODE": "1"}
    quiet = {"stdin": subprocess.DEVNULL, "stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    bounded = partial(resource.setrlimit, resource.RLIMIT_CPU, (SECONDS, SECONDS))
    return not subprocess.run(words, check=False, cwd=tree, env=environment, preexec_fn=bounded, **quiet).returncode


def tried(tree: Path, part: Part, chosen: Sequence[Mutation]) -> list[Mutation]:
    """The mutations that survive; each mutation is printed with its result."""
    if not passed(tree, part):
        raise SystemExit(f"{', '.join(part.tests)}: a test fails without a mutation")
    survivors = []
    for mutation in chosen:
        mutation.apply(tree)
        survives = passed(tree, part)
        survivors += [mutation] if survives else []
        print(f"{'SURVIVES' if survives else 'killed':8}  {mutation}", flush=True)
        shutil.copy2(ROOT / mutation.file, tree / mutation.file)
    return survivors


def main(parser, arguments):
    parser.add_argument("--parts", nargs="+", choices=PARTS, default=list(PARTS), help="of the code (default: all)")
    parser.add_argument("--sample", type=int, default=12, metavar="N", help="mutations of each part (default: %(default)s)")
    parser.add_argument("--seed", type=int, default=0, help="of the sample (default: %(default)s)")
    options = parser.parse_args(arguments)
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        tree = Path(folder, "tree")
        shutil.copytree(ROOT, tree, ignore=shutil.ignore_patterns(".git", ".venv", "__pycache__"))
        for name in options.parts:
            part = PARTS[name]
            all_of_it = [m for file in modules(part) for m in mutations(file, (ROOT / file).read_text())]
            chosen = random.Random(options.seed).sample(all_of_it, min(options.sample, len(all_of_it)))
            survivors = tried(tree, part, chosen)
            rows.append((name, len(all_of_it), len(chosen), len(chosen) - len(survivors), len(survivors)))
    print(f"\n{table(('part', 'mutations', 'tried', 'killed', 'survived'), rows)}", end="")
