"""Campaign files: every key arrives, and what is wrong is named with its file, line and key."""

from __future__ import annotations

from pathlib import Path

import pytest

from aridcal.engine.corrections.catalogue import EFFECT_KINDS
from aridcal.files.campaign import Campaign, JobSettings, load_campaign
from aridcal.files.measurement_settings import LENGTHS
from aridcal.files.yaml_file import Section, load_settings, parse_settings
from aridcal.system.errors import CampaignError

SMALLEST = "format: 1\nrobot: {urdf: robot.urdf, tip: flange}\nmeasurements: {file: m.csv}\n"

FULL = """\
format: 1
robot:
  urdf: sub/robot.urdf
  base: base_link
  tip: flange
  gravity: [0.0, 9.81, 0]
measurements:
  file: [a.csv, /data/b.parquet]
  kind: position
  noise: {position: 1e-4, rotation: 2.5E+1, rows: absolute}
  columns: {x: X_mm, joint_1: A1}
  units: {length: mm, angle: deg}
  orientation: {euler: ZYX, columns: [c, b, a]}
  ignore: [row, note]
frames:
  world_base: {xyz: [1, 2, 3], rpy: [0, 0, 1.5], identify: false}
  tip_target: {per: station}
parameters: {set: doty}
effects:
  - {kind: joint_harmonic, where: joint_3, order: [1, 2.5]}
  - {kind: joint_coupling, where: joint_3, with: joint_2}
  - {kind: joint_backlash, where: joint_3, by: load}
  - {kind: unknown, where: joint_1, motion: [t1, r1], covariates: temperature_arm}
diagnosis: {enabled: false, candidates: [thermal, drift]}
"""


def parse(text: str) -> Campaign:
    return parse_settings(text, Path("job/campaign.yaml"), Campaign)


def complaint(text: str) -> str:
    with pytest.raises(CampaignError) as caught:
        parse(text)
    message = str(caught.value)
    assert message.startswith("job/campaign.yaml")
    return message


def with_line(line: str) -> str:
    return complaint(SMALLEST + line)


def measured(keys: str) -> str:
    return f"format: 1\nrobot: {{urdf: a.urdf, tip: b}}\nmeasurements: {keys}\n"


def test_every_key_of_the_format_arrives_on_the_object() -> None:
    job = parse(FULL)
    assert (job.robot.base, job.robot.tip, job.robot.gravity) == ("base_link", "flange", (0.0, 9.81, 0.0))
    m = job.measurements
    assert (m.kind, m.noise.position, m.noise.rotation, m.noise.rows) == ("position", 1e-4, 25.0, "absolute")
    assert (m.columns, m.ignore) == ({"x": "X_mm", "joint_1": "A1"}, ("row", "note"))
    assert (m.orientation.euler, m.orientation.columns, m.orientation.rotvec) == ("ZYX", ("c", "b", "a"), None)
    assert (m.units.metres, m.units.radians * 180) == (1e-3, pytest.approx(3.14159265358979))
    assert job.frames.world_base.xyz == (1, 2, 3) and not job.frames.world_base.identify
    assert job.frames.tip_target.per == "station" and job.frames.tip_target.identify
    assert job.parameters.set == "doty"
    harmonic, coupling, backlash, unknown = job.effects
    assert (harmonic.kind, harmonic.where, harmonic.order) == ("joint_harmonic", "joint_3", (1, 2.5))
    assert (coupling.with_, backlash.by) == ("joint_2", "load")
    assert (unknown.motion, unknown.covariates) == (("t1", "r1"), ("temperature_arm",))
    assert not job.diagnosis.enabled and job.diagnosis.candidates == ("thermal", "drift")


def test_what_is_left_out_has_the_stated_defaults() -> None:
    job = parse(SMALLEST)
    assert job.robot.base is None and job.robot.gravity == (0.0, 0.0, -9.81)
    m = job.measurements
    assert (m.kind, m.noise.position, m.noise.rotation, m.noise.rows) == ("pose", None, None, "relative")
    assert (m.units.metres, m.units.radians, m.orientation.euler, m.ignore) == (1.0, 1.0, None, ())
    for frame in (job.frames.world_base, job.frames.tip_target):
        assert (frame.xyz, frame.rpy, frame.identify, frame.per) == ((0, 0, 0), (0, 0, 0), True, None)
    assert (job.parameters.set, job.effects, job.diagnosis.enabled) == ("full", (), True)
    assert job.diagnosis.candidates == parse(SMALLEST + "diagnosis: {candidates: all}").diagnosis.candidates
    assert set(job.diagnosis.candidates) == {name for name, kind in EFFECT_KINDS.items() if not kind.on_request}


def test_paths_are_relative_to_the_file_and_its_text_is_kept(tmp_path: Path) -> None:
    path = tmp_path / "campaign.yaml"
    path.write_text(FULL, "utf-8")
    job = load_campaign(path)
    assert job.robot.urdf == tmp_path / "sub" / "robot.urdf"
    assert job.measurements.files == (tmp_path / "a.csv", Path("/data/b.parquet"))
    assert (job.text, job.path) == (FULL, path)


def test_a_byte_order_mark_does_no_harm(tmp_path: Path) -> None:
    path = tmp_path / "campaign.yaml"
    path.write_text(SMALLEST.replace("\n", "\r\n"), "utf-8-sig", newline="")
    assert load_campaign(path).robot.tip == "flange"


def test_a_loaded_campaign_cannot_be_changed() -> None:
    with pytest.raises(ValueError, match="frozen"):
        parse(SMALLEST).robot.tip = "other"


@pytest.mark.parametrize("unit", LENGTHS)
def test_units_of_length_agree_with_the_definition_of_the_inch(unit: str) -> None:
    inches = {"m": 1 / 0.0254, "cm": 1 / 2.54, "mm": 1 / 25.4, "um": 1 / 25400, "in": 1.0, "ft": 12.0}
    assert parse(measured(f"{{file: a, units: {{length: {unit}}}}}")).measurements.units.metres == pytest.approx(
        0.0254 * inches[unit], rel=1e-15
    )


@pytest.mark.parametrize(
    ("line", "where", "culprit", "hint"),
    [
        ("measurments: {}", "line 4", "measurments", "'measurements'"),
        ("frames:\n  tip_target: {rpv: [0, 0, 0]}", "line 5", "frames.tip_target.rpv", "'rpy'"),
        ("effects:\n- {kind: drift, were: world_base}", "line 5", "effects[0].were", "'where'"),
        ("effects: [{kind: joint_hamonic, where: j}]", "line 4", "effects[0].kind", "'joint_harmonic'"),
        ("diagnosis: {candidates: [drift, termal]}", "line 4", "diagnosis.candidates[1]", "'thermal'"),
        ("parameters: {set: dotty}", "line 4", "parameters.set", "'doty'"),
    ],
)
def test_a_misspelt_word_names_file_line_and_the_nearest_known(line: str, where: str, culprit: str, hint: str) -> None:
    message = with_line(line)
    assert where in message and f"{culprit}: " in message and f"did you mean {hint}?" in message


@pytest.mark.parametrize(
    ("line", "culprit"),
    [
        ("parameters: full", "parameters"),
        ("frames:", "frames"),
        ("frames: {tip_target: {xyz: [0, 1]}}", "frames.tip_target.xyz[2]"),
        ("frames: {tip_target: {xyz: [0, 1, 2, 3]}}", "frames.tip_target.xyz"),
        ("frames: {tip_target: {xyz: [0, 1, '2']}}", "frames.tip_target.xyz[2]"),
        ("frames: {tip_target: {xyz: [0, 1, .nan]}}", "frames.tip_target.xyz[2]"),
        ("frames: {tip_target: {rpy: [.inf, 1, 0]}}", "frames.tip_target.rpy[0]"),
        ("frames: {tip_target: {rpy: [true, 1, 0]}}", "frames.tip_target.rpy[0]"),
        ("frames: {tip_target: {identify: 1}}", "frames.tip_target.identify"),
        ("frames: {tip_target: {identify: 'yes'}}", "frames.tip_target.identify"),
        ("frames: {tip_target: {identify: false, per: station}}", "frames.tip_target"),
        ("effects: {kind: drift}", "effects"),
        ("effects: [{kind: drift}]", "effects[0].where"),
        ("effects: [{kind: joint_coupling, where: j}]", "effects[0]"),
        ("effects: [{kind: joint_gain, where: j, by: load}]", "effects[0]"),
        ("effects: [{kind: joint_harmonic, where: j, order: 0}]", "effects[0].order[0]"),
        ("effects: [{kind: sonar_bias, where: sonar_1}]", "effects[0].kind"),
    ],
)
def test_wrong_values_are_refused_by_key(line: str, culprit: str) -> None:
    assert f"{culprit}: " in with_line(line)


@pytest.mark.parametrize(
    ("keys", "culprit"),
    [
        ("{}", "measurements.file"),
        ("{file: []}", "measurements.file"),
        ("{file: ''}", "measurements.file[0]"),
        ("{file: 3}", "measurements.file[0]"),
        ("{file: a, kind: poses}", "measurements.kind"),
        ("{file: a, noise: {position: 0}}", "measurements.noise.position"),
        ("{file: a, noise: {position: 1e400}}", "measurements.noise.position"),
        ("{file: a, noise: {position: '1e-4'}}", "measurements.noise.position"),
        ("{file: a, units: {length: furlong}}", "measurements.units.length"),
        ("{file: a, columns: {x: 1}}", "measurements.columns.x"),
        ("{file: a, orientation: matrix}", "measurements.orientation"),
        ("{file: a, orientation: {euler: XYZ}}", "measurements.orientation"),
        ("{file: a, orientation: {euler: XyZ, columns: [a, b, c]}}", "measurements.orientation.euler"),
        ("{file: a, orientation: {euler: XXZ, columns: [a, b, c]}}", "measurements.orientation.euler"),
        ("{file: a, orientation: {rotvec: [a, b]}}", "measurements.orientation.rotvec"),
        ("{file: a, head: head.yaml}", "measurements.head"),
        ("{kind: camera_sonar}", "measurements"),
        ("{kind: camera_sonar, head: head.yaml, file: a.csv}", "measurements"),
    ],
)
def test_wrong_measurement_settings_are_refused_by_key(keys: str, culprit: str) -> None:
    assert f"{culprit}" in complaint(measured(keys))


@pytest.mark.parametrize("gravity", ["down", "9.81", "[0, 0]", "[0, 0, .nan]", "[0, 0, -9.81, 0]", "[0, 0, g]"])
def test_gravity_is_a_vector_or_world(gravity: str) -> None:
    text = f"format: 1\nrobot: {{urdf: a, tip: b, gravity: {gravity}}}\nmeasurements: {{file: c}}"
    assert "line 2: robot.gravity: " in complaint(text)
    assert parse(text.replace(gravity, "world")).robot.gravity == "world"


def test_camera_sonar_has_a_head_and_no_target_frame() -> None:
    text = measured("{kind: camera_sonar, head: head.yaml}")
    assert parse(text).measurements.head == Path("job/head.yaml")
    assert parse(text + "effects: [{kind: sonar_bias, where: sonar_1}]").effects[0].where == "sonar_1"
    assert "frames.tip_target" in complaint(text + "frames: {tip_target: {xyz: [0, 0, 1]}}")


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("robot: {urdf: a, tip: b}", "'format' is missing"),
        ("format: 2\nrobot: {}", "line 1: format"),
        ("format: '1'\nrobot: {}", "line 1: format"),
        ("format: true\nrobot: {}", "line 1: format"),
        ("format: 1", "robot: this key is missing"),
        ("- 1\n- 2", "key: value"),
        ("# nothing", "key: value"),
        (SMALLEST + "format: 1", "line 4: format: this key is there twice"),
        (SMALLEST + "frames:\n  tip_target: {rpy: [0, 0, 0], rpy: [0, 0, 0]}", "line 5: frames.tip_target.rpy"),
        (SMALLEST + "frames:\n\ttip_target: {}", "tabs"),
        (SMALLEST + "frames: [", "line 5"),
        (SMALLEST + "a: &x [1]\nb: *x", "line 5: the alias *x"),
        (SMALLEST + "a: &x [*x]", "line 4: the alias *x"),
        (SMALLEST + "a: " + "[" * 10000 + "]" * 10000, "line 4: is nested"),
        (SMALLEST + "a: !!python/object/apply:os.system [ls]", "line 4: the tag"),
        (SMALLEST + "a: !!timestamp x", "line 4: the tag"),
        (SMALLEST + "a: 2024-02-31", "is not valid YAML"),
        (SMALLEST + "<<: {}", "line 4: <<"),
        (SMALLEST + "---\n" + SMALLEST, "line 4"),
        (SMALLEST + "off: 1", "line 4: off: YAML reads this key as a bool"),
        (SMALLEST + "on: 1", "line 4: on: unknown key"),
        (SMALLEST + "? [a, b]\n: 1", "line 4: a key must be a plain word"),
        (SMALLEST + "a: \x07", "line 4: holds a character"),
    ],
)
def test_broken_or_hostile_yaml_is_one_clear_complaint(text: str, said: str) -> None:
    message = complaint(text)
    assert said in message and "\n" not in message


def test_several_mistakes_are_named_at_once_but_not_by_the_hundred() -> None:
    message = with_line("parameters: {set: dotty}\ndiagnosis: {enabled: 7}")
    assert "parameters.set" in message and "diagnosis.enabled" in message
    many = with_line("effects: [" + "{kind: drift}, " * 100 + "]")
    assert len(many.splitlines()) < 12 and "more" in many.splitlines()[-1]


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (None, "no such file"),
        (b"", "is empty"),
        (b"  \n \n", "is empty"),
        (SMALLEST.encode() + b"# \xe9t\xe9", "line 4: is not UTF-8"),
        (SMALLEST.encode("utf-16"), "is not UTF-8"),
    ],
)
def test_unreadable_files_are_named(tmp_path: Path, content: bytes | None, said: str) -> None:
    path = tmp_path / "campaign.yaml"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(CampaignError, match=said) as caught:
        load_campaign(path)
    assert str(path) in str(caught.value)


def test_a_folder_is_no_campaign(tmp_path: Path) -> None:
    with pytest.raises(CampaignError, match="is a folder"):
        load_campaign(tmp_path)


def test_another_settings_file_is_read_by_the_same_rules(tmp_path: Path) -> None:
    class Truth(Section):
        seed: int = 0
        parameters: dict[str, float]

    class Scenario(JobSettings):
        truth: Truth

    path = tmp_path / "scenario.yaml"
    text = "format: 1\nrobot: {urdf: a.urdf, tip: b}\ntruth: {seed: 3, parameters: {joint_1.x: 1e-3}}\n"
    path.write_text(text)
    scenario = load_settings(path, Scenario)
    assert scenario.measurements.files == () and scenario.robot.urdf == tmp_path / "a.urdf"
    assert scenario.truth == Truth(seed=3, parameters={"joint_1.x": 1e-3})
    path.write_text(text.replace("seed: 3", "seed: 3.5"))
    with pytest.raises(CampaignError, match=r"line 3: truth\.seed"):
        load_settings(path, Scenario)
