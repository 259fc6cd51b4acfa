"""The page of the library's effects: equations, parameters and responses, from their declarations."""

import numpy as np

from vpp_fmu.app.report.figures import two_records
from vpp_fmu.app.report.page import Page
from vpp_fmu.app.report.sentences import titled, words
from vpp_fmu.digits import number
from vpp_fmu.invariants import SHOWS, STEP
from vpp_fmu.kernel.plant import plant
from vpp_fmu.kernel.types import Effect
from vpp_fmu.native import Simulator
from vpp_fmu.record import Record

COMMANDS = (
    *((4000.0, 2.0), (4000.0, 3.0), (4000.0, 8.0), (4000.0, -2.0), (6000.0, -2.0), (6000.0, 10.0), (0.0, 4.0), (3000.0, 4.0)),
    *((5000.0, 4.0), (5000.0, 4.0), (5000.0, 4.0), (5000.0, 4.0)),
)
"""rpm, deg: small and large moves of the pitch, up and down, of the speed, a rest, both, and no move; each held for HOLD."""

HOLD = 3.0
"""s; also the longest time that is drawn."""

LOW = 0.85
"""Value of all other inputs from LATE on, such as the supply's voltage, as a share of the nominal one."""

LATE = 4.0 * HOLD
"""s"""

SEEN, FADED = 0.1, 0.03
"""Minimum share of the drawn range by which the lines must differ; share of the largest change at which the picture ends."""


def effects_page(effects: list[Effect], library: tuple[Effect, ...]) -> Page:
    """A section for each effect, in the order of the chain."""
    text = "Each is declared once; simulation, C, sensitivities, FMU variables and this page are made from the declaration."
    page = Page(
        "The effects", f"{len(effects)} effects that the plant may have, in their order from command to reading. {text}"
    )
    omega, beta = np.repeat(np.array(COMMANDS), round(HOLD / STEP), axis=0).T
    record = Record({"time": np.arange(len(omega)) * STEP, "omega_ref": omega, "beta_ref": beta}, "effects")
    for effect in effects:
        page.section(titled(effect.name), f"{effect.description[0].upper()}{effect.description[1:]}.\n\n{theory(effect)}")
        _add_parameters(page, effect)
        _add_response(page, effect, library, record)
    return page


def theory(effect: Effect) -> str:
    """The docstring of the effect's file, also of a user-defined one: equation, source, departures from it."""
    if effect.delays:
        equations = " and ".join(f"    {u}(t) acts at t + {p}" for u, p in effect.delays.items())
        return f"{equations}\n\nExact at any step: delayed commands are kept with the time at which they act."
    return (effect.step.__globals__.get("__doc__") or "").strip("\n")


def _add_parameters(page: Page, effect: Effect) -> None:
    rows = [
        (p.name, p.unit, p.description, p.minimum, p.maximum, effect.probe.get(p.name, p.default)) for p in effect.parameters
    ]
    caption = f"{effect.name}: bounds and probe on a rig of the paper's size; the probe is what is drawn."
    page.table(("parameter", "unit", "what", "from", "to", "probe"), rows, caption)


def _add_response(page: Page, effect: Effect, library, record: Record) -> None:
    """The output that it changes most, relative to the visible change, over the hold that shows the change best."""
    model, others = plant([effect.name], library), np.where(record.time < LATE, 1.0, LOW)
    commands = {u.name: np.full(len(record), 2.0 * STEP) if u.clock else u.nominal * others for u in model.inputs}
    values = [{effect.full(name): value for name, value in own.items()} for own in (effect.off, effect.probe)]
    off, on = (Simulator(model).simulate(each, commands | dict(record.columns), record.steps) for each in values)
    moved = np.sqrt(np.mean((on - off) ** 2, axis=0))
    k = int(np.argmax(moved / SHOWS)) if moved[0] < SHOWS[0] else 0
    hold = _best(off[:, k], on[:, k], SHOWS[k])
    rows, output = _rows(hold), model.outputs[k]
    change = np.abs(on[rows, k] - off[rows, k])
    until = int(np.flatnonzero(change > FADED * change.max())[-1])
    rows = slice(rows.start, rows.start + min(len(change), max(len(change) // 6, until + len(change) // 10)))
    title = f"At its probe it changes {output.description} by {number(float(change.max()))} {output.unit} at most"
    pair = ((name, record.time[rows], each[rows, k]) for name, each in (("without", off), (words(effect.name), on)))
    before, after = (f"{omega:g} rpm, {beta:g} deg" for omega, beta in (COMMANDS[max(0, hold - 1)], COMMANDS[hold]))
    now = f"; from {HOLD * hold:g} s on {after}" if after != before else ""
    page.figure(two_records(*pair, title, output.description, output.unit), f"Commands: {before}{now}.")


def _rows(hold: int) -> slice:
    """Rows of a hold, and some before its start."""
    rows = round(HOLD / STEP)
    return slice(max(0, hold * rows - rows // 20), (hold + 1) * rows)


def _best(off: np.ndarray, on: np.ndarray, least: float) -> int:
    """The hold that shows the change best: one with a move of the commands, if the change is visible beside the response.
    `least`: range that is drawn at least."""
    spans = [_rows(k) for k in range(len(COMMANDS))]
    shares = [np.max(np.abs(on[at] - off[at])) / max(np.ptp([on[at], off[at]]), least) for at in spans]
    best = max((k for k in range(1, len(COMMANDS)) if COMMANDS[k] != COMMANDS[k - 1]), key=shares.__getitem__)
    return best if shares[best] > SEEN else int(np.argmax(shares))
