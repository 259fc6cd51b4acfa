"""A page for each verb of the command, from its parser."""

import argparse
import re

from vpp_fmu.app.cli import VERBS, parser_of

INDEX = "reference/verbs/index.md"


def index() -> str:
    """The list of verbs."""
    rows = "\n".join(f"| [`vpp {verb}`]({verb}.md) | {text} |" for verb, text in VERBS.items())
    return (
        "# Command line\n\n"
        "Each verb has its own page. `vpp VERB --help` prints the same text: both come from the parser.\n\n"
        f"| verb | purpose |\n| --- | --- |\n{rows}\n\n"
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
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            parts.extend(_page(below, level + 1) for below in dict.fromkeys(action.choices.values()))
    return "\n\n".join(parts) + "\n"


def _row(formatter: argparse.HelpFormatter, action: argparse.Action) -> str:
    text = formatter._expand_help(action) if action.help else ""
    name = formatter._format_action_invocation(action)
    return f"| `{_cell(name)}` | {_cell(_plain(text))} |"


def _cell(text: str) -> str:
    return " ".join(text.split()).replace("|", "\\|")


def _plain(text: str) -> str:
    """Text as Markdown that shows it as it is."""
    return re.sub(r"(`[^`\n]*`)|([*_<>\[\]])", lambda m: m[1] or f"\\{m[2]}", text)
