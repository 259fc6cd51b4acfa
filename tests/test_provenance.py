"""The origin that results name, and the check that two files belong to the same model."""

import json
import re
from dataclasses import replace
from datetime import datetime, timedelta, timezone

import pytest
from builders import refusal

import vpp_fmu
from identification.demo import example_folder
from vpp_fmu.app.cli import main
from vpp_fmu.app.report.result import dated
from vpp_fmu.campaign import NEED
from vpp_fmu.date import EPOCH
from vpp_fmu.errors import BadInput
from vpp_fmu.files import OutputFolder
from vpp_fmu.kernel.controller import CONTROLLER
from vpp_fmu.kernel.plant import BASE, plant
from vpp_fmu.parameters import ParameterSet, check_same_model, read_parameters, to_json
from vpp_fmu.record import read_record, write_record

SET = ParameterSet(BASE, source={"made_by": "test"}).replaced({"c20": 0.35}, {"c20": 0.01})


@pytest.fixture(scope="module")
def campaign(tmp_path_factory):
    """Ten seconds of the example's open loop."""
    folder = tmp_path_factory.mktemp("monday")
    record = read_record(example_folder() / "open_loop.csv.gz", NEED).part(slice(0, 2500))
    write_record(OutputFolder(folder), "open_loop.csv", record)
    return folder


def test_the_date_is_the_runs_or_the_one_asked_for(monkeypatch):
    monkeypatch.delenv(EPOCH, raising=False)
    date = datetime.fromisoformat(dated(SET).source["date"])
    assert abs(date - datetime.now(timezone.utc)) < timedelta(minutes=1)
    monkeypatch.setenv(EPOCH, "86400")
    assert dated(SET).source["date"] == "1970-01-02T00:00:00+00:00"
    assert to_json(dated(SET)) == to_json(dated(SET))
    assert dated(SET).source["made_by"] == "test"


@pytest.mark.parametrize("epoch", ["yesterday", "", "1e9", "9" * 30])
def test_an_invalid_date_is_refused(monkeypatch, epoch):
    monkeypatch.setenv(EPOCH, epoch)
    with pytest.raises(BadInput, match=f"{EPOCH}: found .*, expected whole seconds since 1970"):
        dated(SET)


def test_identity_is_of_the_numbers_alone(tmp_path):
    assert re.fullmatch("[0-9a-f]{12}", SET.identity)
    (tmp_path / "a.json").write_text(to_json(dated(SET)))
    back = read_parameters(tmp_path / "a.json", plant)
    assert back.identity == SET.identity == back.source["identity"]
    assert replace(SET, source={}).identity == SET.identity
    assert SET.replaced({"c20": 0.35}, {"c20": 0.02}).identity == SET.identity
    others = [
        SET.replaced({"c20": 0.35000000000000003}),
        SET.replaced({"omega_scale": 6001.0}),
        ParameterSet(plant(["pitch_offset"])).replaced({"c20": 0.35}),
        ParameterSet(CONTROLLER),
    ]
    assert len({each.identity for each in (SET, *others)}) == 5


@pytest.mark.parametrize(
    ("content", "says"),
    [
        ({"parameters": {"c20": {"value": 0.35}}, "effects": []}, None),
        ({"parameters": {"c20": {"value": 0.35 * (1 + 1e-12)}}}, None),
        ({}, None),
        ({"parameters": {"c20": {"value": 0.3501}}}, 'parameters, "c20": found 0.3501, expected 0.35, the value in p.json'),
        ({"parameters": {"c99": {"value": 0.35}}}, 'parameters, "c99": found 0.35, expected a name in p.json'),
        ({"parameters": {"c20": {"value": None}}}, 'parameters, "c20": found null'),
        ({"effects": ["pitch_offset"]}, "effects: found pitch_offset, expected no effects, the model of p.json"),
        ({"parameters": [1]}, "parameters: found [1], expected an object"),
        ({"parameters": {"c20": 0.35}}, 'parameters, "c20": found 0.35, expected an object'),
        ([], "file: found [], expected an object"),
    ],
)
def test_an_identification_of_another_model_is_refused(tmp_path, content, says):
    path = tmp_path / "identification.json"
    path.write_text(json.dumps(content))
    if says is None:
        check_same_model(path, SET, "p.json")
        return
    said = refusal(check_same_model, path, SET, "p.json")
    assert said.startswith(f"{path}: ")
    assert says in said


def test_identify_says_where_its_parameters_come_from_and_repeats_to_the_byte(campaign, tmp_path, monkeypatch):
    monkeypatch.setenv(EPOCH, "1000000000")
    for out in ("first", "second"):
        assert main(["identify", str(campaign), "--starts", "1", "-o", str(tmp_path / out)]) == 0
    first, second = ((tmp_path / out / "parameters.json") for out in ("first", "second"))
    assert first.read_bytes() == second.read_bytes()
    found = read_parameters(first, plant)
    told = {name: found.source[name] for name in ("made_by", "campaign", "date", "version", "identity")}
    assert told == {
        "made_by": "vpp identify",
        "campaign": campaign.name,
        "date": "2001-09-09T01:46:40+00:00",
        "version": vpp_fmu.__version__,
        "identity": found.identity,
    }
    identification = tmp_path / "second" / "identification.json"
    check_same_model(identification, found, first)
    assert json.loads(identification.read_text())["effects"] == []
