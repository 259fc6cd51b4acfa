"""Commands for the rig's physical models."""

import numpy as np


def commands(model, rows, seed=0):
    """Random steps over the rig's range, each held for up to a fifth of the rows."""
    rng = np.random.default_rng(seed)
    ranges = {"throttle": (0.1, 0.5), "omega_ref": (2000.0, 6000.0), "beta_ref": (-5.0, 10.0), "supply": (22.0, 25.0)}
    hold = rng.integers(1, max(2, rows // 5), rows)
    return {s.name: np.repeat(rng.uniform(*ranges[s.name], rows), rng.permutation(hold))[:rows] for s in model.inputs}
