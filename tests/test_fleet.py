"""Several campaigns diagnosed at once: results equal those of single diagnoses, on any kind of worker, in one table."""

import csv
import json

import numpy as np
import pytest
from builders import SHORT_CAMPAIGN
from threadpoolctl import threadpool_info, threadpool_limits

from identification.workers import spread
from tests.studies.cases import draw
from tests.studies.rig import save
from vpp_fmu.app.api import diagnose as command
from vpp_fmu.app.cli import main
from vpp_fmu.app.report.pages.fleet import Entry, FleetResult, ThrustMap, compared

FEW = ["--effects", "pitch_command_deadband", "--budget", "0"]


@pytest.fixture(scope="module")
def campaigns(tmp_path_factory):
    """Folders of campaigns: one with a dead band, one without a hidden effect, one empty."""
    folder, like = tmp_path_factory.mktemp("fleet"), SHORT_CAMPAIGN | {"steps": False, "static": False}
    for name, *case in (("2026-03-01", "single", (), FEW[1:2]), ("2026-03-08", "none")):
        made = draw(11, *case, **like)
        save(made.measured(), made.rig.size, folder / name)
    (folder / "empty").mkdir()
    return [str(folder / name) for name in ("2026-03-01", "2026-03-08", "empty")]


@pytest.fixture(scope="module")
def fleet(campaigns, tmp_path_factory):
    """Files of a diagnosis of them in two processes."""
    out = tmp_path_factory.mktemp("out") / "out"
    assert main(["diagnose", *campaigns, *FEW, "--workers", "2", "-o", str(out)]) == 2  # one is refused
    return out


def table(out) -> list[dict]:
    return list(csv.DictReader((out / "fleet.csv").read_text().splitlines()))


def test_each_row_of_the_table_agrees_with_the_files_of_its_campaign(fleet):
    first, second, empty = table(fleet)
    assert [r["verdict"] for r in (first, second, empty)] == ["attributed", "none", "refused"]
    assert [r["date"] for r in (first, second, empty)] == ["2026-03-01", "2026-03-08", ""]
    for row in (first, second):
        told = json.loads((fleet / row["name"] / "diagnosis.json").read_text())
        assert row["verdict"] == told["verdict"]
        assert float(row["error_before_N"]) == told["before"]["rmse_thrust"]
        assert float(row["error_after_N"]) == told["after"]["rmse_thrust"]
    width = json.loads((fleet / "2026-03-01" / "diagnosis.json").read_text())["effects"][0]["parameters"]["half_width"]
    assert float(first["pitch_command_deadband.half_width"]) == width["value"]
    assert second["pitch_command_deadband.half_width"] == ""
    (compared,) = (name for name in first if name.startswith("thrust_at_") and not name.endswith("_std"))
    assert float(first[compared]) == pytest.approx(float(second[compared]), rel=0.5)
    assert 0.0 < float(first[f"{compared}_std"]) < 0.1 * float(first[compared])
    assert "campaign folder: found none" in empty["refused"]
    assert not (fleet / "empty").exists()


def test_a_campaign_of_a_fleet_is_diagnosed_as_if_it_were_alone(fleet, campaigns, tmp_path):
    assert main(["diagnose", campaigns[0], *FEW, "-o", str(tmp_path)]) == 0
    for name in ("diagnosis.json", "next_experiment.csv", "parameters.ssv"):
        assert (tmp_path / name).read_bytes() == (fleet / "2026-03-01" / name).read_bytes()


def test_a_dask_cluster_writes_the_same_table(fleet, campaigns, tmp_path):
    distributed = pytest.importorskip("dask.distributed", reason="dask.distributed is not installed (the extra 'dask')")
    with distributed.LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster:
        words = ["--scheduler", cluster.scheduler_address, "-o", str(tmp_path)]
        assert main(["diagnose", *campaigns, *FEW, *words]) == 2
    assert (tmp_path / "fleet.csv").read_bytes() == (fleet / "fleet.csv").read_bytes()


def test_an_internal_error_in_one_campaign_does_not_stop_the_others(campaigns, tmp_path, monkeypatch, capsys):
    kept = command.diagnosed

    def breaks(campaign, *words, **asked):
        if campaign.folder.name == "2026-03-01":
            raise np.linalg.LinAlgError("did not converge")
        return kept(campaign, *words, **asked)

    monkeypatch.setattr(command, "diagnosed", breaks)
    assert main(["diagnose", *campaigns[:2], *FEW, "--workers", "1", "-o", str(tmp_path)]) == 2
    first, second = table(tmp_path)
    assert (first["verdict"], second["verdict"]) == ("refused", "none")
    assert "LinAlgError in test_fleet.py" in first["refused"]
    assert "1 refused: 2026-03-01" in capsys.readouterr().err


def threads(_) -> int:
    """Largest number of threads of a BLAS library."""
    return max(library["num_threads"] for library in threadpool_info())


def test_every_worker_has_one_thread_of_blas():
    """With two threads sums round otherwise than on a Dask worker, which has one."""
    with threadpool_limits(2):
        assert threads(None) == 2
        assert spread(threads, [None]) == [1]


def test_the_rig_with_less_thrust_is_named_and_leads_to_its_report():
    def measured(name, share, speed=6000.0):
        values = [share * c for c in (0.35, 0.06, 0.75, -0.19, -0.08)]
        scales = {"omega_scale": 6000.0, "beta_scale": 15.0, "beta_offset": 5.0, "thrust_scale": 15.0}
        own = ThrustMap(values, (1e-6 * np.eye(5)).tolist(), scales, (2000.0, speed), (-5.0, 10.0))
        return Entry(name, name, "", "none", (), 0.2, 0.2, 0.2, map=own)

    page = FleetResult(compared([measured("one", 1.0), measured("two", 1.0001, 5800.0), measured("rig 3", 0.95)])).page()
    assert "Thrust at 3900 rpm 2.5 deg: rig 3 is 5.0 % below the median." in page.summary
    assert '<a href="rig%203/report.html">rig 3</a>' in page.html()
    pair = FleetResult(compared([measured("one", 1.0), measured("rig 3", 0.95)])).page()
    assert "rig 3 is 5.0 % below one" in pair.summary
    alike = FleetResult(compared([measured("one", 1.0), measured("two", 1.0001)])).page()
    assert "No parameter differs between them by more than its uncertainty." in alike.summary
