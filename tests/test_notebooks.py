"""The notebooks run from top to bottom in their own kernel, with plausible numbers."""

import ast
import asyncio
import os
import re
from pathlib import Path

import nbformat
import pytest
from nbclient import NotebookClient

import vpp_fmu as vpp
from vpp_fmu.files import OutputFolder
from vpp_fmu.record import write_record

ROOT = Path(__file__).resolve().parents[1]
NOTEBOOKS = ROOT / "identification" / "notebooks"


def run(name: str, folder: Path, asked: str, **replaced: str):
    """The value of an expression after the last cell of a notebook run in `folder`, with some lines replaced."""
    notebook = nbformat.read(NOTEBOOKS / name, as_version=4)
    for old, new in replaced.items():
        cell = next(cell for cell in notebook.cells if re.search(rf"^{old} = .*$", cell.source, re.MULTILINE))
        cell.source = re.sub(rf"^{old} = .*$", lambda _, new=new, old=old: f"{old} = {new}", cell.source, flags=re.MULTILINE)
    notebook.cells.append(nbformat.v4.new_code_cell(f"print(repr({asked}))"))
    client = NotebookClient(notebook, timeout=300, kernel_name="python3", resources={"metadata": {"path": str(folder)}})
    asyncio.run(client.async_execute())  # its own `execute` leaves an event loop open
    return ast.literal_eval(notebook.cells[-1].outputs[0].text)


@pytest.fixture(autouse=True)
def kernel(monkeypatch, tmp_path):
    """The kernel imports this checkout and leaves nothing in the home folder."""
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(filter(None, (str(ROOT), os.environ.get("PYTHONPATH")))))
    monkeypatch.setenv("IPYTHONDIR", str(tmp_path / "ipython"))
    monkeypatch.setenv("JUPYTER_PLATFORM_DIRS", "1")


@pytest.mark.parametrize("path", sorted(NOTEBOOKS.glob("*.ipynb")), ids=lambda path: path.stem)
def test_a_notebook_is_valid_and_has_no_outputs(path):
    notebook = nbformat.read(path, as_version=4)
    nbformat.validate(notebook)
    for cell in notebook.cells:
        assert not cell.get("outputs")
        assert cell.get("execution_count") is None


@pytest.fixture
def short(tmp_path):
    """The first minute of the example's long records, to save time."""
    campaign, folder = vpp.read_campaign(vpp.example_campaign()), OutputFolder(tmp_path / "short")
    for name in ("open_loop", "repeat", "validation"):
        write_record(folder, f"{name}.csv", getattr(campaign, name).part(slice(15_000)))
    return folder.path


@pytest.mark.slow
def test_the_main_job(short, tmp_path):
    found = run(
        "campaign_to_fmu.ipynb",
        tmp_path,
        "(found.verdict, found.effects, before, after, diagnosis['noise_floor_thrust'], diagnosis['before']['rmse_thrust'],"
        " diagnosis['after']['rmse_thrust'], float(np.std(record['thrust'])))",
        campaign=f"vpp.read_campaign({str(short)!r})",
        EFFECTS='["pitch_command_deadband", "pitch_delay"]',
    )
    verdict, effects, before, after, noise, said_before, said_after, spread = found
    assert (verdict, effects) == ("attributed", ("pitch_command_deadband",))
    assert noise < after < 1.1 * noise < 1.3 * noise < before < 0.2 * spread
    assert (before, after) == (pytest.approx(said_before, rel=0.02), pytest.approx(said_after, rel=0.02))


@pytest.mark.slow
def test_an_effect_of_ones_own(tmp_path):
    found = run(
        "effect_of_your_own.ipynb",
        tmp_path,
        "(checked, found.effects, [values[f'load_cell_creep.{n}'] for n in ('share', 'time_constant')],"
        " [found.parameters.estimates[f'load_cell_creep.{n}'].std for n in ('share', 'time_constant')],"
        " variables['load_cell_creep.share'][1], list(settled.values()))",
    )
    checked, effects, values, stds, start, (before, stepped, crept) = found
    assert (checked, effects) == (0, ("load_cell_creep",))
    for value, std, truth in zip(values, stds, (0.06, 4.0), strict=True):
        assert abs(value - truth) < 5.0 * std
        assert std < 0.1 * truth
    assert float(start) == pytest.approx(values[0], rel=1e-6)
    share, time_constant = values  # a step of thrust: immediate but for the share, which follows with its time constant
    assert before < stepped < crept
    shown, whole = 1.0 + share * (1.0 - 2.718281828 ** (-1.0 / time_constant)), 1.0 + share
    whole_step, seen_step = (crept - before) / whole, stepped - before
    assert seen_step / whole_step == pytest.approx(shown, rel=0.02)


@pytest.mark.slow
def test_a_learned_controller(tmp_path):
    """The environment rewards a law that sees the error; the learned law completes a run on the emulated rig."""
    asked = "(sorted(rewards, key=rewards.get), observation.shape, code, sorted(p.name for p in Path('policy').iterdir()),"
    asked += " len(list(Path('flight').glob('runs/*/run.csv'))))"
    order, observed, code, files, runs = run("campaign_to_policy.ipynb", tmp_path, asked, GENERATIONS="3")
    assert order == ["random", "PI"]
    assert (observed, code, runs) == ((3,), 0, 1)
    assert {"policy.json", "learning_curve.csv", "report.html"} <= set(files)
