"""What the verbs share: where they write, and what they say at the end."""

import json

from vpp_fmu.files import OutputFolder


def add_output(parser) -> None:
    """The option -o."""
    parser.add_argument("-o", "--output", default="out", metavar="DIR", help="folder to write to (default: out)")


def as_json(content: dict) -> str:
    """JSON as this project writes it. What is not known is null where the number is made: NaN here is a program's fault."""
    return json.dumps(content, indent=2, allow_nan=False) + "\n"


def say_written(folder: OutputFolder) -> None:
    """Where the results are, and what they took the place of."""
    if folder.replaced:
        print(f"replaced in {folder.path}: {', '.join(folder.replaced)}")
    print(f"written to {folder.path}")
