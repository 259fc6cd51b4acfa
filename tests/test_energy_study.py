"""The study of energy: its reference is a lower bound, and one rig shows the result of the study."""

import numpy as np
import pytest
from studies.energy import Truth, compared, reference

from vpp_fmu.kernel.plant import FINE_TUNED


def test_the_reference_is_the_closed_form():
    """Thrust 15 c w^2 b N and power p w^3 (1 + 4 b^2) W: at a given w^2 b the least is at b^2 = 3 / 4."""
    values = {**dict.fromkeys(FINE_TUNED, 0.0), "c21": 0.8}
    truth = Truth(values, disc=1e12, profile=40.0, best=0.0, efficiency=1.0, idle=0.0)
    thrust = np.array([3.0, 6.0, 9.0])
    b = np.sqrt(0.75)
    w = np.sqrt(thrust / (15.0 * 0.8 * b))
    assert reference(truth, thrust) == pytest.approx(float((40.0 * w**3 * (1.0 + 4.0 * b**2)).sum()) * 0.004, rel=1e-3)


def test_no_law_takes_less_and_the_allocated_one_hardly_more():
    done, least = compared(0)
    allocated, dual = done["allocated"], done["dual PID (paper)"]
    assert 0.999 * least < allocated.energy < 1.02 * least
    assert dual.energy > allocated.energy
    assert np.median(allocated.settling) <= np.median(dual.settling)
