"""From measured data of a variable-pitch propeller rig to a model, its missing effects, and FMUs: `import vpp_fmu as vpp`.

`__all__` lists the public names. Each is imported at its first use, so `import vpp_fmu` takes milliseconds. Units are rpm, deg,
N and s throughout. An invalid file, field or argument raises a `BadInput` with a message of one line.
"""

from importlib import import_module

_HOMES = {
    "vpp_fmu.app.api.objects": ("example_campaign", "read_campaign", "read_parameters", "read_record"),
    "vpp_fmu.app.api.check": ("check",),
    "vpp_fmu.app.api.control": ("allocate", "learn", "tune"),
    "vpp_fmu.app.api.diagnose": ("diagnose",),
    "vpp_fmu.app.api.export": ("export_fmu",),
    "vpp_fmu.app.api.identify": ("identify",),
    "vpp_fmu.app.api.loop": ("run_loop", "simulate"),
    "vpp_fmu.app.api.plan": ("plan",),
    "vpp_fmu.app.report.result": ("write_report",),
    "vpp_fmu.campaign": ("Campaign",),
    "vpp_fmu.errors": ("BadInput", "VppError"),
    "vpp_fmu.kernel.slave": ("Slave",),
    "vpp_fmu.kernel.types": ("Effect", "Model", "Parameter", "Signal", "State", "instance"),
    "vpp_fmu.parameters": ("ParameterSet",),
    "vpp_fmu.record": ("Record",),
    "vpp_fmu.rig": ("Rig",),
}
_HOME = {name: module for module, names in _HOMES.items() for name in names}

__all__ = [
    "BadInput",
    "Campaign",
    "Effect",
    "Model",
    "Parameter",
    "ParameterSet",
    "Record",
    "Rig",
    "Signal",
    "Slave",
    "State",
    "VppError",
    "allocate",
    "check",
    "diagnose",
    "example_campaign",
    "export_fmu",
    "identify",
    "instance",
    "learn",
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
    """Read at its first use only: that takes as long as all other imports together."""
    from importlib.metadata import PackageNotFoundError, version  # noqa: PLC0415

    try:
        return version("vpp-fmu")
    except PackageNotFoundError:  # run from a source tree that was never installed
        return "not installed"
