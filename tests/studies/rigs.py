"""python -m tests.studies rigs: are rigs of three sizes identified and diagnosed equally well?

Campaigns of a micro, a paper-sized and a big rig, measured on the studies' emulator, which shares no code with the project's
kernel. Identification uses the static map, the steps, and an open-loop record with its repeat, under white noise. Errors of the
nine parameters are compared with the Cramer-Rao bound of thrust and static map. The bound and the fit use thrust alone; a
second column adds the speed channel to the fit, and may fall below the bound. Diagnosis: six effects of full size, each alone
on a rig.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from threadpoolctl import threadpool_limits

from identification.fit.problem import Problem
from identification.fit.refine import BASE_PARAMETERS, independent_readings
from identification.identify import identify
from identification.static.static_map import TERMS, design
from identification.workers import spread
from vpp_fmu.campaign import Campaign
from vpp_fmu.kernel.plant import BASE
from vpp_fmu.record import Record

from . import scores
from .cases import WHOLE, Case, draw
from .diagnosis import rows as diagnosed
from .rig import SIZES, Rig, campaign
from .synthetic import covariance

RATES = {"micro": 1000, "paper": 250, "big": 100}
"""Hz of each rig's logger."""

SECONDS = 30.0, 90.0, 120.0
"""s of the open-loop record: the least on any rig, that on the paper's, and the most on any."""

EFFECTS = (
    "pitch_command_deadband",
    "pitch_backlash",
    "pitch_rate_limit",
    "speed_saturation",
    "pitch_speed_coupling",
    "thrust_gain_drift",
)

AIM = 1.1
"""Root mean square error over the bound's."""


@dataclass(frozen=True)
class Trials:
    """Results of campaigns, one a row (campaigns, parameters): errors of the fit to `thrust` alone and of the fit to thrust and
    speed (`both`) over the bound's standard deviation; that over the true value (`bound`); whether the 95 % interval contains
    the truth (`covered`). `distance` (campaigns, 2): squared error of both fits in the bound's metric, 1 a parameter at the
    bound.
    """

    thrust: np.ndarray
    both: np.ndarray
    bound: np.ndarray
    covered: np.ndarray
    distance: np.ndarray


def main(parser, arguments):
    parser.add_argument("--seeds", type=int, default=40, metavar="N", help="campaigns to identify (default: %(default)s)")
    parser.add_argument("--diagnoses", type=int, default=1, metavar="N", help="rigs for each effect (default: %(default)s)")
    parser.add_argument("--first-seed", type=int, default=0, metavar="K", help="of both (default: %(default)s)")
    parser.add_argument("--sizes", default=",".join(SIZES), metavar="A,B", help="of %(default)s")
    parser.add_argument("--effects", default=",".join(EFFECTS), metavar="A,B", help="(default: %(default)s)")
    parser.add_argument("--rate", type=int, metavar="HZ", help=f"of all loggers (default: {RATES})")
    parser.add_argument("--noise", default="AR", help="of the campaigns to diagnose (default: %(default)s)")
    parser.add_argument("--workers", type=int, default=2, metavar="N", help="campaigns side by side (default: %(default)s)")
    parser.add_argument(
        "--limit", type=float, default=900.0, metavar="S", help="seconds for a diagnosis (default: %(default)g)"
    )
    options = parser.parse_args(arguments)
    sizes = {name: options.rate or RATES[name] for name in options.sizes.split(",")}
    seeds = range(options.first_seed, options.first_seed + options.seeds)
    for name, rate in sizes.items() if options.seeds else ():
        show(name, rate, trials(name, rate, seeds, options.workers))
    if options.diagnoses:
        last = options.first_seed + options.diagnoses
        wanted = [
            whole(seed, size, rate, hidden=(effect,), noise=options.noise)
            for size, rate in sizes.items()
            for effect in options.effects.split(",")
            for seed in range(options.first_seed, last)
        ]
        show_diagnoses(wanted, options.workers, options.limit)


def whole(seed: int, size: str, rate: int, kind: str = "single", **given) -> Case:
    """A complete campaign of a rig, with hidden effects of full size and the noise of the shared records."""
    low, usual, high = SECONDS
    seconds = float(np.clip(usual * SIZES[size].slow, low, high))
    return draw(seed, kind, size=size, rate=rate, seconds=seconds, strength=1.0, level=1.0, locked=True, **WHOLE, **given)


def trials(size: str, rate: int, seeds: Sequence[int], workers: int = 1) -> Trials:
    """Identify a campaign of each seed's rig."""
    found = spread(partial(_trial, size=size, rate=rate), seeds, workers, what=f"{size}, campaigns")
    return Trials(*(np.array(column) for column in zip(*found, strict=True)))


@threadpool_limits.wrap(limits=1)
def _trial(seed: int, size: str, rate: int) -> tuple[np.ndarray, ...]:
    case = whole(seed, size, rate, "none", noise="white")
    rig = replace(case.rig, vibration=0.0)  # white noise alone, for which the bound is known
    measured = campaign(rig, case.random(3), replace(case.factors.files, validation=False))
    truth = rig.truth()
    true, least = np.array([truth[n] for n in BASE_PARAMETERS]), bound(measured, rig)
    std = np.sqrt(np.diag(least))
    alone, both = identify(_without_speed(measured), seed=seed), identify(measured, seed=seed)
    low, high = alone.refinement.uncertainty.intervals.T
    errors = [np.array([f.parameters.values[n] for n in BASE_PARAMETERS]) - true for f in (alone, both)]
    distance = [e @ np.linalg.solve(least, e) for e in errors]
    return errors[0] / std, errors[1] / std, std / np.abs(true), (low <= true) & (true <= high), distance


def _without_speed(measured: Campaign) -> Campaign:
    """The same campaign without the measured speed."""

    def bare(record: Record) -> Record:
        return Record({n: c for n, c in record.columns.items() if n != "omega"}, record.source)

    records = {n: bare(getattr(measured, n)) for n in ("open_loop", "repeat")}
    return replace(measured, steps=tuple(map(bare, measured.steps)), **records)


def bound(measured: Campaign, rig: Rig) -> np.ndarray:
    """The Cramer-Rao bound (n, n) of BASE_PARAMETERS from the thrust of open loop and repeat and from the static map, at the
    truth, white noise."""
    model, truth, std = BASE.sized(measured.rig.scales), rig.truth(), float(np.sqrt(rig.noise.power(np.ones(1))[0]))
    records = [r for r in (measured.open_loop, measured.repeat) if r is not None]
    experiments = [e for r in records for e in independent_readings([r], model.values(truth), ("thrust",))]
    _, jacobian = Problem(model, experiments, model.values(truth), BASE_PARAMETERS).rows(truth)
    information = np.linalg.inv(covariance(jacobian * model.values(truth)["thrust_scale"], std))
    static = measured.static
    terms = design(static.omega_ref, static.beta_ref, truth) * truth["thrust_scale"] * np.sqrt(static.samples)[:, None] / std
    places = [BASE_PARAMETERS.index(n) for n in TERMS]
    information[np.ix_(places, places)] += terms.T @ terms
    return np.linalg.inv(information)


def show(size: str, rate: int, found: Trials) -> None:
    """Print the errors of the parameters of one rig over the bound."""
    n, s = len(found.bound), SIZES[size]
    print(
        f"\n{size}: {s.thrust:g} N, {s.speed:g} rpm, {rate} Hz, {n} campaigns, white noise. Aim: rmse at most {AIM} of bound."
    )
    print(f"{'':12} {'bound %':>9} {'rmse/bound':>16} {'bias/bound':>11} {'in the 95 %':>13} {'with speed, rmse/bound':>24}")
    for k, name in enumerate(BASE_PARAMETERS):
        line = (
            f"{name:12} {100 * np.median(found.bound[:, k]):9.3f} {_rms(found.thrust[:, k])} {found.thrust[:, k].mean():11.2f}"
        )
        print(f"{line} {100 * found.covered[:, k].mean():11.0f} % {_rms(found.both[:, k]):>24}")
    alone, both = np.sqrt(found.distance / len(BASE_PARAMETERS)).T
    line = f"{'all together':12} {'':9} {_rms(alone)} {'':11} {100 * found.covered.mean():11.1f} %"
    print(f"{line} {_rms(both):>24}", flush=True)


def _rms(ratios: np.ndarray) -> str:
    """Root mean square and its standard error, over the campaigns."""
    square = ratios**2
    rms = np.sqrt(square.mean())
    return f"{rms:7.3f} ± {square.std() / np.sqrt(len(square)) / (2.0 * rms):.3f}".rjust(16)


def show_diagnoses(wanted: Sequence[Case], workers: int, limit: float) -> None:
    """Diagnose, and print a line for each case as it is done, and the totals."""
    print("\nDiagnosis: full size, open loop, repeat, validation, static map and steps. Error in N on a record nobody saw.")
    heads = f"{'rig':6} {'Hz':>5} {'s':>4} {'hidden':24} {'verdict':12} {'named':32} {'true':>9} {'found':>20}"
    print(f"{heads} {'before':>8} {'after':>8} {'s':>5} {'CPU':>5} {'MB':>5}")
    found = []
    for c in diagnosed(wanted, workers, 1, limit):
        found.append(c)
        print(_line(c), flush=True)
    done = [c for c in found if not c["failed"]]
    for size in dict.fromkeys(c["factors"]["size"] for c in done):
        print(
            scores.share(f"{size}: named", scores.hit, [c for c in found if c["factors"]["size"] == size and not c["failed"]])
        )
    print(scores.share("called wrong", scores.wrong, done))


def _line(c: dict) -> str:
    f = c["factors"]
    head = f"{f['size']:6} {f['rate']:5} {f['seconds']:4.0f} {c['hidden'][0]:24}"
    if c["failed"]:
        return f"{head} {c['failed']}"
    rivals = sorted({n for others in c["family"].values() for n in others})
    names = "+".join(c["effects"]) + (f" ~ {', '.join(rivals)}" if rivals else "")
    true, value = next(((f"{p[0]:.4g}", f"{p[1]:.4g} ± {p[2]:.2g}") for p in c["parameters"].values()), ("", ""))
    before, after = c["true_error"]
    tail = f"{before:8.3g} {after:8.3g} {c['seconds']:5.0f} {c['cpu']:5.0f} {c['mb']:5.0f}"
    return f"{head} {c['verdict']:12} {names[:32]:32} {true:>9} {value:>20} {tail}"
