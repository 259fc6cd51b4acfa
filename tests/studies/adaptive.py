"""python -m tests.studies adaptive: errors, alarms, false alarms and computing time of the adaptive twin.

Three parts. (a) Rigs that equal their model, with the noise that the twin assumes: errors of the adapted parameters over the
Cramer-Rao bound of the same record (information of the whole record, by numpy), coverage of the band, and hours without
excitation. (b) Changes on rigs that equal their model, where the truth is known, and on the emulated rigs of
`tests.studies.twin`, each identified from a campaign; then hours on the latter without a change, under three kinds of commands.
(c) Microseconds a step.

All of it is compiled and runs in virtual time. Aims: within 1.2 of the bound; 93 to 97 % in the band; no change missed, and no
more than one false alarm in 100 h.
"""

import tempfile
import time
from collections import Counter
from functools import cache, partial
from math import exp, sqrt
from pathlib import Path

import numpy as np
from hil.twin.adaptive import adaptive
from scipy.interpolate import RegularGridInterpolator
from scipy.signal import lfilter

from hil import commands
from hil.twin.band import Band
from identification.workers import spread
from tests.studies.twin import (
    DT,
    KINDS,
    RUN,
    WATCHED,
    Known,
    _loop,
    _noise,
    _orders,
    _plant,
    _rig,
    identified,
)
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

CHANGES = ("thrust x 0.85", "pitch +1 deg", "slow lag x 1.5", "drift 0.01 N/s")
OF = ("sensor_gain.gain", "pitch_offset.offset", "lag", "sensor_drift.offset")
"""The parameter that adapts to each change; the lag is the pitch's slower one."""

BEGIN = 120.0
"""s until a change begins; the twin has converged by then."""

STEADY = 4.0
"""s of constant commands before a change, so that both models have settled when one replaces the other."""

DRIFTS = 100.0
"""s that a drift lasts; its final value is the truth."""

CONSTANT = Band(0.12, 0.047, 0.15, 0.03, 0.0)
"""Band of the rigs that equal their model: the emulated load cell's noise, and a map that is right to 0.03 N."""


def main(parser, arguments):
    parser.add_argument("--seeds", type=int, default=100, metavar="N", help="of each change (default: %(default)s)")
    parser.add_argument("--hours", type=int, default=100, metavar="H", help="for false alarms (default: %(default)s)")
    parser.add_argument("--twins", type=int, default=24, metavar="N", help="rigs, each with a campaign (default: %(default)s)")
    parser.add_argument("--constant", type=int, default=40, metavar="N", help="constant rigs (default: %(default)s)")
    parser.add_argument("--first-seed", type=int, default=0, metavar="K", help="(default: %(default)s)")
    parser.add_argument("--workers", type=int, default=2, metavar="N", help="side by side (default: %(default)s)")
    options = parser.parse_args(arguments)
    first, workers = options.first_seed, options.workers
    print(__doc__.split("\n\n")[-1].strip())
    _show_constant(spread(constant, range(first, first + options.constant), workers, what="constant rigs"))
    _show_idle(idle_hours(first))
    at = range(first, first + options.seeds)
    _show_changes("rigs that are their model", spread(followed, at, workers, what="changes"))
    if options.twins:
        known = spread(identified, range(first, first + options.twins), workers, what="campaigns")
        _show_changes("emulated rigs", spread(partial(followed, known=known), at, workers, what="changes"))
        _show_alarms(spread(partial(alarms, known=known), range(first, first + options.hours), workers, what="hours"))
    _show_times()


# --- (a) ---------------------------------------------------------------------------------------------------------------------


def constant(seed: int) -> tuple[np.ndarray, np.ndarray, float]:
    """(error of each adapted parameter, its Cramer-Rao bound's standard deviation, share within the band) after 15 min."""
    rng = np.random.default_rng([seed, 5])
    rows = round(900.0 / DT)
    orders = commands.validation(int(rng.integers(2**31)), 900.0, DT)
    given = {name: orders[name][:rows] for name in ("omega_ref", "beta_ref")}
    parameters = _own()
    twin, adapted = adaptive(parameters, CONSTANT), _adapted(adaptive(parameters, CONSTANT))
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
    twin, rng = adaptive(parameters, CONSTANT), np.random.default_rng([seed, 6])
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


# --- (b) ---------------------------------------------------------------------------------------------------------------------


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


def twin_of(one: Known) -> ParameterSet:
    """The twin of an identified rig, as `vpp hil run --twin` makes it."""
    return adaptive(ParameterSet(plant(BROUGHT)).replaced(one.values, one.std), one.band)


def tachometer(omega: np.ndarray) -> np.ndarray:
    """A speed [rpm] as one mark a turn measures it: the mean of the last whole turn, held until the next."""
    turns = np.concatenate([[0.0], np.cumsum(0.5 * (omega[1:] + omega[:-1]) / 60.0 * DT)])
    marks = np.interp(np.arange(int(turns[-1]) + 1), turns, np.arange(len(omega)) * DT)
    read = np.concatenate([omega[:1], 60.0 / np.diff(marks)])
    return read[np.floor(turns).astype(int)]


def followed(seed: int, known: list[Known] | None = None) -> list[tuple[float, float, str]]:
    """For each change: s to the alarm (NaN: none, negative: before), s until its parameter stays within 10 % of the truth, and
    the parameter that the alarm names. `known`: emulated rigs; None: rigs that equal their model."""
    found = []
    for k, change in enumerate(CHANGES):
        rng = np.random.default_rng([seed, 7, k])
        if known is None:
            twin, values = adaptive(_own(), CONSTANT), _own().values
        else:
            one = known[seed % len(known)]
            twin, values = twin_of(one), one.values
        orders = commands.validation(int(rng.integers(2**31)), BEGIN + WATCHED, DT)
        given = {name: np.array(orders[name]) for name in ("omega_ref", "beta_ref")}
        after, still = orders.time >= BEGIN, (orders.time >= BEGIN - STEADY) & (orders.time < BEGIN)
        for column in given.values():
            column[still] = column[np.flatnonzero(still)[0]]
        lag = _adapted(twin)[3]
        thrust, speed = _shown(change, given, after, lag, values, None if known is None else one.own)
        if change.startswith("drift"):
            thrust = thrust + 0.01 * np.clip(orders.time - BEGIN, 0.0, DRIFTS)
        shown = _ran(twin, given | {"thrust": thrust + _noise(rng, len(thrust)), "omega": tachometer(speed)})
        found.append(_judged(change, OF[k] if OF[k] != "lag" else lag, shown, orders.time, _adapted(twin)))
    return found


def _shown(change, given, after, lag, values, own) -> tuple[np.ndarray, np.ndarray]:
    """Thrust [N] and speed [rpm] without noise of a rig in which something changes at BEGIN."""
    steps = np.full(len(after) - 1, DT)

    def run(changed: dict[str, float], orders) -> np.ndarray:
        if own is None:
            return _plant().simulate({p.name: values[p.name] for p in plant().parameters} | changed, orders, steps)
        return _rig().simulate(own | changed, orders, steps)

    if change.startswith("pitch"):
        return run({}, given | {"beta_ref": given["beta_ref"] + after}).T[:2]
    shown = run({}, given)
    if change.startswith("slow"):
        # The emulated actuator has no lag as a parameter; its loop's gain is decreased by the same factor.
        slower = run({lag: 1.5 * values[lag]} if own is None else {"kp_lac": own["kp_lac"] / 1.5}, given)
        shown = np.where(after[:, None], slower, shown)
    return shown[:, 0] * np.where(after & change.startswith("thrust"), 0.85, 1.0), shown[:, 1]


def _judged(change, name, shown, at, adapted) -> tuple[float, float, str]:
    onsets = np.flatnonzero(np.diff(shown["alarm"], prepend=0.0) > 0.5)
    before, later = onsets[at[onsets] < BEGIN], onsets[at[onsets] >= BEGIN]
    when = at[before[0]] - BEGIN if len(before) else at[later[0]] - BEGIN if len(later) else np.nan
    reached = shown[f"adapted.{name}"]
    was = float(reached[at < BEGIN][-1])
    truth = {"t": 0.85 * was, "p": was + 1.0, "s": 1.5 * was, "d": was + 0.01 * DRIFTS}[change[0]]
    allowed = 0.1 * (abs(truth) if change[0] in "ts" else abs(truth - was))
    outside = np.flatnonzero(np.abs(reached - truth) > allowed)
    settled = at[outside[-1]] - BEGIN if outside[-1] + 1 < len(at) else np.nan
    settles = np.flatnonzero((np.diff(shown["changes"], prepend=0.0) > 0.5) & (at >= BEGIN))
    points = int(shown["direction"][settles[0]]) if len(settles) else 0
    return float(when), float(settled), adapted[points - 1] if points else ""


def alarms(hour: int, known: list[Known]) -> tuple[str, str, int, float, float]:
    """(kind of commands, campaign's length, alarms, hours, share within the band) of an hour in which nothing changes."""
    one, kind = known[hour % len(known)], KINDS[hour // 3 % len(KINDS)]
    twin, count, inside = twin_of(one), 0, []
    for k in range(round(3600.0 / RUN)):
        rng = np.random.default_rng([hour, 3, k])
        shown = _ran(twin, _undisturbed(kind, rng, one))
        count += int(np.sum(np.diff(shown["alarm"]) > 0.5))
        first = len(shown["band"]) // 10
        inside.append(np.mean(np.abs(shown["residual"][first:]) < shown["band"][first:]))
    return kind, one.length, count, 1.0, float(np.mean(inside))


def _undisturbed(kind: str, rng: np.random.Generator, one: Known) -> dict[str, np.ndarray]:
    if kind == "closed loop":
        omega, beta, thrust, speed = _loop(rng, one.own)
    else:
        omega, beta = _orders(kind, rng)
        shown = _rig().simulate(one.own, {"omega_ref": omega, "beta_ref": beta}, np.full(len(omega) - 1, DT))
        thrust, speed = shown[:, 0] + _noise(rng, len(omega)), shown[:, 1]
    return {"omega_ref": omega, "beta_ref": beta, "thrust": thrust, "omega": tachometer(speed)}


# --- (c) ---------------------------------------------------------------------------------------------------------------------


def microseconds() -> dict[str, float]:
    """Of a step of 4 ms: plant and twin alone, native and Python; and plant, controller and twin in one loop through fmpy."""
    twin, found = adaptive(_own(), CONSTANT), {}
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
    names = _adapted(adaptive(_own(), CONSTANT))
    print(f"\nconstant rigs, {len(errors)} of 15 min: rmse over the Cramer-Rao bound (chance: +-{0.7 / sqrt(len(errors)):.2f})")
    for name, own, bound in zip(names, errors.T, bounds.T, strict=True):
        rms, limit = sqrt(np.mean(own**2)), sqrt(np.mean(bound**2))
        print(f"{name:22} rmse {rms:9.2g}   bound {limit:9.2g}   ratio {sqrt(np.mean((own / bound) ** 2)):5.2f}")
    print(f"readings within the band: {100 * inside.mean():.1f} %")


def _show_idle(found: dict[str, float]) -> None:
    moved = max(value for name, value in found.items() if name != "alarms")
    moves = f"a parameter goes through {moved:.2f} of its standard deviation at most, {found['alarms']:.0f} alarms"
    print(f"\n{IDLE} h at one set-point: {moves}")


def _show_changes(what: str, found) -> None:
    print(f"\nchanges at {BEGIN:g} s on {what}: s to the alarm, s to within 10 % of the truth for good, within {WATCHED:g} s")
    head = f"{'change':16} {'runs':>5} {'alarm':>6} {'95 %':>6} {'missed':>7} {'before':>7}"
    print(f"{head} {'learned':>8} {'95 %':>6} {'never':>6}  points to")
    for k, change in enumerate(CHANGES):
        when, settled, points = zip(*(one[k] for one in found), strict=True)
        when, settled = np.array(when), np.array(settled)
        right = when[when >= 0.0]
        median, late = (np.quantile(right, q, method="higher") if len(right) else np.nan for q in (0.5, 0.95))
        there = np.where(np.isnan(settled), np.inf, settled)
        usual, slow = (np.quantile(there, q, method="higher") for q in (0.5, 0.95))
        causes = ", ".join(f"{name or 'nothing'} {n}" for name, n in Counter(points).most_common())
        line = f"{change:16} {len(when):5} {median:6.1f} {late:6.1f} {np.sum(np.isnan(when)):7} {np.sum(when < 0.0):7}"
        print(f"{line} {usual:8.1f} {slow:6.1f} {np.sum(np.isinf(there)):6}  {causes}")


def _show_alarms(found) -> None:
    count, hours, inside = Counter(), Counter(), {}
    for kind, length, n, h, share in found:
        for name in (kind, length, "all"):
            count[name] += n
            hours[name] += h
            inside.setdefault(name, []).append(share)
    print("\nfalse alarms on emulated rigs while nothing changes, and readings within the band")
    for name, shares in inside.items():
        print(f"{name:20} {count[name]:4} in {hours[name]:6.1f} h   {100 * np.mean(shares):5.1f} %")


def _show_times() -> None:
    print("\nmicroseconds a step")
    for what, value in microseconds().items():
        print(f"{what:44} {value:7.2f}")
