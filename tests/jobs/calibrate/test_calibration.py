"""calibration.yaml: what was written is what is read, whatever the URDF's bytes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import robots

from aridcal.engine.corrections.basis import Basis
from aridcal.engine.corrections.effect import Coefficient
from aridcal.engine.corrections.loads import Payload, Surroundings
from aridcal.engine.model.model import Model
from aridcal.engine.robot.chain import parse_robot
from aridcal.jobs.calibrate.saved_model import SavedModel, SolvedModel
from aridcal.system.errors import AridcalError


def example(urdf: bytes | None = None) -> SavedModel:
    """Everything a calibration may hold: stations, effects, a full covariance, numbers with all their digits."""
    rng = np.random.default_rng(3)
    robot = parse_robot(urdf or robots.arid().urdf, "flange", path=Path("arid.urdf"))
    world = tuple((label, robots.random_placement(rng)) for label in ("tracker 1", "2"))
    tip = ((None, robots.random_placement(rng, 0.1)),)
    effects = (
        Coefficient("joint_3", "axis", Basis("sin", ("joint_3",), (1 / 3,))),
        Coefficient("joint_1", "pitch", Basis("times_power", ("temperature", "joint_1"), (21.3, 18.2, 1.0))),
        Coefficient("world_base", "x", Basis("linear", ("time",), (0.1,)), station="2"),
    )
    constants = (Coefficient("joint_2", "beta"), Coefficient("joint_3", "yaw"), Coefficient("world_base", "x"))
    gravity = rng.normal(size=(2, 3))
    geometric = Model(robot, constants, world, tip, Surroundings(gravity, (Payload(tip[0][1].translation),)))
    A = rng.normal(size=(6, 6))
    return SavedModel(
        SolvedModel(geometric, rng.normal(size=3), np.eye(3) / 3),
        SolvedModel(geometric.with_coefficients(constants + effects), rng.normal(size=6), A @ A.T),
        "pose",
        "world",
        (1 / 3 * 1e-4, 1e-300),
        {"joint_1": (0.1, 17.9), "temperature": (-5.0, 1 / 3)},
        {"campaign": "format: 1\n# täglich\n", "data": {"sha256": "00"}},
    )


def test_what_is_written_is_what_is_read(tmp_path: Path) -> None:
    before = example()
    path = tmp_path / "calibration.yaml"
    path.write_text(before.dump(), encoding="utf-8")
    after = SavedModel.load(path)
    for a, b in ((before.geometric, after.geometric), (before.final, after.final)):
        assert np.array_equal(a.theta, b.theta)
        assert np.array_equal(a.covariance, b.covariance)
        assert a.model.coefficients == b.model.coefficients
        assert np.array_equal(a.model.around.gravity, b.model.around.gravity)
        assert np.array_equal(a.model.around.payloads[0].lever, b.model.around.payloads[0].lever)
        for frames in ("world_base", "tip_target"):
            for (name, T), (other, U) in zip(getattr(a.model, frames), getattr(b.model, frames), strict=True):
                assert name == other
                assert np.array_equal(T.translation, U.translation)
                np.testing.assert_allclose(T.rotation, U.rotation, atol=1e-15, rtol=0)
    assert (after.kind, after.gravity, after.noise, after.ranges) == ("pose", "world", before.noise, before.ranges)
    assert after.record == before.record


def test_a_calibration_predicts_the_same_after_a_round_trip(tmp_path: Path) -> None:
    before = example()
    (tmp_path / "c.yaml").write_text(before.dump(), encoding="utf-8")
    after = SavedModel.load(tmp_path / "c.yaml")
    rng = np.random.default_rng(0)
    q = robots.readings(robots.arid(), 20, rng)
    covariates = {"temperature": rng.uniform(10, 30, 20), "time": rng.uniform(0, 1e4, 20)}
    station = np.where(rng.random(20) < 0.5, "2", "tracker 1")
    for a, b in zip(before.final.poses(q, covariates, station), after.final.poses(q, covariates, station), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-14, atol=1e-12)


@pytest.mark.parametrize(
    "change",
    [
        lambda urdf: urdf.replace(b"\n", b"\r\n"),
        lambda urdf: urdf.replace(b"<robot", "<!-- Länge µm ☃ \u2028 -->\n<robot".encode(), 1),
        lambda urdf: urdf.replace(b'encoding="utf-8"', b'encoding="iso-8859-1"', 1).replace(
            b"<robot", "<!-- Länge -->\n<robot".encode("latin-1"), 1
        ),
        lambda urdf: urdf.replace(b"\n", b" \t \n"),
        lambda urdf: urdf.replace(b"\n", b"\r"),
        lambda urdf: urdf + b"\n\n  \n",
    ],
    ids=["crlf", "utf-8", "latin-1", "trailing blanks", "old mac", "blank end"],
)
def test_the_urdfs_own_bytes_come_back(tmp_path: Path, change) -> None:  # type: ignore[no-untyped-def]
    source = robots.arid().urdf
    if b"encoding=" not in source:
        source = source.replace(b'<?xml version="1.0"?>', b'<?xml version="1.0" encoding="utf-8"?>', 1)
    urdf = change(source)
    assert urdf != robots.arid().urdf
    (tmp_path / "c.yaml").write_text(example(urdf).dump(), encoding="utf-8")
    assert SavedModel.load(tmp_path / "c.yaml").final.model.robot.urdf == urdf


@pytest.mark.parametrize(
    "text",
    ["", "- 1\n", "format: 2\n", "format: 1\n", "a: [1\n", "a: !!python/object/apply:os.system [true]\n", "\x00"],
    ids=["empty", "list", "format", "keys", "syntax", "tag", "binary"],
)
def test_another_file_is_refused_by_name(tmp_path: Path, text: str) -> None:
    path = tmp_path / "calibration.yaml"
    path.write_text(text)
    with pytest.raises(AridcalError, match=r"calibration\.yaml"):
        SavedModel.load(path)


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(AridcalError, match=r"nowhere\.yaml"):
        SavedModel.load(tmp_path / "nowhere.yaml")


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda text: text.replace("kind: pose", "kind: [&a x, *a]"), "alias"),
        (lambda text: text.replace("kind: pose", "kind: !!python/name:os.system x"), "tag"),
        (lambda text: text.replace("kind: pose", "kind: " + "[" * 200 + "]" * 200), "nested"),
        (lambda text: text.replace("kind: pose", "kind: poem"), "poem"),
        (lambda text: text.replace("value: ", "value: .nan #", 1), "value: should be a finite number"),
        (lambda text: text.encode("utf-16"), "UTF-8"),
        (lambda text: text[: len(text) // 2], "calibration.yaml"),
    ],
)
def test_a_file_that_is_no_calibration_is_refused_with_the_reason(tmp_path: Path, change, says: str) -> None:
    text = change(example().dump())
    path = tmp_path / "calibration.yaml"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    with pytest.raises(AridcalError, match=says):
        SavedModel.load(path)


def test_a_result_folder_is_as_good_as_its_file(tmp_path: Path) -> None:
    (tmp_path / "calibration.yaml").write_text(example().dump(), encoding="utf-8")
    assert np.array_equal(SavedModel.load(tmp_path).final.theta, example().final.theta)
    with pytest.raises(AridcalError, match="no such file"):
        SavedModel.load(tmp_path / "nowhere")
