"""Counterparts of the paper's stand and of what it measured there (sections 2 and 3)."""

import numpy as np

from hil.emulator.rig import Rig
from hil.physics.rig_model import FULL_RIG
from hil.safety.limits import Limits
from identification.static.steady import samples_needed
from vpp_fmu.kernel.plant import BASE
from vpp_fmu.paper import recording
from vpp_fmu.paper.counterpart import Counterpart
from vpp_fmu.paper.fine_tuning import parts
from vpp_fmu.paper.static import paper_thrust
from vpp_fmu.paper.study import Study

GRAVITY = 9.80665

GOOD = 0.01
"""N; standard deviation of a mean that is good enough."""

THIRTEEN = (
    "apparent_mass",
    "inertia",
    "j_a",
    "d_a",
    "kv",
    "drag",
    "k_a",
    "resistance",
    "r_a",
    "inductance",
    "l_a",
    "kv",
    "k_ia",
)
"""tau_lambda, J, J_a, D_a, k_Q, k_omega, k_a, R_m, R_a, L_m, L_a, k_i, k_ia in the rig's physics; k_Q and k_i come from KV."""

SAME = "the same part"
NOT_PUBLISHED = "not published, so chosen here"


def setup_rows(study: Study) -> dict[str, Counterpart]:
    """By the names in `published`."""
    return _models(study) | _stand(study) | _loops() | _static_campaign(study) | _steps(study)


def _models(study: Study) -> dict[str, Counterpart]:
    known = [p.name for p in FULL_RIG.parameters]
    thirteen = sum(name in known for name in THIRTEEN)
    lags = float(sum(p.name.startswith("tau_") for p in BASE.parameters))
    fitted = float(len(study.found.refinement.names))
    names = study.fine_tuning_model.ours.names
    return {
        "full_parameters": Counterpart(
            float(thirteen), None, f"k_Q and k_i are one number; with maps, supplies and controllers it has {len(known)}"
        ),
        "order": Counterpart(float(len(BASE.states)), float(len(BASE.states)), "the same model"),
        "time_constants": Counterpart(lags, lags, "the same model"),
        "fitted_parameters": Counterpart(fitted, float(len(names)), "the same parameters"),
    }


def _stand(study: Study) -> dict[str, Counterpart]:
    p, points = FULL_RIG.values(Rig().parameters), study.campaign.static
    calibration = recording.emulated(Limits(), study.seed).calibration
    reach = abs(calibration.newton_per_count) * 2**15 / GRAVITY
    noise = float(np.median(points.thrust_std))
    return {
        "kv": Counterpart(p["kv"], None, SAME),
        "supply": Counterpart(p["supply_voltage"], None, SAME),
        "actuator_supply": Counterpart(p["v_a"], None, SAME),
        "supplies": Counterpart(None, None, "emulated supplies hold their voltage at any current"),
        "esc": Counterpart(None, None, "the emulated ESC limits no current"),
        "propeller": Counterpart(f"radius {1e3 * p['radius']:.0f} mm", None, "lift and drag fitted to the paper's static map"),
        "actuator": Counterpart(
            f"{p['beta_low']:g} to {p['beta_high']:g} deg", None, "its motor's and screw's constants are chosen, no data sheet"
        ),
        "load_cell": Counterpart(reach, None, "what the converter's range stands for behind the emulated amplifier"),
        "capacitors": Counterpart(f"{noise:.3f} N left", None, "noise of one reading; chosen, since the paper tells none"),
        "adc": Counterpart(16.0, None, "the same part, by its registers"),
        "largest_thrust": Counterpart(
            float(points.thrust.max()),
            float(paper_thrust(np.array([6000.0]), np.array([10.0]))[0]),
            "the model is the paper's static map at 6000 rpm and 10 deg",
        ),
        "rpm_bits": Counterpart("32-bit counts", None, "four bits hold 16 values: a misprint; here frames with a checksum"),
    }


def _loops() -> dict[str, Counterpart]:
    p = FULL_RIG.values()
    speed = f"the same; without a published unit, one of the PI's output is {p['throttle_unit']:g} of the throttle (chosen)"
    pitch = "the same; without a published unit, drive per share of the travel (chosen)"
    return {
        "kp_rpm": Counterpart(p["kp_rpm"], None, speed),
        "ki_rpm": Counterpart(p["ki_rpm"], None, speed),
        "kp_lac": Counterpart(p["kp_lac"], None, pitch),
        "kd_lac": Counterpart(p["kd_lac"], None, pitch),
    }


def _static_campaign(study: Study) -> dict[str, Counterpart]:
    points, plan, record = study.campaign.static, study.plan, study.campaign.open_loop
    speeds, pitches = np.unique(points.omega_ref), np.unique(points.beta_ref)
    why = "as the paper" if study.is_full else "a quick study"
    noise = (record["thrust"] - study.campaign.repeat["thrust"]) / np.sqrt(2.0)
    need = samples_needed(noise[np.isfinite(noise)], GOOD).number
    return {
        "speeds": Counterpart(_range(speeds), None, "as the paper"),
        "pitches": Counterpart(_range(pitches), None, "as the paper"),
        "grid": Counterpart(f"{len(speeds)} x {len(pitches)}", None, why),
        "settle": Counterpart(plan.settle, None, why),
        "rate": Counterpart(float(1.0 / np.median(record.steps)), None, "as the paper"),
        "samples": Counterpart(float(np.median(points.samples)), None, f"{why}; {need} make a mean good to {GOOD:g} N here"),
    }


def _steps(study: Study) -> dict[str, Counterpart]:
    runs, record = study.averages.rig.runs, study.campaign.steps[0]
    step = float(record.time[np.argmax(np.abs(np.diff(record["omega_ref"])) + np.abs(np.diff(record["beta_ref"]))) + 1])
    levels = {channel: sorted({run.level for run in runs if run.channel == channel}) for channel in ("omega", "beta")}
    each = {way: len({run.end for run in runs if run.channel == "omega" and run.direction == way}) for way in ("up", "down")}
    where = f"{NOT_PUBLISHED}: pitch {_range(levels['omega'])} deg, speed {_range(levels['beta'])} rpm"
    names = ", ".join(parts(study.campaign.open_loop))
    why = "as the paper" if study.is_full else "a quick study"
    found = {
        "steps": Counterpart(f"{each['up']} up, {each['down']} down", None, "as the paper"),
        "states": Counterpart(float(len(levels["omega"])), None, where),
        "before": Counterpart(step, None, f"{why}; {study.plan.settle:g} s more go before"),
        "after": Counterpart(study.plan.after, None, why),
        "sections": Counterpart(names, None, f"moves and holds are {NOT_PUBLISHED}; {study.plan.section:g} s each"),
    }
    for name, channel in (("speed", "omega"), ("pitch", "beta")):
        for way in ("up", "down"):
            own = [run for run in runs if run.channel == channel and run.direction == way]
            ends = sorted({run.end for run in own}, reverse=way == "down")
            text = f"{own[0].start:g} to {ends[0]:g} ... {ends[-1]:g}"
            found[f"{name}_{way}"] = Counterpart(text, None, "as the paper")
    return found


def _range(values) -> str:
    return f"{min(values):g} to {max(values):g}"
