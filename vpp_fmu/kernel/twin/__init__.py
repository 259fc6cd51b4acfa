"""The adaptive twin: a plant that runs beside the rig, adapts to its readings, and raises an alarm if it can't.

    x, T = plant(x, u, p),   p = p0 + change theta                          the plant's own step, with its derivatives in theta
    reading = T + n1 + n2 + sum(f_k h_k) + w,   n1 = a1 n1 + q1,   n2 = a2 n2 + q2

is an extended Kalman filter in (theta, n1, n2, f) (Ljung, IEEE Trans. Automatic Control 24, 1979), one reading after the other.
n1 is the reading's slow noise and what the model is off while thrust moves, and fades in time. f is what the model is off at
the nodes of a grid over the thrust map, h the weights of linear interpolation between them: it stays, so that a rig that comes
back to a place tells no more of theta than before, and one that comes back to find another error there has changed. n2 is what
the interpolation leaves; its a2 = exp(-distance / PLACE) counts how far the operating point has gone, so that a set-point
that never moves gives no more information than one visit. After an alarm the parameters that are monitored for changes adapt.
What is not, a lag, is forgotten instead, by distance as well, and as far as it is excited (after Kulhavy and Karny, 9th IFAC
World Congress, 1984): as far as a plausible change of it, 1, would show in the reading, whose innovation has the variance S,

    P <- D P D,   D_i^2 = 1 + distance / memory  g_i^2 / (g_i^2 + S),   g = d T / d theta

and P stays below a plausible change's, 1. The speed's reading is another one of theta, of white noise, at each of its new
values.

Six effects, one idea each; whoever reads a state of another one does so by a signal.
"""

from vpp_fmu.kernel.twin.model import DAILY, adapted_by_default, plausible_change, twin
from vpp_fmu.kernel.twin.noises import (
    BETWEEN,
    BLOCK,
    HALVES,
    NODE,
    NODES,
    ON_THE_WAY,
    PLACE,
    SPEED_ON_THE_WAY,
    TOLERATED,
    WITHIN,
)
from vpp_fmu.kernel.twin.prediction import BROUGHT
from vpp_fmu.kernel.twin.watch import sums, threshold, watched

__all__ = [
    "BETWEEN",
    "BLOCK",
    "BROUGHT",
    "DAILY",
    "HALVES",
    "NODE",
    "NODES",
    "ON_THE_WAY",
    "PLACE",
    "SPEED_ON_THE_WAY",
    "TOLERATED",
    "WITHIN",
    "adapted_by_default",
    "plausible_change",
    "sums",
    "threshold",
    "twin",
    "watched",
]
