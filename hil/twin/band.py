"""The thrust residual of an identified model in normal operation: standard deviations of the noise and of the model error."""

import os
from dataclasses import dataclass
from math import inf, sqrt

from vpp_fmu.errors import BadInput
from vpp_fmu.kernel.twin.noises import SLOW_TIME
from vpp_fmu.structured import read_object

SLOW_SHARE = 0.37
"""Share of slow noise in the standard deviation. Repeated runs of four rigs have 0.36 to 0.38."""


@dataclass(frozen=True)
class Band:
    """Noise of one reading, standard deviations: `white` [N], and `slow` [N] with the correlation time `slow_time` [s].

    Model error over half a second, standard deviations: `steady` [N] while commands are constant, estimated with `freedom`
    degrees of freedom, and in addition `moving` [1] per N of change of the model's thrust.
    """

    white: float
    slow: float
    slow_time: float
    steady: float
    moving: float = 0.0
    freedom: float = inf

    @property
    def noise(self) -> float:
        """Standard deviation of one reading, N."""
        return sqrt(self.white**2 + self.slow**2)


def read_band(path: str | os.PathLike) -> Band:
    """Read the band from identification.json of `vpp identify` or `vpp diagnose`. BadInput names a missing entry."""
    allowed = "noise_floor_thrust and model_error, as vpp identify writes them"
    content = read_object(path, allowed=allowed)
    try:
        floor, error = float(content["noise_floor_thrust"]), content["model_error"]
        if error is None:
            found = "null: neither a static map nor a repeat determined it"
            raise BadInput(
                path, "model_error", found, "the model error of an identification with a static.csv: the twin's band needs it"
            )
        steady, moving, freedom = (float(error[name]) for name in ("steady", "moving", "freedom"))
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise BadInput(path, "content", f"{type(error).__name__}: {error}", allowed) from error
    if not all(0.0 < number < inf for number in (floor, steady, freedom)) or not 0.0 <= moving < inf:
        found = f"{floor}, {error}"
        raise BadInput(path, "noise_floor_thrust, model_error", found, "finite numbers above 0")
    return Band(floor * sqrt(1.0 - SLOW_SHARE**2), floor * SLOW_SHARE, SLOW_TIME, steady, moving, freedom)
