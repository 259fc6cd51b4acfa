"""A page for each verb of the command, from its parser."""

import argparse
import json
import re

from vpp_fmu.app.cli import VERBS, parser_of
from vpp_fmu.app.cli.answer import SCHEMAS

INDEX = "reference/verbs/index.md"


def index() -> str:
    """The list of verbs."""
    rows = "\n".join(f"| [`vpp {verb}`]({verb}.md) | {text} |" for verb, text in VERBS.items())
    return (
        "# Command line\n\n"
        "Each verb has its own page. `vpp VERB --help` prints the same text: both come from the parser.\n\n"
        f"| verb | purpose |\n| --- | --- |\n{rows}\n\n"
        "The first line of every verb is its answer. `--quiet` prints that line alone, `--verbose` all figures with their "
        "notes, `--json` one JSON object. Its keys are on the verb's page; the JSON Schemas are in the package, "
        "`vpp_fmu/app/cli/schemas`.\n\n"
        "Errors are one line on standard error: FILE: FIELD: found X, expected Y. Try: Z. With `--json` they are an object on "
        "standard output as well, `error.json` of these schemas.\n\n"
        "Exit codes: 0 success, 2 bad input after one line on standard error, 3 an alarm of the twin in `vpp hil`, 141 the "
        "reader of the output has closed it, 128 plus the number of the signal that ended the verb.\n"
    )


def pages() -> dict[str, str]:
    """Markdown by path."""
    return {f"reference/verbs/{verb}.md": _page(parser_of(verb)[0]) for verb in VERBS}


def _page(parser: argparse.ArgumentParser, level: int = 1) -> str:
    parts = [f"{'#' * level} {parser.prog}", _plain(parser.description or "")]
    if example := (parser.epilog or "").partition("example:")[2].strip():
        reason = "an example of the form; the files are the reader's"
        parts.append(f"<!-- not run: {reason} -->\n```sh\n{example}\n```")
    formatter = argparse.HelpFormatter(parser.prog, width=88)
    formatter.add_usage(parser.usage, parser._actions, parser._mutually_exclusive_groups, prefix="")
    parts.append(f"```text\n{formatter.format_help().strip()}\n```")
    own = [a for a in parser._actions if not isinstance(a, argparse._SubParsersAction | argparse._HelpAction)]
    rows = [_row(formatter, action) for action in own if action.help is not argparse.SUPPRESS]
    if rows:
        parts.append("\n".join(["| option | meaning |", "| --- | --- |", *rows]))
    schema = SCHEMAS / f"{parser.prog.removeprefix('vpp ').replace(' ', '-')}.json"
    if schema.is_file():
        parts.append(_object(json.loads(schema.read_text(encoding="utf-8")), level + 1))
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            parts.extend(_page(below, level + 1) for below in dict.fromkeys(action.choices.values()))
    return "\n\n".join(parts) + "\n"


def _object(schema: dict, level: int) -> str:
    """The object of --json as a table, from its JSON Schema."""
    rows = [
        f"| `{name}` | {_cell(_kind(each))} | {_cell(_plain(each.get('description', '')))}"
        f"{' (optional)' if name not in schema['required'] else ''} |"
        for name, each in schema["properties"].items()
    ]
    about = _plain(schema["title"].partition(": ")[2])
    return "\n".join([f"{'#' * level} With --json", "", f"{about[0].upper()}{about[1:]}.", "", *HEAD, *rows])


HEAD = ("| key | type | meaning |", "| --- | --- | --- |")


def _kind(schema: dict) -> str:
    """The type of a value in words."""
    if "const" in schema or "enum" in schema:
        return " or ".join(f"`{value}`" for value in schema.get("enum", [schema.get("const")]))
    kinds = schema["type"] if isinstance(schema["type"], list) else [schema["type"]]
    of = schema.get("items", {}).get("type")
    return " or ".join(f"{kind} of {of}s" if kind == "array" and isinstance(of, str) else kind for kind in kinds)


def _row(formatter: argparse.HelpFormatter, action: argparse.Action) -> str:
    text = formatter._expand_help(action) if action.help else ""
    name = formatter._format_action_invocation(action)
    return f"| `{_cell(name)}` | {_cell(_plain(text))} |"


def _cell(text: str) -> str:
    return " ".join(text.split()).replace("|", "\\|")


def _plain(text: str) -> str:
    """Text with the special characters of Markdown escaped."""
    return re.sub(r"(`[^`\n]*`)|([*_<>\[\]])", lambda m: m[1] or f"\\{m[2]}", text)
