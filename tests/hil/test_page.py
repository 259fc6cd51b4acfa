"""The operator's page: access to it, its contents, STOP as Ctrl-C, and a rig that never needs it."""

import contextlib
import http.client
import json
import os
import re
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path
from urllib.parse import urlsplit

import pytest
from rigs import CALIBRATION, begun

from hil.devices.calibration import to_json
from hil.devices.supply import Input
from hil.loop.columns import COLUMNS, LEARNED
from hil.loop.log import Column, ProcessLog
from hil.loop.session import read_log
from hil.page.operator_page import OperatorPage
from hil.safety.faults import FaultKind
from hil.safety.stop import StopSignals
from tests.browser import browser
from tests.hil.disk import esc_of
from tests.hil.faults import CUT, RAMP
from vpp_fmu.kernel.plant import plant
from vpp_fmu.parameters import ParameterSet

ROOT = Path(__file__).parents[2]
PATIENCE = 60.0

pytest.importorskip("tornado", reason="needs the extra 'watch': tornado")


@pytest.fixture
def page():
    one = OperatorPage({"rig": "emulated", "calibration": {}, "twin": TWIN})
    yield one
    one.close("as planned")


def asked(address: str, method: str = "GET", **headers) -> int:
    """Status of a request with the given headers."""
    to = urlsplit(address)
    connection = http.client.HTTPConnection(to.hostname, to.port, timeout=10.0)
    try:
        connection.request(method, to.path, headers={name.replace("_", "-"): value for name, value in headers.items()})
        return connection.getresponse().status
    finally:
        connection.close()


def streamed(address: str, enough) -> dict:
    """The page's stream from the beginning, merged, once `enough(merged)`."""
    whole = {"curves": [], "events": [], "map": []}
    to = urlsplit(address)
    connection = http.client.HTTPConnection(to.hostname, to.port, timeout=PATIENCE)
    connection.request("GET", f"{to.path}stream")
    lines, line = connection.getresponse(), b""
    try:
        while not enough(whole):
            line += (got := lines.readline())
            assert got, f"the page has gone; the last it said: {whole.get('ended')}, {whole['events'][-2:]}"
            if line.endswith(b"\n\n"):  # else it goes on in the next chunk
                message, line = json.loads(line.removeprefix(b"data: ")), b""
                whole = {**whole, **message, **{k: whole[k] + message[k] for k in ("curves", "events", "map")}}
    finally:
        connection.close()
    return whole


def test_view_and_stop_need_the_token_and_the_loopback_name(page):
    base, _, token = page.address.rstrip("/").rpartition("/")
    port = urlsplit(page.address).port
    assert len(token) >= 32  # 192 bits
    with StopSignals(lambda: page.pressed) as signals:
        statuses = {
            "the page": asked(page.address),
            "through a tunnel": asked(page.address, Host="localhost:9000"),
            "no token": asked(f"{base}/"),
            "wrong token": asked(f"{base}/{'x' * len(token)}/"),
            "a file of this machine": asked(f"{page.address}../../../etc/passwd"),
            "a name that is rebound": asked(page.address, Host=f"rig.example:{port}"),
            "a name that only looks so": asked(page.address, Host=f"127.0.0.1.example:{port}"),
            "STOP by a link": asked(f"{page.address}stop"),
            "another method": asked(page.address, "DELETE"),
            "writing to the page": asked(page.address, "POST"),
            "STOP without the token": asked(f"{base}/{'x' * len(token)}/stop", "POST"),
            "STOP by a rebound name": asked(f"{page.address}stop", "POST", Host=f"rig.example:{port}"),
            "STOP from another page": asked(f"{page.address}stop", "POST", Origin="http://rig.example"),
            "STOP from another port": asked(f"{page.address}stop", "POST", Origin="http://127.0.0.1:1"),
            "STOP from a frame": asked(f"{page.address}stop", "POST", Sec_Fetch_Site="cross-site"),
        }
        assert signals.asked is None
        assert not page.pressed
        own = f"http://127.0.0.1:{port}"
        assert asked(f"{page.address}stop", "POST", Origin=own, Sec_Fetch_Site="same-origin") == 200
        assert (signals.asked.kind, signals.asked.detail) == (FaultKind.INTERRUPTED, "STOP on the page")
        assert asked(f"{page.address}stop", "POST", Origin=own) == 200
        assert signals.asked.kind is FaultKind.INTERRUPTED_TWICE  # as Ctrl-C twice: idle at once
        page.end("as planned")
        while asked(f"{page.address}stop", "POST", Origin=own) != 409:  # nothing turns any more
            pass
    refused = {name: status for name, status in statuses.items() if status != 200}
    assert set(statuses) - set(refused) == {"the page", "through a tunnel"}
    assert set(refused.values()) == {403, 404, 405}


TWIN = {
    "certain": 2.0,
    "adapted": {
        "sensor_gain.gain": {"start": 1.0, "change": 0.25, "unit": "1", "description": "thrust reading over thrust"},
        "tau_beta_1": {"start": 0.16, "change": 0.08, "unit": "s", "description": "time constant of a lag"},
    },
}
"""Entry of hil.json at the start for a twin of these parameters."""
PARTS = [f"{kind}.{name}" for kind in ("adapted", "std") for name in TWIN["adapted"]]
LEARNS = ("band", "alarm", "direction", "changes", *PARTS)
"""Outputs of the twin that the page reads."""


def learned(folder: Path, rows: int, closed: range, alarm: int) -> ProcessLog:
    """A log with a twin beside the loop in the rows `closed`; its residual is the row's number in mN. From the row
    `alarm` on, its gain is 0.8 +- 0.05 and its alarm is on."""
    columns = [*COLUMNS, *(Column(LEARNED + name) for name in LEARNS)]
    log = ProcessLog(folder / "log.csv", columns)
    for k in range(rows):
        row = dict.fromkeys((column.name for column in columns), float("nan"))
        row |= {"time": 0.004 * k, "state": COLUMNS[1].words.index("run"), "thrust": 5.0, "alarm": 0.0}
        if k in closed:
            alarmed = k >= alarm
            says = [0.5, alarmed, alarmed, 0.0, 0.8 if alarmed else 1.0, 0.17, 0.05, 0.01]
            row |= {"residual": 0.001 * k, "alarm": float(alarmed)}
            row |= dict(zip((LEARNED + name for name in LEARNS), says, strict=True))
        log.put(*row.values())
    return log


def test_it_shows_means_of_the_logs_rows_events_and_the_twin(page, tmp_path):
    log = learned(tmp_path, 1001, range(250, 900), 600)
    page.part("static", grid={"speeds": [1.0, 2.0], "pitches": [0.0]}, parts=["static", "steps"])
    page.follow(log)
    log.note({"time": 1.0, "state": "run", "why": "twin: alarm: off"})
    log.done = 0.5
    log.note({"time": 2.0, "point": [1.0, 0.0, 3000.0, 4.5, 0.1, 10]})
    found = streamed(page.address, lambda whole: len(whole["curves"]) == 40 and whole["map"] and whole["events"])
    log.close()
    by_name = dict(zip(found["columns"], zip(*found["curves"], strict=True), strict=True))
    assert by_name["time"] == pytest.approx([0.004 * (25 * k + 24) for k in range(40)])  # of 25 rows each
    assert by_name["residual"][:10] == (None,) * 10
    assert by_name["residual"][10:36] == pytest.approx([0.001 * (25 * k + 12) for k in range(10, 36)])  # means
    assert by_name["twin.band"] == (None,) * 10 + (0.5,) * 26 + (None,) * 4
    twin = found["now"]["twin"]  # as it was when the loop was closed last
    assert (twin["alarm"], twin["direction"], twin["adapted.sensor_gain.gain"]) == (1.0, 1.0, 0.8)
    assert (found["now"]["residual"], found["now"]["state"], found["now"]["done"]) == (None, "run", 0.5)
    assert found["map"] == [[1.0, 0.0, 3000.0, 4.5]]
    assert found["events"] == [{"time": 1.0, "state": "run", "why": "twin: alarm: off"}]


def test_the_page_ends_with_its_parent_process():
    text = "from hil.page.operator_page import OperatorPage; p = OperatorPage({}); print(p.pid, flush=True); input()"
    parent = subprocess.Popen([sys.executable, "-c", text], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, cwd=ROOT)
    process = int(parent.stdout.readline())
    parent.kill()
    parent.communicate()
    end = time.monotonic() + PATIENCE
    while (state := _state(process)) not in ("", "Z") and time.monotonic() < end:
        time.sleep(0.05)
    assert state in ("", "Z")


def _state(process: int) -> str:
    try:
        return Path(f"/proc/{process}/stat").read_text().rpartition(") ")[2][0]
    except OSError:
        return ""


@contextlib.contextmanager
def running(folder: Path, *words):
    """`vpp hil run --watch` in real time, in a separate process: (process, the page's address)."""
    process = begun(folder, 20.0, "--watch", *words)
    try:
        said = next(line for line in process.stdout if "http://" in line)
        yield process, re.search(r"http://\S+", said)[0]
    finally:
        process.kill()
        process.communicate()


def until_idle(esc: int, began: float) -> float:
    """ms from `began` to the idle pulse."""
    end = time.monotonic() + PATIENCE
    while os.pread(esc, 32, 0).split(b"\n")[0] != b"1000000" and time.monotonic() < end:
        time.sleep(0.0005)
    return 1e3 * (time.monotonic() - began)


def causes(out: Path) -> list[str]:
    """The operator's causes of the run's end, in order, and its last state."""
    facts = json.loads((out / "hil.json").read_text())
    assert facts["status"] == "ended early"
    states = [(each["state"], each["why"]) for each in facts["transitions"]]
    return [f"{state}: {why}" for state, why in states if "operator" in why] + [states[-1][0]]


def test_stop_pressed_twice_is_idle_at_once(tmp_path, capsys):
    with running(tmp_path) as (process, address):
        streamed(address, lambda whole: whole.get("now", {}).get("state") == "run" and whole["now"]["throttle"] > 0.1)
        esc, own = esc_of(process.pid), f"http://{urlsplit(address).netloc}"
        assert os.pread(esc, 32, 0).split(b"\n")[0] != b"1000000"
        assert asked(f"{address}stop", "POST", Origin=own) == 200
        began = time.monotonic()
        assert asked(f"{address}stop", "POST", Origin=own) == 200
        took = until_idle(esc, began)
        os.close(esc)
        _, error = process.communicate(timeout=PATIENCE)
    with capsys.disabled():
        print(f"\nSTOP twice, without a browser: idle pulse {took:.1f} ms after the second")
    assert process.returncode == 2
    assert "vpp hil: operator: interrupted" in error
    *_, at_once, state = causes(tmp_path / "out")  # if both come within a tick, the first is not noted
    assert at_once.startswith("fault: operator: interrupted twice: STOP on the page 2 times")
    assert state == "fault"
    assert took < 10.0 * CUT  # tolerates a busy machine


def test_in_a_browser_curves_move_and_stop_stops(tmp_path, capsys):
    wired = tmp_path / "calibration.json"
    supply = {"voltage": Input("AIN0", 0.0, 11.0), "current": Input("AIN1", -25.0, 50.0)}
    wired.write_text(to_json(replace(CALIBRATION, supply=supply)))
    ParameterSet(plant()).save(tmp_path)
    error = {"steady": 0.5, "moving": 0.5, "freedom": 20}  # wide, so that no alarm occurs
    content = {"noise_floor_thrust": 0.13, "model_error": error, "effects": [], "parameters": {}}
    (tmp_path / "identification.json").write_text(json.dumps(content))
    words = ("--calibration", str(wired), "--parameters", str(tmp_path / "parameters.json"), "--twin")
    with browser(tmp_path / "browser") as seen, running(tmp_path, *words) as (process, address):
        seen.window(1100, 1400)
        seen.open(address)
        seen.wait_for("document.getElementById('state').textContent === 'run'")
        seen.wait_for("(document.getElementById('curves').data || [{y: []}])[0].y.length > 20")
        points = seen.run("document.getElementById('curves').data[0].y.length")
        seen.wait_for(f"document.getElementById('curves').data[0].y.length > {points + 10}")
        speed = "document.getElementById('curves').data.find((line) => line.name === 'speed').y.at(-1)"
        seen.wait_for(f"{speed} > 1500")
        tiles = seen.run("document.getElementById('tiles').textContent")
        assert re.search(r"supply2[34]\.\d V-?\d+\.\d A", tiles)  # the wired inputs, without temperature
        assert seen.run("document.querySelectorAll('#adapted tr').length") == 5
        seen.wait_for("document.getElementById('twin-says').textContent.startsWith('No alarm')")  # the loop is closed
        assert "lowest voltage" in seen.run("document.getElementById('limits').textContent")
        assert seen.run("getComputedStyle(document.getElementById('stop')).backgroundColor") == "rgb(198, 40, 40)"
        for name, *window in (("light", 1100, 1400, False), ("dark", 1100, 1400, True), ("phone", 390, 800, True)):
            seen.window(*window)
            seen.wait_for("new Promise(requestAnimationFrame).then(() => document.fonts.ready).then(() => true)")
            (tmp_path / f"{name}.png").write_bytes(seen.picture())
            assert seen.run("document.documentElement.scrollWidth <= innerWidth")  # nothing to the right of the window
        esc = esc_of(process.pid)
        took = until_idle(esc, seen.press("#stop"))
        os.close(esc)
        seen.wait_for("document.getElementById('banner').textContent.includes('It is over')")
        assert seen.run("document.getElementById('stop').disabled")
        assert "STOP on the page" in seen.run("document.getElementById('events').textContent")
        (tmp_path / "ended.png").write_bytes(seen.picture())
        process.communicate(timeout=PATIENCE)
    with capsys.disabled():
        print(f"\nSTOP in Chromium: idle pulse {took:.0f} ms after the press; pictures in {tmp_path}")
    assert process.returncode == 2
    assert causes(tmp_path / "out") == ["ramp down: operator: interrupted: STOP on the page", "safe"]
    assert took < RAMP + 10.0 * CUT
    rows = read_log(tmp_path / "out" / "log.csv")
    assert rows["missed"].sum() < 0.02 * len(rows)  # the browser does not slow the loop
