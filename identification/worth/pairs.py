"""The two time constants of a channel, which no response tells apart by name: an agreed order, and forms without names."""

from collections.abc import Mapping

import numpy as np

from identification.fit.coordinates import CHANNELS
from identification.fit.uncertainty import Uncertainty


def slow_first(values: Mapping[str, float]) -> dict[str, float]:
    """`values` with each channel's time constants sorted, the slower first."""
    values = dict(values)
    for channel in CHANNELS:
        pair = f"tau_{channel}_1", f"tau_{channel}_2"
        values.update(zip(pair, sorted((values[n] for n in pair), reverse=True), strict=True))
    return values


def forms(doubt: Uncertainty) -> dict:
    """Each channel's time constants in the forms that the data tell best: sorted, their sum [s] and product [s^2]."""
    found = {}
    for channel in CHANNELS:
        pair = [f"tau_{channel}_1", f"tau_{channel}_2"]
        if not set(pair) <= set(doubt.names):
            continue
        at = [doubt.names.index(n) for n in pair]
        a, b = doubt.values[at]
        gradients = {"sum": (a + b, (1.0, 1.0)), "product": (a * b, (b, a))}
        found[channel] = {"sorted": sorted((float(a), float(b)), reverse=True)}
        for form, (value, slopes) in gradients.items():
            gradient = np.zeros(len(doubt.names))
            gradient[at] = slopes
            found[channel][form] = {"value": float(value), "std": doubt.of(gradient)}
    return found
