"""python -m tests.studies NAME [options]: the quality of the estimates, on data whose truth is known.

A study prints its results beside its aims. NAME is one of the modules of this folder.
"""

import argparse

from . import (
    adaptive,
    api,
    commands,
    days,
    degenerate,
    diagnosis,
    energy,
    exits,
    fleet,
    fmus,
    fuzz,
    gate,
    identification,
    imports,
    learned,
    loggers,
    long,
    measured,
    mutations,
    paper,
    policy,
    power,
    power_residual,
    readings,
    refusals,
    rigs,
    rules,
    size,
    tuning,
    twin,
)

STUDIES = {
    "adaptive": adaptive.main,
    "api": api.main,
    "commands": commands.main,
    "days": days.main,
    "degenerate": degenerate.main,
    "diagnosis": diagnosis.main,
    "energy": energy.main,
    "exits": exits.main,
    "fleet": fleet.main,
    "fmus": fmus.main,
    "fuzz": fuzz.main,
    "gate": gate.main,
    "identification": identification.main,
    "imports": imports.main,
    "learned": learned.main,
    "loggers": loggers.main,
    "long": long.main,
    "measured": measured.main,
    "mutations": mutations.main,
    "paper": paper.main,
    "policy": policy.main,
    "power": power.main,
    "power_residual": power_residual.main,
    "readings": readings.main,
    "refusals": refusals.main,
    "rigs": rigs.main,
    "rules": rules.main,
    "size": size.main,
    "tuning": tuning.main,
    "twin": twin.main,
}


def main():
    parser = argparse.ArgumentParser(prog="python -m tests.studies", description=__doc__, add_help=False)
    parser.add_argument("study", choices=STUDIES)
    chosen, options = parser.parse_known_args()
    STUDIES[chosen.study](options)


main()
