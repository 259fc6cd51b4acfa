"""python -m tests.studies NAME [options]: the quality of the estimates, on data whose truth is known.

A study prints its results beside its aims. NAME is one of the modules of this folder.
"""

import argparse
from importlib import import_module

STUDIES = ("diagnosis", "fuzz", "hidden", "identification", "learned", "loggers", "measured", "paper", "size", "variation")


def main():
    parser = argparse.ArgumentParser(prog="python -m tests.studies", description=__doc__, add_help=False)
    parser.add_argument("study", choices=STUDIES)
    chosen, options = parser.parse_known_args()
    study = import_module(f"tests.studies.{chosen.study}")
    lines = argparse.RawDescriptionHelpFormatter
    study.main(argparse.ArgumentParser(f"{parser.prog} {chosen.study}", None, study.__doc__, formatter_class=lines), options)


main()
