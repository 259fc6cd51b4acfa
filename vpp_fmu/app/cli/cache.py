"""Show the compiled models that are kept for the next run, or delete them. The least recently used are deleted first."""

from vpp_fmu.app.cli.answer import Answer
from vpp_fmu.native.compiler import LARGEST, cache_folder, clear, kept

EXAMPLE = "vpp cache --clear"


def configure(parser):
    parser.add_argument("--clear", action="store_true", help="delete all; the next run compiles again")


def run(options):
    sizes = [status.st_size for _, status in kept()]
    if options.clear:
        clear()
    deleted = ", deleted" if options.clear else ""
    held = "1 library" if len(sizes) == 1 else f"{len(sizes)} libraries"
    text = f"{cache_folder()}: {held}, {sum(sizes) / 2**20:.1f} MB{deleted}, {LARGEST / 2**20:.0f} MB at most"
    content = {"format": "vpp-cache/1", "folder": str(cache_folder()), "libraries": len(sizes), "bytes": sum(sizes)}
    return Answer(text, content | {"most_bytes": LARGEST, "deleted": options.clear})
