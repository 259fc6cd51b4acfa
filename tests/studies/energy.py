"""Energy of a mission under three laws, on random rigs whose power follows momentum theory.

    python -m tests.studies energy --rigs 20
    python -m tests.studies energy --emulated

Aim: the allocated law takes at most 2 % more energy than the reference, and settles no later than the paper's law.

Mission: 120 s of hover, climb, gusts (a new set-point every 1.5 s) and descent. Each rig has its own map and lags. Its
power (induced and profile power of the rotor, a constant efficiency, idle power) is measured at steady points with 1 % of
noise, and fitted; the controllers know the fit, with 1 % of error in each parameter of thrust.

Reference: the least power of any pair of speed and pitch with the allocated law's thrust, at each instant, on the known rig.
Power is a function of the pair alone, so this is a lower bound for every law.

--emulated: the emulated rig is measured (`vpp hil campaign --power`), identified and allocated. It runs the mission through its
buses under each law (`vpp hil run --virtual --power`), and so does its identified plant in the loop of `vpp cosim`. The rig's
own equations, settled over throttle and pitch, give its reference.
"""

import tempfile
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from hil.calibration import read_calibration
from hil.campaign import Plan, steep
from hil.campaign_folder import Measuring
from hil.commands import PAPERS
from hil.emulator.rig import CALIBRATION, POWERED
from hil.emulator.rig import Rig as Emulated
from hil.outcome import energy
from hil.physics.rig_model import POWERTRAIN
from hil.run import run_on_rig
from hil.safety.limits import limits_of
from hil.session import Setup
from identification.identify import identify
from identification.power.allocation import Allocation, allocate, allocated_controller
from identification.power.fit import fit_power, steady_readings
from identification.power.model import PowerModel
from identification.tune.controllers import controllers
from vpp_fmu.campaign import StaticMap, read_campaign
from vpp_fmu.files import OutputFolder
from vpp_fmu.kernel.effects.thrust_map import normalised_thrust
from vpp_fmu.kernel.plant import BASE, FINE_TUNED
from vpp_fmu.native import Simulator
from vpp_fmu.native.closed_loop import ClosedLoop, Course
from vpp_fmu.parameters import ParameterSet
from vpp_fmu.plants import KernelController
from vpp_fmu.record import Record
from vpp_fmu.response import Step, smoothed, steps

DT = 0.004
"""Period of the loop, s."""

RHO = 1.2
LEVELS = 401

LARGE = 0.1
"""Steps of at least this share of the thrust scale are timed: the gusts are smaller."""


@dataclass(frozen=True)
class Truth:
    """A rig: parameters of thrust, and of the rotor's power."""

    values: Mapping[str, float]
    disc: float
    profile: float
    best: float
    efficiency: float
    idle: float

    def thrust(self, w: np.ndarray, b: np.ndarray) -> np.ndarray:
        """Thrust [N] at normalised speed and pitch."""
        c = type("c", (), {n: self.values[n] for n in FINE_TUNED})
        return 15.0 * normalised_thrust(c, w, b)

    def power(self, w: np.ndarray, b: np.ndarray) -> np.ndarray:
        """Electrical power [W]: induced T^1.5 / sqrt(2 rho A) with 15 % of losses, and blade drag."""
        lift = np.maximum(self.thrust(w, b), 0.0)
        induced = 1.15 * lift**1.5 / np.sqrt(2.0 * RHO * self.disc)
        return (induced + self.profile * w**3 * (1.0 + 4.0 * (b - self.best) ** 2)) / self.efficiency + self.idle


def rig(rng: np.random.Generator) -> Truth:
    """A random rig about the paper's size."""
    values = {n: v * float(np.exp(rng.normal(0.0, 0.2 if n.startswith("tau") else 0.05))) for n, v in FINE_TUNED.items()}
    radius = rng.uniform(0.11, 0.16)
    drag = rng.uniform(25.0, 60.0), rng.uniform(0.1, 0.5)
    return Truth(values, np.pi * radius**2, *drag, rng.uniform(0.6, 0.8), rng.uniform(2.0, 8.0))


def points(truth: Truth, rng: np.random.Generator) -> StaticMap:
    """Steady points on a grid of ten speeds and ten pitches."""
    w, b = (x.ravel() for x in np.meshgrid(np.linspace(1.0 / 3.0, 1.0, 10), np.linspace(-1.0 / 3.0, 1.0, 10)))
    watts = truth.power(w, b) * (1.0 + 0.01 * rng.standard_normal(len(w)))
    few = np.full(len(w), 100.0)
    omega, beta = 6000.0 * w, 15.0 * b - 5.0
    return StaticMap(omega, beta, omega, truth.thrust(w, b), 0.1 + 0.0 * w, few, "static.csv", {"power": watts})


def mission(top: float, rng: np.random.Generator) -> Record:
    """Set-points [N] of 120 s below the thrust `top`."""
    rows = [(0.0, 0.4), (15.0, 0.65), (35.0, 0.45), *((k, 0.45 + rng.uniform(-0.05, 0.05)) for k in np.arange(50.0, 80.0, 1.5))]
    rows += [(80.0, 0.25), (100.0, 0.4), (120.0, 0.4)]
    time, share = np.array(rows).T
    return Record({"time": time, "thrust_set": top * share}, "mission")


def reference(truth: Truth, thrust: np.ndarray) -> float:
    """Least energy [J] of any pairs with this course of `thrust` (n,) [N], every DT s: on a grid of LEVELS of thrust and of
    pitch, each with the speed of that thrust."""
    speeds, pitches = np.linspace(1.0 / 3.0, 1.0, 1001), np.linspace(-1.0 / 3.0, 1.0, LEVELS)
    levels = np.linspace(max(float(thrust.min()), 0.0), float(thrust.max()), LEVELS)
    least = np.full(LEVELS, np.inf)
    for b in pitches:
        shown = np.maximum.accumulate(truth.thrust(speeds, b))  # of the speeds with one thrust, the lowest takes least
        kept = np.append(True, np.diff(shown) > 0.0)
        w = np.interp(levels, shown[kept], speeds[kept], left=np.nan, right=np.nan)
        least = np.fmin(least, truth.power(w, b))
    return float(np.interp(thrust, levels, least).sum() * DT)


@dataclass(frozen=True)
class Flown:
    """Energy [J], squared error [s], thrust [N] every DT s, and large steps of a law."""

    energy: float
    error: float
    thrust: np.ndarray
    steps: tuple[Step, ...]

    @property
    def settling(self) -> list[float]:
        """Settling time of each step [s]; its whole duration if it never settles."""
        return [s.end - s.time if s.settling is None else s.settling for s in self.steps]


def flown(truth: Truth, settings: Mapping[str, float], profile: Record, rest: tuple[float, float]) -> Flown:
    """The mission on the rig under a controller's values, from the commands `rest`."""
    loop, course = ClosedLoop(BASE), Course.of(profile, DT, 15.0, rest=rest)
    run = loop.run(loop.vectors(truth.values, {}, settings), course)
    w, b = run["omega"] / 6000.0, (run["beta"] + 5.0) / 15.0
    error = float((((run["thrust"] - run["thrust_set"]) / 15.0) ** 2).sum() * DT)
    large = tuple(s for s in steps(run) if abs(s.after - s.before) >= LARGE * 15.0)
    return Flown(float(truth.power(w, b).sum() * DT), error, run["thrust"], large)


def settings_of(found: Allocation, own: Mapping[str, Mapping], allocated: Mapping[str, float]) -> dict[str, Mapping]:
    """A controller's values for each law."""
    best_fixed = {**own["speed_only"], "beta_fixed": found.fixed_beta}
    return {"speed only, best fixed pitch": best_fixed, "dual PID (paper)": own["dual"], "allocated": allocated}


def at_rest(found: Allocation, profile: Record) -> tuple[float, float]:
    """The pair of the profile's first set-point."""
    first = float(profile["thrust_set"][0])
    return float(np.interp(first, found.thrust, found.omega)), float(np.interp(first, found.thrust, found.beta))


def compared(seed: int) -> tuple[dict[str, Flown], float]:
    """(results of each law, energy of the reference [J]) on the rig of a seed."""
    rng = np.random.default_rng([seed, 44])
    truth = rig(rng)
    known = {n: v * (1.0 + 0.01 * rng.standard_normal()) for n, v in truth.values.items()}
    parameters = ParameterSet(BASE).replaced(known)
    fit = fit_power(steady_readings(points(truth, rng), parameters.values))
    powered = fit.added_to(parameters)
    found = allocate(powered, PowerModel(powered, fit.names, fit.covariance))
    laws = settings_of(found, controllers(parameters).settings, allocated_controller(found, powered).values)
    top = min(float(truth.thrust(np.array(1.0), np.array((found.fixed_beta + 5.0) / 15.0))), float(found.thrust[-1]))
    profile = mission(top, rng)
    rest = at_rest(found, profile)
    done = {name: flown(truth, settings, profile, rest) for name, settings in laws.items()}
    return done, reference(truth, done["allocated"].thrust)


SMALL = Plan(points=7, samples=250, settle=1.5, section=20.0)
"""A campaign of some ten minutes on the rig."""


def least_power(supply: float = 24.0) -> tuple[np.ndarray, np.ndarray]:
    """((n,) thrusts [N], least electrical power [W] of any settled pair) of the emulated rig, by its own equations."""
    rig = limits_of(PAPERS)
    throttle, beta = np.linspace(0.02, 1.0, 197), np.linspace(rig.beta_min, rig.beta_max, 121)
    levels, simulator = np.linspace(0.5, 14.0, LEVELS), Simulator(POWERTRAIN)
    least, at = np.full(LEVELS, np.inf), {name: k for k, name in enumerate(simulator.outputs)}
    leads = POWERTRAIN.values()["lead_resistance"]
    for pitch in beta:
        held = [{"throttle": np.full(2, t), "beta_ref": np.full(2, pitch), "supply": np.full(2, supply)} for t in throttle]
        settled = np.array([simulator.simulate({}, inputs, np.array([0.001]))[0] for inputs in held])
        current = throttle * settled[:, at["current"]]
        power, thrust, omega = current * (supply - leads * current), settled[:, at["thrust"]], settled[:, at["omega"]]
        kept = (omega >= rig.omega_min) & (omega <= rig.omega_max) & (np.maximum.accumulate(thrust) == thrust)
        if kept.sum() > 1:
            least = np.fmin(least, np.interp(levels, thrust[kept], power[kept], left=np.nan, right=np.nan))
    return levels, least


def emulated(seed: int = 0) -> None:
    """Print the energy of the mission on the emulated rig and in the loop of its identified plant, for each law."""
    calibration = replace(read_calibration(str(CALIBRATION)), supply=POWERED)
    setup = Setup(calibration, limits_of(PAPERS), Emulated(seed=seed), virtual=True, map_is_known=False)
    levels, least = least_power()
    with tempfile.TemporaryDirectory() as name:
        folder = OutputFolder(Path(name))
        measuring = Measuring(replace(setup, limits=steep(setup.limits)), SMALL, ("static", "open_loop"))
        measuring.run(folder, measuring.begin(folder.path, {"begun": ""}, False), None, print)
        parameters = identify(read_campaign(name)).parameters
        found = allocate(parameters, PowerModel.of(parameters))
        allocated = allocated_controller(found, parameters).values | {"sample_time": DT}
        laws = settings_of(found, controllers(parameters, sample_time=DT).settings, allocated)
        top = min(float(np.interp(found.fixed_beta, found.beta, found.thrust)), float(found.thrust[-1]))
        profile = mission(top, np.random.default_rng([seed, 46]))
        rest = at_rest(found, profile)
        print(f"\n{'law':30s} {'rig: energy [J]':>16s} {'reference [J]':>14s} {'over [%]':>9s} {'cosim: energy [J]':>18s}")
        for law, settings in laws.items():
            flown = run_on_rig(setup, KernelController(settings, DT), profile, Path(name), rest).record
            bound = float(np.interp(smoothed(flown, 0.1)["thrust"], levels, least).sum() * DT)
            taken = energy(flown)["value"]
            core = parameters.without_power
            loop = ClosedLoop(core.model)
            run = loop.run(loop.vectors(core.values, {}, settings), Course.of(profile, DT, 15.0, rest=rest))
            model = float(PowerModel.of(parameters).at(run["omega"], run["beta"]).sum() * DT)
            print(f"{law:30s} {taken:16.0f} {bound:14.0f} {100.0 * (taken / bound - 1.0):9.1f} {model:18.0f}", flush=True)


def main(parser, arguments):
    parser.add_argument("--rigs", type=int, default=20, metavar="N")
    parser.add_argument("--first-seed", type=int, default=0, metavar="N")
    parser.add_argument("--emulated", action="store_true", help="fly the mission on the emulated rig instead")
    parsed = parser.parse_args(arguments)
    if parsed.emulated:
        emulated(parsed.first_seed)
        return
    found = []
    for seed in range(parsed.first_seed, parsed.first_seed + parsed.rigs):
        found.append(compared(seed))
        done, least = found[-1]
        ratios = ", ".join(f"{name} {100.0 * (f.energy / least - 1.0):+.1f} %" for name, f in done.items())
        print(f"rig {seed}: reference {least:.0f} J; {ratios}", flush=True)
    header = ("law", "energy over the reference's [%]", "J [s]", "settling [s]", "overshoot [%]")
    print(f"\n{header[0]:30s} {header[1]:>32s} {header[2]:>8s} {header[3]:>20s} {header[4]:>14s}")
    for name in found[0][0]:
        over = [100.0 * (done[name].energy / least - 1.0) for done, least in found]
        settling = [s for done, _ in found for s in done[name].settling]
        beyond = [s.overshoot for done, _ in found for s in done[name].steps]
        error = np.median([done[name].error for done, _ in found])
        print(
            f"{name:30s} {f'{np.median(over):.1f}, worst {max(over):.1f}':>32s} {error:8.4f} "
            f"{f'{np.median(settling):.2f}, worst {max(settling):.2f}':>20s} {np.median(beyond):14.1f}"
        )
    pairs = [np.array([done[n].settling for n in ("allocated", "dual PID (paper)")]) for done, _ in found]
    slower = [float(np.mean(a > b + 2 * DT)) for a, b in pairs]
    within = sum(done["allocated"].energy <= 1.02 * least for done, least in found)
    print(f"allocated: within 2 % of the reference's energy on {within} of {len(found)} rigs; ", end="")
    print(f"{100.0 * np.mean(slower):.0f} % of the large steps settle later than under the paper's law")
