"""Counterparts of the paper's stand and of what it measured there (sections 2 and 3)."""

from collections.abc import Mapping

import numpy as np

from hil.calibration import Calibration
from hil.devices.ads1115 import LARGEST, SMALLEST
from hil.devices.frames import ANSWER, FROM_BOARD
from hil.physics.rig_model import FULL_RIG
from hil.safety.limits import Limits
from identification.static.steady import samples_needed
from vpp_fmu.kernel.plant import BASE
from vpp_fmu.paper import recording
from vpp_fmu.paper.counterpart import Counterpart, of_setup
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

NOT_PUBLISHED = "not published, so chosen here"


def setup_rows(study: Study) -> dict[str, Counterpart]:
    """By the names in `published`."""
    setup, hurry = recording.emulated(Limits(), study.seed), "" if study.is_full else "a quick study"
    p = FULL_RIG.values(setup.emulated.parameters)
    rows = _models(study) | _stand(study, p, setup.calibration) | _loops(p)
    return rows | _static_campaign(study, hurry) | _steps(study, hurry)


def _models(study: Study) -> dict[str, Counterpart]:
    known = [p.name for p in FULL_RIG.parameters]
    thirteen = sum(name in known for name in THIRTEEN)
    models = study.found.parameters.model, BASE
    lags = (float(sum(p.name.startswith("tau_") for p in model.parameters)) for model in models)
    fitted = (float(len(refinement.names)) for refinement in (study.found.refinement, study.fine_tuning_model.ours))
    return {
        "full_parameters": Counterpart(
            float(thirteen), None, f"k_Q and k_i are one number; with maps, supplies and controllers it has {len(known)}"
        ),
        "order": of_setup("order", *(float(len(model.states)) for model in models)),
        "time_constants": of_setup("time_constants", *lags),
        "fitted_parameters": of_setup("fitted_parameters", *fitted),
    }


def _stand(study: Study, p: Mapping[str, float], calibration: Calibration) -> dict[str, Counterpart]:
    points = study.campaign.static
    reach = -abs(calibration.newton_per_count) * SMALLEST / GRAVITY
    noise = float(np.median(points.thrust_std))
    return {
        "kv": of_setup("kv", p["kv"]),
        "supply": of_setup("supply", p["supply_voltage"]),
        "actuator_supply": of_setup("actuator_supply", p["v_a"]),
        "supplies": Counterpart(None, None, "emulated supplies hold their voltage at any current"),
        "esc": Counterpart(None, None, "the emulated ESC limits no current"),
        "propeller": Counterpart(f"radius {1e3 * p['radius']:.0f} mm", None, "lift and drag fitted to the paper's static map"),
        "actuator": Counterpart(
            f"{p['beta_low']:g} to {p['beta_high']:g} deg", None, "its motor's and screw's constants are chosen, no data sheet"
        ),
        "load_cell": of_setup("load_cell", reach, None, "the converter's range behind the emulated amplifier"),
        "capacitors": Counterpart(f"{noise:.3f} N left", None, "noise of one reading; chosen, since the paper tells none"),
        "adc": of_setup("adc", float(np.log2(LARGEST - SMALLEST + 1)), None, "the same part, by its registers"),
        "largest_thrust": Counterpart(
            float(points.thrust.max()),
            float(paper_thrust(np.array([6000.0]), np.array([10.0]))[0]),
            "the model is the paper's static map at 6000 rpm and 10 deg",
        ),
        "rpm_bits": Counterpart(
            f"{8 * FROM_BOARD[ANSWER]} bits", None, "four bits hold 16 values: a misprint; here a frame with a checksum"
        ),
    }


def _loops(p: Mapping[str, float]) -> dict[str, Counterpart]:
    speed = f"without a published unit, one of the PI's output is {p['throttle_unit']:g} of the throttle (chosen)"
    pitch = "without a published unit, drive per share of the travel (chosen)"
    notes = {"kp_rpm": speed, "ki_rpm": speed, "kp_lac": pitch, "kd_lac": pitch}
    return {name: of_setup(name, p[name], None, note) for name, note in notes.items()}


def _static_campaign(study: Study, hurry: str) -> dict[str, Counterpart]:
    points, record = study.campaign.static, study.campaign.open_loop
    speeds, pitches = np.unique(points.omega_ref), np.unique(points.beta_ref)
    noise = (record["thrust"] - study.campaign.repeat["thrust"]) / np.sqrt(2.0)
    need = samples_needed(noise[np.isfinite(noise)], GOOD).number
    enough = f"{need} make a mean good to {GOOD:g} N here"
    return {
        "speeds": of_setup("speeds", _range(speeds)),
        "pitches": of_setup("pitches", _range(pitches)),
        "grid": of_setup("grid", f"{len(speeds)} x {len(pitches)}", None, hurry),
        "settle": of_setup("settle", study.plan.settle, None, hurry),
        "rate": of_setup("rate", float(1.0 / np.median(record.steps))),
        "samples": of_setup("samples", float(np.median(points.samples)), None, f"{hurry}; {enough}" if hurry else enough),
    }


def _steps(study: Study, hurry: str) -> dict[str, Counterpart]:
    runs, record = study.averages.rig.runs, study.campaign.steps[0]
    at = int(np.argmax(np.abs(np.diff(record["omega_ref"])) + np.abs(np.diff(record["beta_ref"])))) + 1
    before, after = (rows * record.period for rows in (at, len(record) - at))
    levels = {channel: sorted({run.level for run in runs if run.channel == channel}) for channel in ("omega", "beta")}
    each = {way: len({run.end for run in runs if run.channel == "omega" and run.direction == way}) for way in ("up", "down")}
    where = f"{NOT_PUBLISHED}: pitch {_range(levels['omega'])} deg, speed {_range(levels['beta'])} rpm"
    names = ", ".join(parts(study.campaign.open_loop))
    more = f"{study.plan.settle:g} s more go before"
    found = {
        "steps": of_setup("steps", f"{each['up']} up, {each['down']} down"),
        "states": of_setup("states", float(len(levels["omega"])), None, where),
        "before": of_setup("before", before, None, f"{hurry}; {more}" if hurry else more),
        "after": of_setup("after", after, None, hurry),
        "sections": Counterpart(names, None, f"moves and holds are {NOT_PUBLISHED}; {study.plan.section:g} s each"),
    }
    for name, channel in (("speed", "omega"), ("pitch", "beta")):
        for way in ("up", "down"):
            own = [run for run in runs if run.channel == channel and run.direction == way]
            ends = sorted({run.end for run in own}, reverse=way == "down")
            found[f"{name}_{way}"] = of_setup(f"{name}_{way}", f"{own[0].start:g} to {ends[0]:g} ... {ends[-1]:g}")
    return found


def _range(values) -> str:
    return f"{min(values):g} to {max(values):g}"
