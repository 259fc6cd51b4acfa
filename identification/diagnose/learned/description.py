"""Describe a learned term: in words, in diagnosis.json, and as a file for `--effects-from`."""

import numpy as np

from identification.diagnose.learned.laws import curve_of
from identification.diagnose.learned.learn import Learned
from identification.diagnose.learned.refit import Term
from vpp_fmu.digits import number
from vpp_fmu.kernel.learned import DRIVERS, PORTS, SHAPES
from vpp_fmu.kernel.scales import Scales

FILE = "learned_effect.py"

NO_EFFECT = 2.0
"""Standard errors within which the value of a curve counts as zero."""


def sentence(term: Term) -> str:
    """Port, driver and shape of a term, in words."""
    port, driver, values = PORTS[term.lead.port], DRIVERS[term.lead.driver], term.values
    if term.lead.shape == "sine":
        size = float(np.hypot(values["in_phase"], values["quadrature"]))
        turns = f"{number(values['frequency'], 3)} Hz"
        return f"enters at {port.words}: a sine of {number(size, 3)} {port.unit} at {turns}, locked to the record's start"
    lag = f" through a lag of {number(values['lag'], 2)} s" if "lag" in values else ""
    times = ", times the square of speed" if term.lead.times else ""
    return f"enters at {port.words}, driven by {driver.words}{lag}{times}: {_shape_words(term, port.unit, driver.unit)}"


def _shape_words(term: Term, unit: str, driver_unit: str) -> str:
    values, shape = term.values, term.lead.shape
    if shape == "curve":
        return _curve(term, unit, driver_unit)
    gain = next(p for p in term.effect.parameters if p.name == "gain")
    size = f"{number(values['gain'], 3)} {gain.unit}".removesuffix(" 1")

    def at(name):
        return f"{number(values[name], 3)} {driver_unit}".removesuffix(" 1")

    return {
        "line": lambda: f"in proportion, {size}",
        "square": lambda: f"with its square, {size}",
        "hinge": lambda: (
            f"no effect {'below' if values['side'] > 0.0 else 'above'} {at('knee')}, from there in proportion, {size}"
        ),
        "threshold": lambda: f"a step of {size} above {at('level')}",
        "saturation": lambda: f"in proportion, {size}, up to {at('limit')}",
        "sign": lambda: f"with its sign, {size}",
        "play": lambda: f"a play of {at('half_gap')} to each side, {size} times the difference",
        "hold": lambda: f"changes up to {at('half_width')} are ignored, {size} of them",
        "relay": lambda: f"{size} from above {at('upper')} until below {at('lower')}",
    }[shape]()


def _curve(term: Term, unit: str, driver_unit: str) -> str:
    at, f, std = curve_of(term)
    ends = [f"{number(f[k], 3)} {unit}".removesuffix(" 1") + f" at {number(at[k], 3)} {driver_unit}" for k in (0, -1)]
    words = f"from {ends[0]} to {ends[1]}"
    none = np.abs(f) <= np.maximum(NO_EFFECT * std, 1e-3 * np.abs(f).max())
    if none[0] and none[1] and not none.all():
        return f"no effect below {number(at[np.argmin(none) - 1], 2)} {driver_unit}, {ends[1]}"
    if none[-1] and none[-2] and not none.all():
        return f"no effect above {number(at[len(at) - np.argmin(none[::-1])], 2)} {driver_unit}, {ends[0]}"
    k = int(np.argmax(np.abs(f)))
    if 0 < k < len(at) - 1:
        words += f", largest, {number(f[k], 3)} {unit}".removesuffix(" 1") + f", at {number(at[k], 3)} {driver_unit}"
    return words


def rival_words(term: Term) -> str:
    """Port and driver, in few words."""
    return f"{PORTS[term.lead.port].words} by {DRIVERS[term.lead.driver].words}"


def block(found: Learned, std: dict[str, float | None]) -> dict:
    """Part of diagnosis.json. `std`: standard errors by full name."""
    term, effect = found.term, found.term.effect
    units = {p.name: p.unit for p in effect.parameters}
    parameters = {
        n: {"value": v, "std": std.get(effect.full(n)), "unit": units[n]} for n, v in term.values.items() if n != "lag"
    }
    lag = term.values.get("lag")
    figures = {
        "port": term.lead.port,
        "driver": term.lead.driver,
        "lag": None if lag is None else {"value": lag, "std": std.get(effect.full("lag")), "unit": "s"},
        "shape": term.lead.shape,
        "times": term.lead.times or None,
        "parameters": parameters,
        "range": {"from": term.lead.span[0], "to": term.lead.span[1], "unit": DRIVERS[term.lead.driver].unit},
        "file": FILE,
        "sentence": sentence(term),
    }
    if found.curve.lead.shape == "curve":
        at, f, std = curve_of(found.curve)
        figures["curve"] = {"at": at.tolist(), "value": f.tolist(), "std": std.tolist()}
    figures["laws"] = [{"law": name, "evidence_over_curve": evidence} for name, evidence in found.laws]
    figures["could_also_be"] = [
        {"port": t.lead.port, "driver": t.lead.driver, "shape": t.lead.shape, "lag": t.values.get("lag")} for t in found.rivals
    ]
    return figures


def source(term: Term, scales: Scales, campaign: str) -> str:
    """The effect as a Python file. Numbers have all digits: a value may equal its bound, which depends on the range."""
    lead = term.lead
    lines = "".join(f'        "{n}": {float(v)!r},\n' for n, v in term.values.items() if n not in ("lag", "form"))
    lag = f"    lag={float(term.values['lag'])!r},\n" if "lag" in term.values else ""
    times = f'    times="{lead.times}",\n' if lead.times else ""
    form = f"    form={term.values['form']!r},\n" if "form" in term.values else ""
    span = tuple(map(float, lead.span))
    sizes = ", ".join(f"{n}={getattr(scales, n)!r}" for n in vars(scales))
    return f'''"""Learned from {campaign} by vpp diagnose: a term that {sentence(term)}.

{_equation(term)}
Beyond the range of the data it keeps its end values. Give it another name below. Pass this file to `--effects-from`: in vpp
diagnose it is a candidate; in vpp export and vpp simulate it is used by parameters that name it.
"""

from vpp_fmu.kernel.learned import learned
from vpp_fmu.kernel.scales import Scales

PORT = "{lead.port}"

EFFECT = learned(
    "{term.effect.name}",
    port=PORT,
    driver="{lead.driver}",
    shape="{lead.shape}",
    values={{
{lines}    }},
    span={span!r},
{lag}{times}{form}    scales=Scales({sizes}),
)
'''


def _equation(term: Term) -> str:
    port, driver = PORTS[term.lead.port], DRIVERS[term.lead.driver]
    line = SHAPES[term.lead.shape].equation
    how = "port * (1 + f)" if port.name.endswith("share") else "port + f"
    return f"    f = {line},   port <- {how}\n    v: {driver.words} [{driver.unit}]; f [{port.unit}]\n"
