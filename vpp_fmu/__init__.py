"""Measured data of a variable-pitch propeller rig to a model, what the model lacks, and FMUs: `import vpp_fmu as vpp`.

Every public name stands in `__all__`, and is imported when it is first used; `import vpp_fmu` itself takes milliseconds. Units
are rpm, deg, N and s throughout. Whatever is wrong with a file, a field or an argument is a `BadInput` of one line.
"""

from importlib import import_module

_HOMES = {
    "vpp_fmu.api.objects": ("example_campaign", "read_campaign", "read_parameters", "read_record"),
    "vpp_fmu.api.verbs": (
        "check",
        "diagnose",
        "export_fmu",
        "identify",
        "plan",
        "run_loop",
        "simulate",
        "tune",
        "write_report",
    ),
    "vpp_fmu.campaign": ("Campaign",),
    "vpp_fmu.errors": ("BadInput", "VppError"),
    "vpp_fmu.kernel.types": ("Effect", "Parameter", "State"),
    "vpp_fmu.parameters": ("ParameterSet",),
    "vpp_fmu.record": ("Record",),
    "vpp_fmu.rig": ("Rig",),
}
_HOME = {name: module for module, names in _HOMES.items() for name in names}

__all__ = [
    "BadInput",
    "Campaign",
    "Effect",
    "Parameter",
    "ParameterSet",
    "Record",
    "Rig",
    "State",
    "VppError",
    "check",
    "diagnose",
    "example_campaign",
    "export_fmu",
    "identify",
    "plan",
    "read_campaign",
    "read_parameters",
    "read_record",
    "run_loop",
    "simulate",
    "tune",
    "write_report",
]


def __getattr__(name: str):
    if name == "__version__":
        value = _version()
    elif name in _HOME:
        value = getattr(import_module(_HOME[name]), name)
    else:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__, "__version__"})


def _version() -> str:
    """Asked for only when it is wanted: reading it takes as long as importing all else."""
    from importlib.metadata import PackageNotFoundError, version  # noqa: PLC0415

    try:
        return version("vpp-fmu")
    except PackageNotFoundError:  # run from a source tree that was never installed
        return "not installed"
