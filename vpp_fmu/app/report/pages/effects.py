"""The page of the library's effects: equations, parameters and responses, from their declarations."""

import numpy as np

from vpp_fmu.app.report.figures.time import two_records
from vpp_fmu.app.report.page import Page
from vpp_fmu.digits import number
from vpp_fmu.invariants import SHOWS
from vpp_fmu.kernel.plant import BASE, plant
from vpp_fmu.kernel.types import Effect
from vpp_fmu.native import Simulator
from vpp_fmu.record import Record

STEP = 0.01

COMMANDS = ((4000.0, 2.0), (4000.0, 3.0), (4000.0, 8.0), (4000.0, -2.0), (5500.0, -2.0), (0.0, -2.0), (3000.0, 4.0))
"""rpm, deg: small and large moves of the pitch to both sides, of the speed, a rest, and both; each held for HOLD."""

HOLD = 2.0

MOVES = f"commands held for {HOLD:g} s: " + ", ".join(f"{omega:g} rpm {beta:g} deg" for omega, beta in COMMANDS)


def effects_page(effects: list[Effect], library: tuple[Effect, ...]) -> Page:
    """A section for each effect, in the order of the chain."""
    text = "Each is declared once; simulation, C, sensitivities, FMU variables and this page are made from the declaration."
    page = Page(
        "The effects", f"{len(effects)} effects that the plant may have, in their order from command to reading. {text}"
    )
    commands, steps = _commands()
    without = Simulator(BASE).simulate({}, commands, steps)
    for effect in effects:
        page.section(effect.name, f"{effect.description[0].upper()}{effect.description[1:]}.\n\n{theory(effect)}")
        _add_parameters(page, effect)
        _add_response(page, effect, library, commands, steps, without)
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
    caption = "Bounds and probe on a rig of the paper's size; the probe is what is drawn."
    page.table(("parameter", "unit", "what", "from", "to", "probe"), rows, caption)


def _add_response(page: Page, effect: Effect, library, commands, steps, without: np.ndarray) -> None:
    """The output that it changes most, relative to the visible change."""
    model, values = plant([effect.name], library), {effect.full(name): value for name, value in effect.probe.items()}
    on = Simulator(model).simulate(values, commands, steps)
    moved = np.sqrt(np.mean((on - without) ** 2, axis=0))
    k = int(np.argmax(moved / SHOWS)) if moved[0] < SHOWS[0] else 0
    output, time = model.outputs[k], commands["time"]
    title = f"At its probe it moves {output.description} by {number(float(moved[k]), 3)} {output.unit} rms"
    pair = ("without", time, without[:, k]), (effect.name, time, on[:, k])
    page.figure(two_records(*pair, title, output.name, output.unit), f"Without it and with it, under {MOVES}.")


def _commands() -> tuple[dict[str, np.ndarray], np.ndarray]:
    """A record's columns, and its steps."""
    rows = round(HOLD / STEP)
    omega, beta = np.repeat(np.array(COMMANDS), rows, axis=0).T
    record = Record({"time": np.arange(len(omega)) * STEP, "omega_ref": omega, "beta_ref": beta}, "effects")
    return dict(record.columns), record.steps
