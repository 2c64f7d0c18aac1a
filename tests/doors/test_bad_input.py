"""Bad input, end to end: one clear message that names culprit and remedy, status 2, and nothing overwritten."""

from __future__ import annotations

import builtins
import io
import json
import os
import re
import signal
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
import robots

from aridcal import identify
from aridcal.engine.fit.least_squares import Fit
from aridcal.jobs.calibrate import pipeline

OLD = "an earlier result"
JOINTS = ["joint_1", "joint_2", "joint_3", "joint_4"]
ROBOT = {"urdf": "robot.urdf", "tip": "flange"}


@pytest.fixture(scope="module")
def truth() -> robots.Truth:
    rng = np.random.default_rng(0)
    return robots.simulate(robots.arid(), 40, rng, 1e-3, 1e-4, world=robots.random_placement(rng),
                           tip=robots.random_placement(rng, 0.2))  # fmt: skip


@pytest.fixture(scope="module")
def usual(truth: robots.Truth, tmp_path_factory: pytest.TempPathFactory) -> Fit:
    """What comes of sound files."""
    return pipeline.identify(robots.write_campaign(tmp_path_factory.mktemp("usual"), truth)).stage("final").fit


def attempt(
    folder: Path,
    truth: robots.Truth,
    capsys: pytest.CaptureFixture[str],
    spoil: Callable[[Path], object] = lambda _: None,
    rows: pd.DataFrame | None = None,
    traceback: bool = False,
    **changes: object,
) -> tuple[int, str]:
    """Run the command on a campaign beside an earlier result; returns its status and what it said."""
    path = robots.write_campaign(folder, truth, rows, **changes)
    results = folder / "results"
    results.mkdir()
    (results / "result.json").write_text(OLD)
    spoil(folder)
    status = identify.main([str(path)])
    said = "\n".join(line for line in capsys.readouterr().err.splitlines() if not re.match(r" +[\d.]+ s  ", line))
    if status:
        assert [f.name for f in results.iterdir()] == ["result.json"], "an earlier result must survive"
        assert (results / "result.json").read_text() == OLD
        assert ("Traceback" in said) is traceback
        assert not [f for f in folder.iterdir() if f.name.startswith(".")], "nothing half written may stay"
    return status, said


def edit(name: str, change: Callable[[bytes], bytes]) -> Callable[[Path], object]:
    return lambda folder: (folder / name).write_bytes(change((folder / name).read_bytes()))


def put(name: str, content: bytes) -> Callable[[Path], object]:
    return lambda folder: (folder / name).write_bytes(content)


def gone(name: str) -> Callable[[Path], object]:
    return lambda folder: (folder / name).unlink()


def cells(**columns: object) -> Callable[[pd.DataFrame], pd.DataFrame]:
    """Replace columns by a value, or by a function of what they were."""
    return lambda t: t.assign(**{n: f(t[n]) if callable(f) else f for n, f in columns.items()})


TABLES: dict[str, tuple[Callable[[pd.DataFrame], pd.DataFrame], str]] = {
    "a header only": (lambda t: t[:0], r"measurements\.csv: has a header but no rows"),
    "one row": (lambda t: t[:1], "only one row.*Measure other configurations"),
    "all rows the same": (lambda t: t.iloc[[0] * 30], "only one row.*Measure other configurations"),
    "joints that never move": (
        lambda t: t.assign(**t.loc[0, JOINTS].to_dict()), "no joint moves in any of its 40 rows",
    ),
    "NaN": (cells(x=np.nan), r"no usable row: 40 x empty\. First: measurements\.csv, line 2: column 'x'"),
    "text": (cells(joint_2="abc"), r"line 2: column 'joint_2', abc: not a number"),
    "infinite": (cells(y=np.inf), "column 'y', inf: not finite"),
    "1e300": (cells(y=1e300), r"column 'y', 1.*e\+300: implausibly large"),
    "millimetres": (
        cells(x=lambda v: 1e3 * v, y=lambda v: 1e3 * v, z=lambda v: 1e3 * v), "'x', 'y', 'z' cannot be in m.*length: mm",
    ),
    "degrees": (cells(joint_2=np.degrees, joint_3=np.degrees, joint_4=np.degrees), "cannot be in rad.*angle: deg"),
    "a rail in millimetres": (cells(joint_1=lambda v: 1e3 * v), "'joint_1' cannot be in m.*length: mm"),
    "a joint renamed": (lambda t: t.rename(columns={"joint_2": "Joint2"}), r"no column 'joint_2' \(did you mean 'Joint2'"),
    "rows out of step": (lambda t: t.assign(**t[JOINTS].shift(5).bfill()), "not of this robot.*order of rows"),
    "no qw": (lambda t: t.drop(columns="qw"), "no column 'qw'.*`kind: position`"),
    "quaternions of zeros": (cells(qx=0, qy=0, qz=0, qw=0), "the norm of the quaternion is not 1"),
    "a negative sigma": (cells(std_x=-1.0, std_y=1.0, std_z=1.0), "a sigma must be positive.*rows: ignore"),
    "two sigmas of three": (cells(std_x=1.0, std_y=1.0), "no column 'std_z'.*Give all three"),
    "no row to train on": (cells(split="test"), "every row is held out"),
    "a split misspelt": (cells(split="tset"), "tset: neither train nor test"),
    "decimal commas in quotes": (
        cells(x=lambda v: v.map(lambda n: str(n).replace(".", ","))), "'x' has decimal commas; write points",
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", TABLES)
def test_a_table_that_cannot_be_used(
    case: str, truth: robots.Truth, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    change, says = TABLES[case]
    status, said = attempt(tmp_path, truth, capsys, rows=change(robots.table(truth)))
    assert status == 2
    assert "measurements.csv" in said
    assert re.search(says, said), said


FILES: dict[str, tuple[Callable[[Path], object], str]] = {
    "no table": (gone("measurements.csv"), r"measurements\.csv: there is no such file"),
    "no table, but a file that tells where": (
        lambda folder: (gone("measurements.csv")(folder), put("README.md", b"Get it from ...")(folder)),
        r"measurements\.csv: there is no such file\. \S*README\.md may say where",
    ),
    "an empty table": (put("measurements.csv", b""), r"measurements\.csv: is empty"),
    "a table in UTF-16": (
        edit("measurements.csv", lambda c: c.decode().encode("utf-16")), r"measurements\.csv, line 1: is not UTF-8",
    ),
    "a header in Latin-1": (
        edit("measurements.csv", lambda c: c.replace(b"joint_1", b"gel\xe4nk")), "line 1: is not UTF-8.*save",
    ),
    "noise for a table": (put("measurements.csv", bytes(range(256)) * 20), r"measurements\.csv.*not UTF-8"),
    "semicolons and decimal commas": (
        edit("measurements.csv", lambda c: c.replace(b",", b";").replace(b".", b",")), "convert it to commas",
    ),
    "a column twice": (
        edit("measurements.csv", lambda c: c.replace(b"joint_2", b"joint_1", 1)), "'joint_1' is there twice; rename",
    ),
    "no header": (edit("measurements.csv", lambda c: c.split(b"\n", 1)[1]), "line 1 holds numbers"),
    "no URDF": (gone("robot.urdf"), r"robot\.urdf: there is no such file; check its name\. Check `robot\.urdf`"),
    "an empty URDF": (put("robot.urdf", b""), r"robot\.urdf: is empty; .* Check `robot\.urdf`"),
    "half a URDF": (edit("robot.urdf", lambda c: c[: len(c) // 2]), r"robot\.urdf: not well-formed XML: .*line \d+"),
    "noise for a URDF": (put("robot.urdf", bytes(range(256))), r"robot\.urdf: not well-formed"),
    "a web page for a URDF": (put("robot.urdf", b"<html><body/></html>"), r"<html>, not <robot>"),
    "a URDF with an external entity": (
        edit("robot.urdf", lambda c: c.replace(
            b"<robot ", b'<!DOCTYPE robot [<!ENTITY x SYSTEM "file:///etc/passwd">]><robot ', 1)),
        "DTDs and entities are refused. Remove it",
    ),
    "a URDF nested without end": (
        put("robot.urdf", b'<robot name="a">' + b"<a>" * 5000 + b"</a>" * 5000 + b"</robot>"), r"robot\.urdf: not well",
    ),
    "a URDF with NaN": (
        edit("robot.urdf", lambda c: re.sub(rb'(<joint name="joint_3".*?xyz=")[^"]*', rb"\1nan 0 0", c, flags=re.DOTALL)),
        r"robot\.urdf: line \d+: <origin xyz='nan 0 0'>: 3 finite numbers",
    ),
    "a mass in words": (
        edit("robot.urdf", lambda c: re.sub(rb'<mass value="[^"]*"', b'<mass value="heavy"', c)), "'heavy'.*1 finite number",
    ),
    "impossible limits": (
        edit("robot.urdf", lambda c: c.replace(b'lower="0"', b'lower="1000"', 1)), "'joint_1': its lower limit 1000",
    ),
    "no campaign": (gone("campaign.yaml"), r"campaign\.yaml: there is no such file"),
    "an empty campaign": (put("campaign.yaml", b""), r"campaign\.yaml: is empty"),
    "a list for a campaign": (put("campaign.yaml", b"- 1\n"), "no `key: value` pairs"),
    "broken YAML": (put("campaign.yaml", b"a: [1"), r"campaign\.yaml, line \d: is not valid YAML"),
    "tabs in YAML": (put("campaign.yaml", b"a:\n\tb: 1"), "spaces, not tabs"),
    "YAML in Latin-1": (put("campaign.yaml", "format: 1 # ä".encode("latin-1")), "line 1: is not UTF-8.*save"),
    "an unknown key": (
        edit("campaign.yaml", lambda c: c.replace(b"robot:", b"robo:", 1)), r"line \d+: robo: unknown key.*'robot'",
    ),
    "a key twice": (edit("campaign.yaml", lambda c: c + b"format: 1\n"), "format: this key is there twice"),
    "YAML that runs code": (put("campaign.yaml", b"format: !!python/object/apply:os.system [ls]\n"), r"campaign\.yaml"),
    "a YAML bomb": (put("campaign.yaml", b"a: &a [1, 2]\nb: [*a, *a]\n"), r"alias \*a is refused"),
    "another format": (edit("campaign.yaml", lambda c: c.replace(b"format: 1", b"format: 2")), "reads format 1 only"),
}  # fmt: skip


@pytest.mark.parametrize("case", FILES)
def test_a_file_that_cannot_be_used(
    case: str, truth: robots.Truth, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    spoil, says = FILES[case]
    status, said = attempt(tmp_path, truth, capsys, spoil)
    assert status == 2
    assert re.search(says, said), said


def measured(**more: object) -> dict[str, object]:
    return {"measurements": {"file": "measurements.csv", **more}}


FIXED = {"world_base": {"identify": False}, "tip_target": {"identify": False}}
SETTINGS: dict[str, tuple[dict[str, object], str]] = {
    "a tip that is no link": ({"robot": ROBOT | {"tip": "flnge"}}, "no link 'flnge'.*'flange'.*`robot.tip`"),
    "a base that is no link": ({"robot": ROBOT | {"base": "bas"}}, "no link 'bas'.*'base_link'.*`robot.base`"),
    "a base beyond the tip": ({"robot": ROBOT | {"base": "camera_head"}}, "no joint moves between 'camera_head' and"),
    "a folder for a URDF": ({"robot": ROBOT | {"urdf": "."}}, "is a folder, not a file; name a file in it. Check `robot.urdf`"),
    "metres called millimetres": (measured(units={"length": "mm"}), "are they in metres"),
    "an unknown unit": (measured(units={"angle": "degrees"}), "'degrees' is unknown.*'deg'"),
    "gravity in words": ({"robot": ROBOT | {"gravity": "down"}}, "robot.gravity: should be `world` or"),
    "noise of zero": (measured(noise={"position": 0}), "measurements.noise.position: should be greater"),
    "noise of 1e300": (measured(noise={"position": 1e300}), "measurements.noise.position: should be less"),
    "noise of 1e-300": (measured(noise={"rotation": 1e-300}), "measurements.noise.rotation: should be greater"),
    "absolute sigmas that are not there": (measured(noise={"rows": "absolute"}), r"needs the std_\* columns"),
    "stations that are not there": ({"frames": {"world_base": {"per": "station"}}}, "`per: station` needs it"),
    "nothing to identify": ({"frames": FIXED, "parameters": {"set": "none"}}, "nothing is to be identified"),
    "wrong frames given as known": ({"frames": FIXED, "parameters": {"set": "none"}, "diagnosis": {"enabled": True}},
                                    "not of this robot"),
    "an effect of an unknown kind": ({"effects": [{"kind": "joint_complience", "where": "joint_2"}]},
                                     "'joint_complience' is unknown.*'joint_compliance'"),
    "an effect at no joint": ({"effects": [{"kind": "joint_compliance", "where": "joint_9"}]}, "'joint_9'"),
    "an effect without its column": ({"effects": [{"kind": "thermal", "where": "joint_2", "motion": ["axis"]}]},
                                     "thermal at joint_2"),
    "a table that is none": (measured(file="robot.urdf"), r"should be a \.csv or \.parquet"),
    "parquet that is not there": (measured(file="m.parquet"), r"m\.parquet: there is no such file"),
}  # fmt: skip


@pytest.mark.parametrize("case", SETTINGS)
def test_settings_that_cannot_be_used(
    case: str, truth: robots.Truth, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    changes, says = SETTINGS[case]
    status, said = attempt(tmp_path, truth, capsys, **changes)
    assert status == 2
    assert re.search(says, said), said


ODD = {
    "measurements.csv": lambda c: b"\xef\xbb\xbf" + c.replace(b"\n", b"\r\n") + b"\r\n\r\n",
    "robot.urdf": lambda c: re.sub(rb"<inertial>.*?</inertial>", b"", c, flags=re.DOTALL),
    "campaign.yaml": lambda c: b"\xef\xbb\xbf" + c.replace(b"\n", b"\r\n"),
}
"""Marks of the order of bytes, lines that end as in Windows, blank lines at the end, no masses."""


def test_what_looks_odd_but_is_right_gives_the_usual_result(truth: robots.Truth, usual: Fit, tmp_path: Path) -> None:
    path = robots.write_campaign(tmp_path, truth)
    for name, change in ODD.items():
        edit(name, change)(tmp_path)
    found = pipeline.identify(path).stage("final").fit
    assert found.model.names == usual.model.names
    np.testing.assert_allclose(found.theta, usual.theta, atol=1e-12)


def test_some_bad_rows_are_refused_and_the_rest_is_used(
    truth: robots.Truth, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rows = robots.table(truth).astype(object)
    rows.loc[1, "x"], rows.loc[2, "joint_2"], rows.loc[3, "qw"], rows.loc[4, "z"] = np.nan, "abc", 7.0, 1e300
    rows.loc[6] = rows.loc[5]
    status, _ = attempt(tmp_path, truth, capsys, rows=rows)
    assert status == 0
    result = json.loads((tmp_path / "results" / "result.json").read_text())
    assert [(row["row"], row["column"]) for row in result["n"]["refused"][:4]] == [
        (3, "x"), (4, "joint_2"), (5, "qx qy qz qw"), (6, "z"),
    ]  # fmt: skip
    assert [row["row"] for row in result["n"]["refused"][4:]] == [8]
    assert (result["n"]["rows"], result["n"]["used"]) == (40, 35)


def test_a_joint_that_never_moves_is_named(truth: robots.Truth, tmp_path: Path) -> None:
    """The others can still be calibrated."""
    q = truth.readings.copy()
    q[:, 0] = 3.0
    R, p = truth.model.poses(truth.theta, truth.model.rows(q))
    still = replace(truth, measured=robots.measured(truth.model.robot, q, p, R))
    outcome = pipeline.identify(robots.write_campaign(tmp_path, still))
    assert [name for name in truth.model.robot.readings if any(f"{name} never" in n for n in outcome.notices)] == [
        "joint_1"
    ]
    assert np.sqrt(np.mean(outcome.stage("final").residual[:, :3] ** 2)) < 1e-6


@pytest.mark.parametrize("place", ["measurements.csv", "measurements.csv/deeper", "robot.urdf/results"])
def test_a_place_that_cannot_be_written_is_refused_before_any_work(
    place: str, truth: robots.Truth, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = robots.write_campaign(tmp_path, truth)
    before = (tmp_path / "measurements.csv").read_bytes()
    assert identify.main([str(path), "--out", str(tmp_path / place)]) == 2
    said = capsys.readouterr().err
    assert "cannot be written" in said or "is a file, not a folder" in said
    assert "fitting" not in said
    assert (tmp_path / "measurements.csv").read_bytes() == before


def when_opened(monkeypatch: pytest.MonkeyPatch, name: str, strike: Callable[[], object]) -> None:
    """Do something at the moment when a file of that name is opened for the first time; templates of ours do not count."""
    real, struck = io.open, []

    def opened(file: object, *arguments: Any, **more: Any) -> Any:
        ours = isinstance(file, (str, os.PathLike)) and Path(file).name == name and "assets" not in Path(file).parts
        if ours and not struck:
            struck.append(name)
            strike()
        return real(file, *arguments, **more)  # type: ignore[call-overload]

    for module in (io, builtins):
        monkeypatch.setattr(module, "open", opened)


@pytest.mark.parametrize(
    ("file", "stop"),
    [
        ("measurements.csv", signal.SIGINT),
        ("measurements.csv", signal.SIGTERM),
        ("residuals.csv", signal.SIGTERM),
        ("scene.html", signal.SIGINT),
    ],
)
def test_an_interruption_leaves_the_earlier_result(
    file: str,
    stop: signal.Signals,
    truth: robots.Truth,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Ctrl-C, or a polite kill, before the fit, while files are written, and after most of them are."""
    status, said = attempt(
        tmp_path, truth, capsys, lambda _: when_opened(monkeypatch, file, lambda: os.kill(os.getpid(), stop))
    )
    assert status == 128 + stop
    assert "interrupted" in said


def test_a_bug_is_called_a_bug(
    truth: robots.Truth, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def oops() -> None:
        raise ZeroDivisionError("oops")

    status, said = attempt(
        tmp_path, truth, capsys, lambda _: when_opened(monkeypatch, "measurements.csv", oops), traceback=True
    )
    assert status == 1
    assert "ZeroDivisionError" in said
    assert "bug" in said
