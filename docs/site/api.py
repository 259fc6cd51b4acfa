"""The page of Python names: `vpp_fmu.__all__`, results, environments and policies, from their docstrings."""

from collections.abc import Iterable

import vpp_fmu

PAGE = "reference/api.md"

RESULTS = {
    "CheckResult": "check",
    "IdentifyResult": "identification",
    "DiagnoseResult": "diagnosis",
    "PlanResult": "plan",
    "TuneResult": "tuning",
    "SimulateResult": "loop",
    "LoopResult": "loop",
}
"""Module of each result."""

POLICIES = ("Policy", "policy_from_arrays", "read_policy")

READERS = tuple(name for name in vpp_fmu.__all__ if vpp_fmu._HOME[name] == "vpp_fmu.app.api.objects")
VERBS = tuple(name for name in vpp_fmu.__all__ if vpp_fmu._HOME[name].startswith("vpp_fmu.app.") and name not in READERS)
CLASSES = tuple(name for name in vpp_fmu.__all__ if name not in (*VERBS, *READERS))


def page() -> str:
    """The Markdown."""
    return "\n\n".join(
        [
            "# Python",
            "`import vpp_fmu as vpp` is all that a script needs. Units are rpm, deg, N and s. Bad input raises a `BadInput` "
            "with one line: the file, the field, the value found and the values allowed. The examples below run as tests.",
            "## Verbs",
            *_named(VERBS),
            "## Files",
            *_named(READERS),
            "## Classes",
            *_named(CLASSES),
            "## Results",
            "Each verb returns one of these. All print key figures, and have the members of `Result`.",
            _entry("vpp_fmu.app.report.result.Result", "Result"),
            *(_entry(f"vpp_fmu.app.report.pages.{home}.{name}", name) for name, home in RESULTS.items()),
            _entry("vpp_fmu.linear.Linearisable", "Linearisable"),
            "## Environments",
            "`import vpp_fmu.gym` (extra `gym`) registers `VppThrust-v0`.",
            "<!-- include vpp_fmu/gym/README.md -->",
            *(_entry(f"vpp_fmu.gym.{home}.{name}", f"gym.{name}") for home, name in _environments()),
            "## Learned laws",
            *(_entry(f"vpp_fmu.policy.{name}", f"policy.{name}") for name in POLICIES),
        ]
    )


def _environments() -> Iterable[tuple[str, str]]:
    return (
        ("task", "Task"),
        ("reward", "Reward"),
        ("reward", "Moment"),
        ("envs", "VppThrustEnv"),
        ("envs", "VppThrustVectorEnv"),
    )


def _named(names: Iterable[str]) -> list[str]:
    return [_entry(f"{vpp_fmu._HOME[name]}.{name}", f"vpp.{name}") for name in names]


def _entry(path: str, heading: str) -> str:
    return f"::: {path}\n    options:\n      heading: {heading}\n      toc_label: {heading}"
