"""Counterparts of the paper's static characterisation (section 4.1)."""

from vpp_fmu.paper.counterpart import Counterpart
from vpp_fmu.paper.published import STATIC_MAP
from vpp_fmu.paper.static import Statics
from vpp_fmu.paper.study import Study


def static_rows(study: Study) -> dict[str, Counterpart]:
    """By the names in `published`."""
    s = study.statics
    used = s.points.beta_ref[s.rig.used]
    speed, pitch = s.ct_by_speed, s.ct_by_pitch
    found = {
        "region": Counterpart(
            f"{used.min():.3g} to {used.max():.3g}",
            f"{used.min():.3g} to {used.max():.3g}",
            f"{len(used)} points of the grid lie inside",
        ),
        "r2_adjusted": Counterpart(s.rig.r2_adjusted, s.model.r2_adjusted, _r2(s)),
        "ct_speed": Counterpart(
            f"{speed[0]:.4f} rms",
            f"{speed[1]:.4f} rms",
            f"against {pitch[0]:.3f} and {pitch[1]:.3f} over the pitch; the rig's blades know no Reynolds number",
        ),
    }
    for name in STATIC_MAP:
        why = (
            f"held at the paper's value the map leaves {s.held[name]:.3f} N rms instead of {s.rig.rmse:.3f}; the two maps are "
            f"{s.apart_rms:.2f} N rms apart"
        )
        found[f"static.{name}"] = Counterpart(s.rig.coefficients[name], s.model.coefficients[name], why, s.rig.std[name])
    return found


def _r2(s: Statics) -> str:
    """The paper's R² says how far its points scatter; ours don't."""
    return (
        f"the paper's points scatter by {s.scatter:.2f} N rms, ours by {s.rig.rmse:.3f}; means are known to {s.mean_std:.4f} "
        "N: an emulated stand comes back to its points"
    )
