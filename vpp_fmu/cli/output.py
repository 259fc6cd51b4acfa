"""What the verbs share: where they write, and what they say at the end."""

import json

from vpp_fmu.files import OutputFolder


def add_output(parser) -> None:
    """The option -o."""
    parser.add_argument("-o", "--output", default="out", metavar="DIR", help="folder to write to (default: out)")


def add_accept(parser) -> None:
    """The option that overrides the quality gate."""
    text = "go on in spite of a finding of the quality gate, by its code, and keep its rows; may be repeated (vpp check --help)"
    parser.add_argument("--accept", action="append", default=[], metavar="CODE", help=text)


def as_json(content: dict) -> str:
    """JSON as this project writes it."""
    return json.dumps(content, indent=2) + "\n"


def say_written(folder: OutputFolder) -> None:
    """Where the results are, and what they took the place of."""
    if folder.replaced:
        print(f"replaced in {folder.path}: {', '.join(folder.replaced)}")
    print(f"written to {folder.path}")
