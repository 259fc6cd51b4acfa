"""The content of paper.json."""

from dataclasses import asdict

from vpp_fmu.paper.page import verdict
from vpp_fmu.paper.rows import compared
from vpp_fmu.paper.study import Study


def summary(study: Study, total: float) -> dict:
    """Every row of the comparison, the step tests in numbers, and the seconds; `total`: of the whole."""
    tests = [
        asdict(loop) | {way: asdict(merit) for way, merit in zip(("up", "down"), merits, strict=True)}
        for loop, merits in study.control.merits.items()
    ]
    return {
        "format": "vpp-paper/1",
        "verdict": verdict(study),
        "seed": study.seed,
        "plan": asdict(study.plan) | {"as_the_paper": study.is_full},
        "rows": [row.summary() for row in compared(study).values()],
        "step_tests": tests,
        "seconds": dict(study.seconds) | {"total": total},
    }
