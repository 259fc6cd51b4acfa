"""Logs of a user, from the folder to the table: which are accepted, and fits in both directions."""

import csv

import numpy as np
import pytest
from scipy.signal import lfilter
from studies import measured

from identification.logs.mapping import FILE

SECONDS, NOISE = 20.0, 0.05
LEFT = np.exp(-0.001 / 0.1)
"""Remainder of a lag of 0.1 s after 1 ms."""

G = 9.80665e-3
"""N per gf."""


def stand(path, day: int, columns=("Zeit [ms]", "Soll [rpm]", "Ist [rpm]", "Schub [gf]"), every: int = 20):
    """A day's log of a fixed-pitch stand in its own table, a row `every` ms: one lag, one mark a revolution, and a steady map
    that is 2 % larger the next day."""
    rng = np.random.default_rng(day)
    time = np.arange(0.0, SECONDS, 0.001)
    command = rng.uniform(2500.0, 5800.0, 40)[(time / 0.5).astype(int)]
    speed = lfilter([0.0, 1.0 - LEFT], [1.0, -LEFT], command, zi=command[:1])[0]
    turn = 60.0 / speed  # the pulse came half a revolution ago on average, with the mean of the whole one before
    covered = np.cumsum(speed) * 0.001
    mean = (np.interp(time - 0.5 * turn, time, covered) - np.interp(time - 1.5 * turn, time, covered)) / turn
    thrust = (1.0 + 0.02 * day) * 10.0 * (speed / 6000.0) ** 2 + rng.normal(0.0, NOISE, len(time))
    mean[time < 0.1] = command[0]
    rows = slice(None, None, every)
    time, command, mean, thrust = time[rows], command[rows], mean[rows], thrust[rows]
    values = 7000.0 + 1e3 * time, command, mean + rng.normal(0.0, 3.0, len(time)), thrust / G
    with path.open("w", newline="") as file:
        writer = csv.writer(file, delimiter=";")
        writer.writerow(columns)
        writer.writerows([[f"{v:.4f}".replace(".", ",") for v in row] for row in zip(*values, strict=True)])


MAPPING = """format = "vpp-mapping/1"
[open_loop.columns]
time = "Zeit [ms]:ms"
omega_ref = "Soll [rpm]:rpm"
omega = "Ist [rpm]:rpm"
thrust = "Schub [gf]:gf"
"""


def test_two_logs_beside_a_mapping_are_fitted_one_way_and_the_other(tmp_path, capsys):
    """A lag and the steady map describe each day. The other day's thrust is 2 % larger, which its own map absorbs, so that
    noise remains."""
    folder = tmp_path / "logs" / "stand"
    folder.mkdir(parents=True)
    for day in (0, 1):
        stand(folder / f"day{day}.csv", day)
    (folder / FILE).write_text(MAPPING)
    rows = list(measured.found(tmp_path / "logs", look=False))
    assert [r.name for r in rows] == ["day0 -> day1", "day1 -> day0"]
    for r in rows:
        assert 0.08 < r.identified < 0.25
        assert r.floor == pytest.approx(NOISE, rel=0.1)
    assert "day0 fitted" in capsys.readouterr().out
