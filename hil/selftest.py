"""Self-test of the rig without turning the rotor: timing of the loop, answers of the buses, plausibility of the calibration."""

import multiprocessing
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from hil.devices.calibration import Calibration
from hil.loop.rig import ENDINGS
from hil.loop.session import LOG, Session, Setup, session
from vpp_fmu.errors import VppError
from vpp_fmu.record import Record

HALF_SCALE = 16384
"""Counts: a load cell's zero beyond them leaves less than half of the range for the thrust."""


class SelfTestFailed(VppError):
    """A check was not passed."""


@dataclass(frozen=True)
class Check:
    """One check: its subject, whether it passed, and the finding."""

    what: str
    good: bool
    found: str


@dataclass(frozen=True, eq=False)
class SelfTest:
    """`checks`, the session, why it ended early (or ""); `load`: number of busy processes."""

    checks: tuple[Check, ...]
    session: Session
    ended: str
    load: int = 0

    def summary(self) -> dict:
        """The content of hil.json."""
        return self.session.summary() | {"load": self.load, "checks": [asdict(check) for check in self.checks]}

    @property
    def failure(self) -> SelfTestFailed | None:
        """SelfTestFailed if a check was not passed."""
        bad = [check.what for check in self.checks if not check.good]
        return SelfTestFailed(f"not good: {', '.join(bad)}") if bad else None


def selftest(setup: Setup, seconds: float, folder: Path, load: int = 0) -> SelfTest:
    """Tick for `seconds` with the idle pulse on the outputs, while `load` other processes are busy."""
    ended = ""
    with session(setup, folder / LOG, seconds) as one, busy(load):
        rig, count = one.rig, round(seconds / one.rig.dt)
        try:
            rig.idle(count)
        except ENDINGS as reason:
            ended = str(reason)
        faults = [str(fault) for fault in rig.states.faults]
        outputs = [(path, round(1e9 * pulse), Path(path).read_text().split()[0]) for path, pulse in rig.bench.outputs]
    checks = (*_timing(one), *_buses(one, faults, ended), *_calibration(setup.calibration, one.log), *_outputs(outputs))
    return SelfTest(checks, one, ended, load)


@contextmanager
def busy(count: int) -> Iterator[None]:
    """`count` processes that do nothing but compute, at ordinary priority."""
    context = multiprocessing.get_context("spawn")
    workers = [context.Process(target=_compute, daemon=True) for _ in range(count)]
    for worker in workers:
        worker.start()
    if count:
        time.sleep(1.0)  # until their imports are done
    try:
        yield
    finally:
        for worker in workers:
            worker.terminate()
            worker.join()


def _compute() -> None:
    numbers, parent = np.random.default_rng(0).standard_normal((200, 200)), multiprocessing.parent_process()
    while parent.is_alive():  # else it would outlive a killed parent
        np.linalg.svd(numbers)


def _timing(one: Session) -> list[Check]:
    log, logged, ticks, dt = one.log, one.logged, one.rig.ticks, one.rig.dt
    rows = logged.rows == ticks.ticks and logged.lost == 0 and len(log) == logged.rows
    checks = [
        Check("log", rows, f"{len(log)} rows in the file, {ticks.ticks} ticks, {logged.lost} lost {logged.failure}".strip())
    ]
    if timing := one.timing:
        p999, missed, share = timing.late[2], timing.missed, timing.missed / max(1, ticks.slot)
        text = f"p99.9 {1e6 * p999:.0f} us late, {missed} slots missed of {ticks.slot}"
        checks.append(Check("timing", p999 < 0.5 * dt and share < 1e-3, text))
    return checks


def _buses(one: Session, faults: list[str], ended: str) -> list[Check]:
    checks, log = [], one.log
    for device, counts in one.rig.counters.items():
        troubles = {name: n for name, n in counts.items() if name != "pulses" and n}
        share = sum(troubles.values()) / max(1, len(log))
        text = ", ".join(f"{name} {n}" for name, n in troubles.items()) or "nothing went wrong"
        faulty = any(fault.startswith(device) for fault in faults)
        checks.append(Check(device, share < 0.01 and not faulty, text))
    repeats = float(np.mean(np.diff(log["counts"]) == 0.0)) if len(log) > 1 else 1.0
    text = f"{repeats:.1%} of the readings equal the one before"
    fault = Check("faults", not faults and not ended, "; ".join([*faults, ended] if ended else faults) or "none")
    return [*checks, Check("adc, conversions", repeats < 0.3, text), fault]


def _calibration(calibration: Calibration, log: Record) -> list[Check]:
    counts, scale = log["counts"], abs(calibration.newton_per_count)
    noise, zero = float(counts.std()) * scale, float(counts.mean())
    off = abs(zero - calibration.zero) * scale
    text = f"{zero:.1f} counts, {off:.2f} N off the calibration's, noise {noise:.3f} N"
    return [
        Check("load cell at rest", off < 5.0 and 0.0 < noise < 0.3 and abs(zero) < HALF_SCALE, text),
        Check("calibration", True, f"sha256 {calibration.sha256}"),
    ]


def _outputs(outputs: list[tuple[str, int, str]]) -> list[Check]:
    return [
        Check(f"output {Path(path).parent.name}", found == str(idle), f"{found} ns, the idle pulse is {idle} ns")
        for path, idle, found in outputs
    ]
