"""The adaptive twin: a plant model that runs beside the rig, adapts to its readings, and raises an alarm if it can't.

    x, T = plant(x, u, p),   p = p0 + change theta                          the plant's own step, with its derivatives in theta
    reading = T + n1 + n2 + sum(f_k h_k) + w,   n1 = a1 n1 + q1,   n2 = a2 n2 + q2

An extended Kalman filter estimates (theta, n1, n2, f) from one reading after the other (Ljung, IEEE Trans. Automatic Control
24, 1979).

n1 is the slow noise of the reading and the model error while thrust moves; it decays in time. f is the model error at the
nodes of a grid over the thrust map, h are the weights of linear interpolation between them. f is constant: a rig that returns
to a place gives no new information about theta, and if the error there differs from before, the rig has changed. n2 is the
error of the interpolation. Its a2 = exp(-distance / PLACE) depends on the distance of the operating point, so a set-point that
never moves gives no more information than one visit. After an alarm the parameters that are monitored for changes adapt.

Lags are not monitored. Their information is forgotten with the distance instead, as far as they are excited (after Kulhavy and
Karny, 9th IFAC World Congress, 1984). A plausible change of a lag is 1, and S is the variance of the reading's innovation:

    P <- D P D,   D_i^2 = 1 + distance / memory  g_i^2 / (g_i^2 + S),   g = d T / d theta

P is at most 1, the variance of a plausible change. The speed reading, with white noise, also updates theta whenever it has a
new value.

The twin is six effects, one idea each; an effect reads another's state through a signal.
"""
