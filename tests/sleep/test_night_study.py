"""Nights for a study: what identifies the sleeper is in no file, and what is measured is."""

from __future__ import annotations

import json
from pathlib import Path

import edfio
import numpy as np
import pytest

from kinegraph.devices.reports.night import archive
from tests.sleep.test_nights_weeks import logged
from tests.support.command_line import Command, refused


@pytest.fixture
def exported(tmp_path: Path, kinegraph: Command) -> Path:
    for day in ("2026-11-05", "2026-11-07"):
        folder = logged(tmp_path / "nights", f"{day}T23:10", "w" + "s" * 8, sleeper="Martina")
        facts = archive.Facts.load(folder)
        facts.session = {"subject": "Martina Muster", "note": "after the operation"}
        facts.settings = [["home", "devices.mqtt.MqttOutlet", "host: martina.example"]]
        facts.exits = [[facts.begun, "in"]]
        facts.save(folder)
    command = ("sleep", "nights", "study", "--path", str(tmp_path / "nights"), "--sleeper", "Martina")
    assert kinegraph(*command, "--code", "P01", "-o", str(tmp_path / "study"))[0] == 0
    return tmp_path / "study" / "P01"


def test_no_name_place_setting_or_date_is_in_any_file(exported: Path) -> None:
    files = [path for path in exported.rglob("*") if path.is_file()]
    assert {path.name for path in files} == {"epochs.csv", "night.json", "hypnogram.edf"} and len(files) == 6
    for path in files:
        content = path.read_bytes().lower()
        for word in (b"martina", b"muster", b"operation", b"berlin", b"2026", b"26-nov", b"nov-2026", b"05.11.26"):
            assert word not in content, (path, word)


def test_times_of_day_weekdays_and_days_between_nights_stay(exported: Path) -> None:
    first, second = (archive.Facts.load(exported / name) for name in ("1", "2"))
    begun = [archive.clock(facts.begun, archive.zone_of("UTC")) for facts in (first, second)]
    assert [f"{t:%Y-%m-%d %a %H:%M}" for t in begun] == ["2000-01-06 Thu 23:10", "2000-01-08 Sat 23:10"]
    epochs = archive.read_epochs(exported / "1")
    assert len(epochs) == 540 and (epochs.texts["state"] == "sleep").sum() == 480
    assert first.numbers["onset"] == first.begun == epochs.onset[0] == first.exits[0][0]
    assert first.numbers["tst"] == 240.0
    edf = edfio.read_edf(exported / "1" / "hypnogram.edf")
    assert f"{edf.startdatetime:%H:%M}" == "23:10" and edf.local_patient_identification.startswith("P01")


def test_a_code_is_asked_for_and_nothing_is_written_twice(exported: Path, tmp_path: Path, kinegraph: Command) -> None:
    command = ("sleep", "nights", "study", "--path", str(tmp_path / "nights"), "--sleeper", "Martina")
    refused(kinegraph(*command, "-o", str(tmp_path / "other")), "such as P01")
    refused(kinegraph(*command, "--code", "P01", "-o", str(tmp_path / "study")), "exists")
    assert json.loads((exported / "2" / "night.json").read_text())["sleeper"] == "P01"
    assert np.isfinite(archive.read_epochs(exported / "2").onset).all()
