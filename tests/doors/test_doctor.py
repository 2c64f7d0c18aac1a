"""`aridcal doctor`: a sound installation passes, and what is missing or broken is named with what mends it."""

from __future__ import annotations

import importlib.metadata
import sys
from pathlib import Path

from aridcal import doctor
from aridcal.doctor import Finding, checks


def wrong(found: list[Finding]) -> list[str]:
    return [c.what for c in found if c.remedy and not c.optional]


def test_a_sound_installation_passes_every_check_and_says_so(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert doctor.main([]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert not [line for line in lines if line.startswith("FAIL")]
    assert any(line.startswith("ok    round trip: ") for line in lines)
    assert any(line.startswith("ok    pin: ") for line in lines)
    assert list(tmp_path.iterdir()) == []


def test_every_required_library_has_a_line(tmp_path, monkeypatch):
    monkeypatch.setattr(doctor, "_round_trip", lambda: Finding("round trip", "left out"))
    found = [c.what for c in checks(tmp_path)]
    required = [r for r in importlib.metadata.requires("aridcal") or [] if "extra ==" not in r]
    assert len(required) > 10
    assert all(r.split(">")[0] in found for r in required)


def test_missing_old_and_broken_libraries_are_named_with_the_command_that_mends_them(monkeypatch):
    monkeypatch.setattr(
        importlib.metadata, "requires", lambda _: ["nowhere>=1", "numpy>=999", "rich>=13", "x; extra == 'dev'"]
    )
    monkeypatch.setitem(sys.modules, "rich", None)  # its import fails
    found = {c.what: c for c in doctor._libraries()}
    assert wrong(list(found.values())) == ["nowhere", "numpy", "rich"]
    assert found["nowhere"].found == "is not installed"
    assert found["numpy"].remedy == "pip install --upgrade 'numpy>=999'"
    assert "ImportError" in found["rich"].found or "ModuleNotFoundError" in found["rich"].found


def test_a_round_trip_that_breaks_or_ends_wrong_fails_with_its_reason(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(
        doctor, "SCENARIO", doctor.SCENARIO.replace("noise: {position: 1.0e-4", "noise: {position: 1.0e-3")
    )
    assert wrong([doctor._round_trip()]) == ["round trip"]
    monkeypatch.setattr(doctor, "ARM", "<robot/>")
    assert doctor.main([]) == 2
    out, err = capsys.readouterr()
    assert any(line.startswith("FAIL  round trip: failed: RobotError") for line in out.splitlines())
    assert "1 of these checks failed" in err


def test_a_folder_that_cannot_be_written_is_named():
    check = doctor._writable(Path("/proc"), "go elsewhere")
    assert check.remedy == "go elsewhere"
    assert "/proc" in check.found
