"""Print a script with which a shell completes verbs, options, files and choices.

bash: eval "$(vpp completion bash)" in ~/.bashrc. zsh: vpp completion zsh > _vpp in a folder of fpath. fish: vpp completion fish
> ~/.config/fish/completions/vpp.fish. Verbs of installed packages are included; run it again after installing one."""

import argparse

import shtab

from vpp_fmu.app.cli import known_verbs, parser_of

EXAMPLE = 'eval "$(vpp completion bash)"'

SHELLS = ("bash", "zsh", "fish")


def configure(parser):
    parser.add_argument("shell", choices=SHELLS, help="the shell that the script is for")


def run(options):
    print(shtab.complete(whole_parser(), options.shell))


def whole_parser() -> argparse.ArgumentParser:
    """One parser of all verbs; `vpp` itself reads one verb's options alone, so that it starts fast."""
    whole = argparse.ArgumentParser("vpp", description="Rig data to FMUs.")
    whole.add_argument("--version", action="store_true", help="print the version")
    verbs = whole.add_subparsers()
    for verb, text in known_verbs().items():
        parser, _ = parser_of(verb)
        verbs.add_parser(verb, help=text, parents=[parser], add_help=False, description=text)
    return whole
