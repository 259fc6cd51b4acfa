"""The two interchangeable time constants of a channel: a conventional order, and functions that do not depend on the order."""

from collections.abc import Mapping

import numpy as np

from identification.fit.coordinates import CHANNELS
from identification.fit.uncertainty import Uncertainty
from vpp_fmu.kernel.types import Model
from vpp_fmu.native import Simulator
from vpp_fmu.record import Record

SAME = 1e-7
"""Share of a response's range that counts as rounding error between two orders."""


def slow_first(values: Mapping[str, float]) -> dict[str, float]:
    """`values` with each channel's time constants sorted, slower first."""
    values = dict(values)
    for channel in CHANNELS:
        pair = f"tau_{channel}_1", f"tau_{channel}_2"
        values.update(zip(pair, sorted((values[n] for n in pair), reverse=True), strict=True))
    return values


def exchangeable(model: Model, values: Mapping[str, float], record: Record, channel: str) -> bool:
    """Whether the response to a record is the same if the two lags of a channel are exchanged.

    Two successive lags have the same response in either order, to rounding. An effect between them makes the order
    identifiable.
    """
    pair = f"tau_{channel}_1", f"tau_{channel}_2"
    swapped = {**values, pair[0]: values[pair[1]], pair[1]: values[pair[0]]}
    simulator = Simulator(model)
    one, other = (simulator.simulate(v, *record.run) for v in (values, swapped))
    return bool(np.all(np.abs(one - other) <= SAME * np.ptp(one, axis=0) + 1e-12))


def agreed_order(model: Model, values: Mapping[str, float], record: Record) -> dict[str, str]:
    """New names of a model's lags by the old ones: the slower first if their order is not identifiable."""
    renamed = {}
    for channel in CHANNELS:
        pair = f"tau_{channel}_1", f"tau_{channel}_2"
        if values[pair[0]] < values[pair[1]] and exchangeable(model, values, record, channel):
            renamed |= {pair[0]: pair[1], pair[1]: pair[0]}
    return renamed


def forms(uncertainty: Uncertainty) -> dict:
    """Well identified functions of each channel's time constants: sorted values, sum [s] and product [s^2]."""
    found = {}
    for channel in CHANNELS:
        pair = [f"tau_{channel}_1", f"tau_{channel}_2"]
        if not set(pair) <= set(uncertainty.names):
            continue
        at = [uncertainty.names.index(n) for n in pair]
        a, b = uncertainty.values[at]
        gradients = {"sum": (a + b, (1.0, 1.0)), "product": (a * b, (b, a))}
        found[channel] = {"sorted": sorted((float(a), float(b)), reverse=True)}
        for form, (value, slopes) in gradients.items():
            gradient = np.zeros(len(uncertainty.names))
            gradient[at] = slopes
            found[channel][form] = {"value": float(value), "std": uncertainty.of(gradient)}
    return found
