"""The page of Python names: `vpp_fmu.__all__`, results, environments and policies, from their docstrings."""

from collections.abc import Iterable

import vpp_fmu

PAGE = "reference/api.md"

RESULTS = (
    "Result",
    "CheckResult",
    "IdentifyResult",
    "DiagnoseResult",
    "PlanResult",
    "TuneResult",
    "SimulateResult",
    "LoopResult",
)
POLICIES = ("Policy", "policy_from_arrays", "read_policy")

VERBS = tuple(name for name in vpp_fmu.__all__ if vpp_fmu._HOME[name] == "vpp_fmu.app.api.verbs")
READERS = tuple(name for name in vpp_fmu.__all__ if vpp_fmu._HOME[name] == "vpp_fmu.app.api.objects")
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
            *(_entry(f"vpp_fmu.app.api.results.{name}", name) for name in RESULTS),
            _entry("vpp_fmu.app.api.linear.Linearisable", "Linearisable"),
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
