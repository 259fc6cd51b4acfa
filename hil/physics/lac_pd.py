"""The LAC's PD controller, from the actuator's position error to its motor's drive (paper, section 2.2; kp = kd = 10 in 3.1).

    drive = clip(kp (beta_ref - rod) / travel - kd period rate / travel, -1, 1)

The paper gives no units. Here an error is a share of the whole travel, like the LAC's 0 to 1023 counts, and a rate is the share
covered in one period of the board (1 ms, chosen). So kp = 10 gives full drive from an error of a tenth of the travel on. The
paper's PD also acts on the rate of the command, but then neglects it (d beta_ref/dt = 0); a held command has none. The error is
extrapolated to the middle of the step with the rate at its start.
"""

from vpp_fmu.kernel.types import Effect, Parameter


def _step(ops, s, x, p, dt):
    travel = s.actuator.beta_high - s.actuator.beta_low
    goal = ops.clip(s.beta_ref, s.actuator.beta_low, s.actuator.beta_high)
    error = goal - s.rod - 0.5 * dt * s.rod_rate
    wanted = (p.kp_lac * error - p.kd_lac * p.lac_period * s.rod_rate) / travel
    return {"pitch_error": goal - s.rod, "travel": travel, "drive": ops.clip(wanted, -1.0, 1.0)}, {}


LAC = Effect(
    "lac",
    "the LAC's position control",
    _step,
    parameters=(
        Parameter("kp_lac", "1", 10.0, 0.0, 1000.0, "drive per share of the travel (paper; unit chosen)", 10.0),
        Parameter("kd_lac", "1", 10.0, 0.0, 1000.0, "drive per share of the travel in one period (paper; unit chosen)", 10.0),
        Parameter("lac_period", "s", 0.001, 1e-5, 0.1, "period of the board (chosen)", 0.001),
    ),
)
