"""python -m tests.studies adaptive: errors of the parameters that the twin adapts, and its computing time.

(a) Rigs that equal their model, with the noise that the twin assumes: errors of the adapted parameters over the Cramer-Rao
bound of the same record (information of the whole record, by numpy), coverage of the band, and hours without excitation.
(b) Microseconds a step.

All of it is compiled and runs in virtual time. Aims: within 1.2 of the bound; 93 to 97 % in the band.
"""

import tempfile
import time
from functools import cache
from math import exp, sqrt
from pathlib import Path

import numpy as np
from scipy.interpolate import RegularGridInterpolator
from scipy.signal import lfilter

from hil import commands
from hil.twin.band import Band
from hil.twin.twin import twin_of
from identification.workers import spread
from tests.studies.twin import DT, _noise
from vpp_fmu.export import native_fmu, python_fmu
from vpp_fmu.fmu import Fmu, FmuInstance
from vpp_fmu.kernel.controller import CONTROLLER
from vpp_fmu.kernel.plant import plant
from vpp_fmu.kernel.simulation import Simulation
from vpp_fmu.kernel.twin.noises import BETWEEN, BLOCK, HALVES, NODE, NODES, ON_THE_WAY, PLACE, SPEED_ON_THE_WAY
from vpp_fmu.kernel.twin.prediction import BROUGHT
from vpp_fmu.native.simulator import Simulator
from vpp_fmu.native.stepper import Stepper
from vpp_fmu.parameters import ParameterSet

CONSTANT = Band(0.12, 0.047, 0.15, 0.03, 0.0)
"""Band of the rigs that equal their model: the emulated load cell's noise, and a map that is right to 0.03 N."""


def main(parser, arguments):
    parser.add_argument("--constant", type=int, default=40, metavar="N", help="constant rigs (default: %(default)s)")
    parser.add_argument("--first-seed", type=int, default=0, metavar="K", help="(default: %(default)s)")
    parser.add_argument("--workers", type=int, default=2, metavar="N", help="side by side (default: %(default)s)")
    options = parser.parse_args(arguments)
    first, workers = options.first_seed, options.workers
    print(__doc__.split("\n\n")[-1].strip())
    _show_constant(spread(constant, range(first, first + options.constant), workers, what="constant rigs"))
    _show_idle(idle_hours(first))
    _show_times()


# --- (a) ---------------------------------------------------------------------------------------------------------------------


def constant(seed: int) -> tuple[np.ndarray, np.ndarray, float]:
    """(error of each adapted parameter, its Cramer-Rao bound's standard deviation, share within the band) after 15 min."""
    rng = np.random.default_rng([seed, 5])
    rows = round(900.0 / DT)
    orders = commands.validation(int(rng.integers(2**31)), 900.0, DT)
    given = {name: orders[name][:rows] for name in ("omega_ref", "beta_ref")}
    parameters = _own()
    twin, adapted = twin_of(parameters, CONSTANT), _adapted(twin_of(parameters, CONSTANT))
    plain = Simulator(parameters.model, adapted)
    shown, slopes = plain.sensitivities(parameters.values, given, np.full(rows - 1, DT))
    moves, gone = _moves(parameters.values, shown, given)
    fading, staying = _variances(twin.values, moves, gone)
    nodes = _at_nodes(parameters.values, shown)
    noise = _markov(rng, fading, exp(-DT / CONSTANT.slow_time)) + _markov(rng, *staying)
    noise += nodes @ (NODE * twin.values["steady"] * rng.standard_normal(nodes.shape[1]))
    thrust = shown[:, 0] + noise + CONSTANT.white * rng.standard_normal(rows)
    lasting = _lasting(twin.values, shown[:, 1])
    speed = shown[:, 1] + np.sqrt(lasting) * rng.standard_normal(rows)
    found = _ran(twin, given | {"thrust": thrust, "omega": speed})
    errors = np.array([found[f"adapted.{name}"][-1] - parameters.values[name] for name in adapted])
    bound = _bound(twin.values, slopes, nodes, fading, staying, lasting, adapted)
    inside = np.mean(np.abs(found["residual"][rows // 10 :]) < found["band"][rows // 10 :])
    return errors, bound, float(inside)


@cache
def _own() -> ParameterSet:
    """A plant whose adaptation begins at its own values, without uncertainties of a campaign."""
    return ParameterSet(plant(BROUGHT))


def _adapted(twin: ParameterSet) -> tuple[str, ...]:
    return tuple(y.name.removeprefix("adapted.") for y in twin.model.outputs if y.name.startswith("adapted."))


def _moves(values: dict[str, float], shown: np.ndarray, given: dict[str, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """(recent and pending moves of the thrust [N], distance by which the place has moved) at each row: the model's definitions
    in numpy."""
    w, b = shown[:, 1] / values["omega_scale"], (shown[:, 2] + values["beta_offset"]) / values["beta_scale"]

    def mapped(w, b):
        v = values
        return v["thrust_scale"] * w * (w * (v["c20"] + v["c21"] * b + v["c30"] * w) + b * (v["c11"] + v["c12"] * b))

    def path(w, b, w_end, b_end):
        return np.abs(mapped(w_end, b) - mapped(w, b)) + np.abs(mapped(w_end, b_end) - mapped(w_end, b))

    moved = path(w[:-1], b[:-1], w[1:], b[1:])
    to_speed, to_pitch = (
        given["omega_ref"] / values["omega_scale"],
        (given["beta_ref"] + values["beta_offset"]) / values["beta_scale"],
    )
    to_come = path(w[1:], b[1:], to_speed[:-1], to_pitch[:-1])
    moves, decay = np.zeros(len(w)), HALVES ** (DT / BLOCK)
    gone, at = np.zeros(len(w)), np.array([w[0], b[0]])
    for k in range(1, len(w)):
        moves[k] = decay * moves[k - 1] + moved[k - 1]
        away = np.array([w[k], b[k]]) - at
        distance = sqrt(away @ away)
        if distance > 0.5 * PLACE:
            gone[k] = distance - 0.5 * PLACE
            at = at + away * (gone[k] / distance)
    return moves + np.r_[0.0, to_come], gone


def _at_nodes(values: dict[str, float], shown: np.ndarray) -> np.ndarray:
    """Weights (rows, nodes) of a model's errors at the nodes in its error at each row: scipy's interpolation of ones."""
    w, b = shown[:, 1] / values["omega_scale"], (shown[:, 2] + values["beta_offset"]) / values["beta_scale"]
    at = np.column_stack([np.clip(x, nodes[0], nodes[-1]) for x, nodes in zip((w, b), NODES, strict=True)])
    ones = np.eye(len(NODES[0]) * len(NODES[1])).reshape(len(NODES[0]), len(NODES[1]), -1)
    return RegularGridInterpolator(NODES, ones)(at)


def _variances(values, moves, gone):
    """(variance of the fading noise, (variance of the model's other error by place, share that a row keeps of it)), (rows,)."""
    share = values["slow_time"] / BLOCK
    averaged = 2.0 * share * (1.0 - share * (1.0 - exp(-1.0 / share)))
    fading = values["slow"] ** 2 + (values["moving"] ** 2 / averaged + ON_THE_WAY**2) * moves**2
    return fading, (np.full(len(moves), (BETWEEN * values["steady"]) ** 2), np.exp(-gone / PLACE))


def _lasting(values, speed: np.ndarray) -> np.ndarray:
    """Equivalent white variance of each speed reading, (rows,)."""
    turned = lfilter([1.0], [1.0, -(HALVES ** (DT / BLOCK))], np.abs(np.diff(speed, prepend=speed[0])))
    off = values["speed_error"] ** 2 + (SPEED_ON_THE_WAY * turned) ** 2
    return off * 2.0 * values["slow_time"] / DT


def _markov(rng, variance, keeps) -> np.ndarray:
    drawn, keeps = rng.standard_normal(len(variance)), np.broadcast_to(keeps, len(variance))
    drive, x = np.sqrt((1.0 - keeps**2) * variance) * drawn, np.empty(len(variance))
    x[0] = sqrt(variance[0]) * drawn[0]
    for k in range(1, len(x)):
        x[k] = keeps[k] * x[k - 1] + drive[k]
    return x


def _bound(values, slopes, nodes, fading, staying, lasting, adapted) -> np.ndarray:
    """Standard deviations from the information of the record. The noise's innovations whiten the slopes by the parameters and
    by the model's errors at the nodes; priors are added."""
    a, P, gone = exp(-DT / values["slow_time"]), np.diag([fading[0], staying[0][0]]), staying[1]
    by = np.column_stack([slopes[:, 0], nodes])
    taken = np.zeros((2, by.shape[1]))
    known = [values[f"prior.{name}"] for name in adapted] + nodes.shape[1] * [NODE * values["steady"]]
    information = np.diag(np.array(known) ** -2.0)
    for k in range(1, len(fading)):
        keeps = np.array([a, gone[k]])
        P = P * np.outer(keeps, keeps) + np.diag((1.0 - keeps**2) * [fading[k], staying[0][k]])
        taken = taken * keeps[:, None]
        S = P.sum() + values["white"] ** 2
        slope = by[k] - taken.sum(axis=0)
        gain = P.sum(axis=1) / S
        taken = taken + np.outer(gain, slope)
        P = P - np.outer(gain, gain) * S
        information += np.outer(slope, slope) / S
    own = slice(len(adapted))
    information[own, own] += slopes[:, 1].T @ (slopes[:, 1] / lasting[:, None])
    return np.sqrt(np.diag(np.linalg.inv(information)))[own]


IDLE = 10
"""h at one set-point."""


def idle_hours(seed: int, hours: int = IDLE) -> dict[str, float]:
    """Range of each parameter over its standard deviation in hours at one set-point, after the first minute; and the alarms."""
    parameters = _own()
    twin, rng = twin_of(parameters, CONSTANT), np.random.default_rng([seed, 6])
    rows = round(hours * 3600.0 / DT)
    at = {"omega_ref": 4500.0, "beta_ref": 4.0}
    thrust = Simulation(parameters.model, parameters.values).start(at)["thrust"]
    steps, inputs = np.full(rows - 1, DT), {name: np.full(rows, value) for name, value in at.items()}
    inputs |= {"thrust": thrust + _noise(rng, rows), "omega": np.full(rows, 4500.0)}
    simulator, adapted, first, moved, alarms = _simulator(twin), _adapted(twin), round(60.0 / DT), {}, 0
    for at_rows, shown, _ in simulator.pieces(twin.values, inputs, steps):
        columns = dict(zip(simulator.outputs, shown.T, strict=True))
        alarms += int(np.sum(np.diff(columns["alarm"]) > 0.5))
        if at_rows.start < first:
            continue
        for name in adapted:
            low, high, std = moved.get(name, (np.inf, -np.inf, columns[f"std.{name}"][0]))
            path = columns[f"adapted.{name}"]
            moved[name] = min(low, path.min()), max(high, path.max()), std
    found = {name: float((high - low) / std) for name, (low, high, std) in moved.items()}
    return found | {"alarms": float(alarms)}


SIMULATORS: dict[tuple[str, ...], Simulator] = {}
"""By the names of a twin's states, since each call of `adaptive` makes a new model."""


def _simulator(twin: ParameterSet) -> Simulator:
    names = tuple(x.name for x in twin.model.states)
    if names not in SIMULATORS:
        SIMULATORS[names] = Simulator(twin.model)
    return SIMULATORS[names]


def _ran(twin: ParameterSet, inputs: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    simulator = _simulator(twin)
    shown = simulator.simulate(twin.values, inputs, np.full(len(inputs["thrust"]) - 1, DT))
    return dict(zip(simulator.outputs, shown.T, strict=True))


# --- (b) ---------------------------------------------------------------------------------------------------------------------


def microseconds() -> dict[str, float]:
    """Of a step of 4 ms: plant and twin alone, native and Python; and plant, controller and twin in one loop through fmpy."""
    twin, found = twin_of(_own(), CONSTANT), {}
    parts = {"plant": ParameterSet(plant()), "controller": ParameterSet(CONTROLLER), "twin": twin}
    with tempfile.TemporaryDirectory() as folder:
        for flavour, make in (("native", native_fmu), ("Python", python_fmu)):
            files, steps = {}, {}
            for role, part in parts.items():
                path = Path(folder, f"{role}.{flavour}.fmu")
                path.write_bytes(make(part.model, part.values))
                fmu = Fmu(path)
                one = FmuInstance(fmu, [u.name for u in part.model.inputs], [y.name for y in part.model.outputs])
                one.start([u.start for u in part.model.inputs])
                files[role], steps[role] = (fmu, one), one.stepper(DT)

            def loop(k: int, steps=steps) -> None:
                acting = steps["controller"]((6.0, 5.0 + 0.01 * (k % 7)))
                shown = steps["plant"](acting)
                steps["twin"]((*acting, shown[0], shown[1], 0.0))

            found[f"plant, {flavour} FMU"] = _best(lambda k, step=steps["plant"]: step((4000.0, 4.0)))
            found[f"twin, {flavour} FMU"] = _best(
                lambda k, step=steps["twin"]: step((4000.0, 4.0, 5.0 + 0.01 * (k % 7), 4000.0, 0.0))
            )
            found[f"plant, controller and twin, {flavour} FMUs"] = _best(loop)
            for fmu, one in files.values():
                one.close()
                fmu.close()
    for what in ("plant", "twin"):
        one, values = Stepper(parts[what].model, parts[what].values), [u.start for u in parts[what].model.inputs]
        one.start(values)
        found[f"{what}, as hil steps it"] = _best(lambda k, one=one, values=values: one.step(values, DT))
    rows = 100_000
    inputs = {"omega_ref": np.full(rows, 4000.0), "beta_ref": np.full(rows, 4.0)}
    for what, more in (("plant", {}), ("twin", {"thrust": np.full(rows, 5.0), "omega": np.full(rows, 4000.0)})):
        simulator = Simulator(parts[what].model)
        given = parts[what].values, inputs | more, np.full(rows - 1, DT)
        found[f"{what}, compiled, by itself"] = _best(lambda k, run=simulator.simulate, given=given: run(*given), 1) / rows
    return found


def _best(step, batch: int = 200) -> float:
    """us a call, in the best of many batches, because the machine is shared."""
    best = np.inf
    for _ in range(20):
        began = time.perf_counter()
        for k in range(batch):
            step(k)
        best = min(best, (time.perf_counter() - began) / batch)
    return 1e6 * float(best)


# --- tables ------------------------------------------------------------------------------------------------------------------


def _show_constant(found) -> None:
    errors, bounds, inside = (np.array(column) for column in zip(*found, strict=True))
    names = _adapted(twin_of(_own(), CONSTANT))
    print(f"\nconstant rigs, {len(errors)} of 15 min: rmse over the Cramer-Rao bound (chance: +-{0.7 / sqrt(len(errors)):.2f})")
    for name, own, bound in zip(names, errors.T, bounds.T, strict=True):
        rms, limit = sqrt(np.mean(own**2)), sqrt(np.mean(bound**2))
        print(f"{name:22} rmse {rms:9.2g}   bound {limit:9.2g}   ratio {sqrt(np.mean((own / bound) ** 2)):5.2f}")
    print(f"readings within the band: {100 * inside.mean():.1f} %")


def _show_idle(found: dict[str, float]) -> None:
    moved = max(value for name, value in found.items() if name != "alarms")
    moves = f"a parameter goes through {moved:.2f} of its standard deviation at most, {found['alarms']:.0f} alarms"
    print(f"\n{IDLE} h at one set-point: {moves}")


def _show_times() -> None:
    print("\nmicroseconds a step")
    for what, value in microseconds().items():
        print(f"{what:44} {value:7.2f}")
