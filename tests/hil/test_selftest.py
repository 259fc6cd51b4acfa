import json

import pytest
from rigs import setup

from hil import selftest as module
from hil.emulator import i2c
from hil.emulator.rig import BUS
from hil.loop.session import Setup
from hil.selftest import selftest
from vpp_fmu.app.cli import main


def bad(found):
    return {check.what for check in found.checks if not check.good}


def test_a_good_rig_passes(tmp_path):
    found = selftest(setup(), 4.0, tmp_path)
    assert bad(found) == set()
    assert len(found.session.log) == 1000


@pytest.mark.parametrize(
    ("fault", "value", "found_bad"),
    [
        ("frozen", 1.0, {"faults", "adc, conversions", "load cell at rest"}),
        ("overload", 1.2, {"load cell at rest"}),
        ("not_acknowledged", 1e9, {"faults", "adc"}),
    ],
)
def test_a_bad_adc_is_found(tmp_path, monkeypatch, fault, value, found_bad):
    good = Setup.bench

    def spoilt(self):
        bench = good(self)
        shared = i2c.open_bus(bench.esc.duty_file.parents[3] / BUS)
        shared[fault] = value
        shared.close()
        return bench

    monkeypatch.setattr(Setup, "bench", spoilt)
    found = selftest(setup(), 4.0, tmp_path)
    assert found_bad <= bad(found)
    assert len(found.session.log) == 1000  # the other checks still run


def test_an_output_that_is_not_idle_is_found():
    outputs = module._outputs([("/sys/pwmchip0/pwm0/duty_cycle", 1_000_000, "1500000")])
    assert not outputs[0].good
    assert "1500000 ns" in outputs[0].found


def test_the_command_in_real_time(tmp_path, capsys):
    out = tmp_path / "out"
    code = main(["hil", "selftest", "--seconds", "1.5", "-o", str(out)])
    facts = json.loads((out / "hil.json").read_text())
    checks = {check["what"]: check for check in facts["checks"]}
    # The timing depends on the machine; the completeness of the log does not.
    assert checks["log"]["good"]
    assert facts["log"]["rows"] == facts["log"]["ticks"] == facts["timing"]["ticks"]
    assert checks["output pwm0"]["good"]
    assert sum(part["ticks"] for part in facts["timing"]["histogram_us"]) == facts["timing"]["ticks"]
    assert code in (0, 2)
    assert "p99.9" in capsys.readouterr().out
    assert ">99.9 %<" in (out / "report.html").read_text()
