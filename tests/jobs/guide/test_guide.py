"""Being led while measuring: rows judged, slips told, the next pose, the end; what happens to the table in between."""

from __future__ import annotations

import json
import subprocess
import sys
import time
import urllib.error
import urllib.request
from collections.abc import Callable
from copy import deepcopy
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import yaml

import aridcal
from aridcal.engine.model.model import Model
from aridcal.files.campaign import load_campaign, nominal_robot
from aridcal.files.yaml_file import load_settings
from aridcal.guide import main
from aridcal.jobs.guide.events import Alarm, Event, Known, Next, RowRead, Stop
from aridcal.jobs.guide.growing_table import GrowingTable
from aridcal.jobs.guide.judgement import beside_others, exceeded
from aridcal.jobs.guide.next_pose import AHEAD, AS_GOOD, WAYS, ahead, best_first, reaches, worth
from aridcal.jobs.guide.session import Session, session
from aridcal.jobs.plan.configurations import offers
from aridcal.jobs.plan.row_exchange import greedy
from aridcal.jobs.simulate.live import LiveArm, live_arm
from aridcal.jobs.simulate.scenario import Scenario
from aridcal.jobs.simulate.simulation import simulate
from aridcal.runs.guide_server import Board, GuideServer
from aridcal.runs.guided_campaign import Incoming, to_calibrate

SCARA = """<robot name="scara"><link name="base"/><link name="a"/><link name="b"/><link name="c"/><link name="tool"/>
<joint name="one" type="revolute"><parent link="base"/><child link="a"/><origin xyz="0 0 0.4"/><axis xyz="0 0 1"/>
<limit lower="-2.2" upper="2.2" effort="1" velocity="1"/></joint>
<joint name="two" type="revolute"><parent link="a"/><child link="b"/><origin xyz="0.325 0 0"/><axis xyz="0 0 1"/>
<limit lower="-2.4" upper="2.4" effort="1" velocity="1"/></joint>
<joint name="lift" type="prismatic"><parent link="b"/><child link="c"/><origin xyz="0.275 0 0"/><axis xyz="0 0 1"/>
<limit lower="-0.2" upper="0.0" effort="1" velocity="1"/></joint>
<joint name="end" type="fixed"><parent link="c"/><child link="tool"/><origin xyz="0 0 -0.05"/></joint></robot>"""

CAMPAIGN = """format: 1
robot: {urdf: scara.urdf, tip: tool}
measurements: {file: measurements.csv, kind: pose, noise: {position: 5.0e-5, rotation: 1.0e-4}}
"""
STEP = 0.03  # [m] that the arm moves between two looks at its way
KEEP_OUT = "design: {keep_out: [{min: [0.4, 0.2, 0.0], max: [0.7, 0.5, 1.0]}]}\n"
TRUTH = """truth:
  n: 50
  seed: 3
  noise: {position: 5.0e-5, rotation: 1.0e-4}
  frames: {world_base: {xyz: [1.0, 2.0, 0.3], rpy: [0.1, 0.2, 1.0]}, tip_target: {xyz: [0.05, 0.02, -0.03], rpy: [0.3, 0.1, 0.2]}}
  parameters: {two.x: {std: 1.0e-3}, two.roll: {std: 1.0e-3}, lift.pitch: {std: 1.0e-3}}
"""


@pytest.fixture
def cell(tmp_path: Path) -> LiveArm:
    """A SCARA with a tracker, and its campaign without a table."""
    (tmp_path / "scara.urdf").write_text(SCARA)
    (tmp_path / "campaign.yaml").write_text(CAMPAIGN + KEEP_OUT)
    (tmp_path / "scenario.yaml").write_text(CAMPAIGN + TRUTH)
    return live_arm(load_settings(tmp_path / "scenario.yaml", Scenario))


def begun(folder: Path, tolerance: float | None = None) -> Session:
    campaign = load_campaign(folder / "campaign.yaml")
    return session(campaign, nominal_robot(campaign), tolerance)


def measured(arm: LiveArm, pose: Next) -> list[bytes]:
    """Header and row of a pose."""
    return arm.measured(np.array([*pose.joints.values()])).to_csv(index=False).encode().splitlines()


def led(now: Session, arm: LiveArm, n: int, spoil: Callable[[int, list[bytes]], bytes] | None = None) -> list[Event]:
    """What is said while n poses are measured as proposed."""
    said = now.taken([])
    for row in range(1, n + 1):
        following = said[-1]
        if not isinstance(following, Next):
            break
        lines = measured(arm, following)
        line = lines[1] if spoil is None else spoil(row, lines)
        if not now.table.head:
            now.table.add(lines[0])
        said += now.taken(now.table.add(line))
    return said


def alarms(said: list[Event]) -> list[Alarm]:
    return [event for event in said if isinstance(event, Alarm)]


def test_a_campaign_is_led_to_its_tolerance_and_the_truth_is_within(tmp_path: Path, cell: LiveArm) -> None:
    """At the stop the model's error at poses never measured, against the machine's own truth, is within in 95 % of them."""
    now = begun(tmp_path, 2e-4)
    said = led(now, cell, 60)
    stop = said[-1]
    assert isinstance(stop, Stop)
    assert (stop.why, alarms(said)) == ("tolerance", [])
    rows = [event.row for event in said if isinstance(event, RowRead)]
    assert rows == list(range(2, 2 + len(rows)))  # lines of the table, the header is line 1
    assert len(stop.check) == 5
    assert now.posterior is not None
    places = now.region
    setup = now.posterior.setup
    pattern = setup.patterns.select(np.zeros(len(places), dtype=int))
    p = setup.model.poses(setup.theta, setup.model.rows(places, pattern.conditions | {}))[1]
    true = cell.model.poses(cell.simulation.theta, cell.model.rows(places))[1]
    assert np.quantile(np.linalg.norm(p - true, axis=1), 0.95) < 2e-4


def test_poses_keep_out_of_boxes_and_so_do_the_ways_to_them(tmp_path: Path, cell: LiveArm) -> None:
    """Points of the second arm and of the plunger, along every straight way: none is in the box, but for the step of a look."""
    now = begun(tmp_path)
    proposed = [event for event in led(now, cell, 12) if isinstance(event, Next)]
    poses = np.array([[*event.joints.values()] for event in proposed])
    limits = now.robot.limits
    assert np.all((poses > limits[:, 0]) & (poses < limits[:, 1]))
    straight = np.array(["no straight way" not in event.why for event in proposed])
    assert straight.sum() > 10
    for here, there in np.array([*pairwise(poses)])[straight[1:]]:
        one, two, lift = (here + np.linspace(0.0, 1.0, 300)[:, None] * (there - here)).T
        elbow = 0.325 * np.array([np.cos(one), np.sin(one)])
        end = elbow + 0.275 * np.array([np.cos(one + two), np.sin(one + two)])
        for share in np.linspace(0.0, 1.0, 20):
            x, y = elbow + share * (end - elbow)
            assert not np.any(
                (x > 0.4 + STEP) & (x < 0.7) & (y > 0.2 + STEP) & (y < 0.5)
            )  # the box is higher than the arm
        assert np.all(lift < 0.0)


@pytest.mark.parametrize("frame", ["tip_target", "world_base"])
def test_a_slip_is_told_within_two_rows_and_both_parts_are_used(tmp_path: Path, cell: LiveArm, frame: str) -> None:
    now = begun(tmp_path)
    first = 14

    def slip(row: int, lines: list[bytes]) -> bytes:
        if row == first - 1:  # after this row was measured
            ((label, at),) = getattr(cell.model, frame)
            moved = at.copy()
            moved.translation = at.translation + np.array([1.5e-3, -1e-3, 1e-3])
            cell.model = replace(cell.model, **{frame: ((label, moved),)})
        return lines[1]

    said = led(now, cell, first + 2, slip)
    (slipped,) = [alarm for alarm in alarms(said) if alarm.what == "slip"]
    assert slipped.row == first + 1  # the line of row `first`
    assert now.slips[0][1] == (frame,)
    assert all(now.good.values())
    assert [alarm.row for alarm in alarms(said) if alarm.what != "slip"] in (
        [],
        [first + 1],
    )  # the first row alone may be bad


def test_bad_rows_are_told_apart_by_what_is_wrong_with_them(tmp_path: Path, cell: LiveArm) -> None:
    """A jump of 3 mm, a reading of the row before, millimetres, a word: each by its name, and none is used."""
    now = begun(tmp_path)
    before: list[bytes] = []

    def spoil(row: int, lines: list[bytes]) -> bytes:
        cells, last = lines[1].split(b","), before[-1].split(b",") if before else []
        before.append(lines[1])
        if row == 10:
            cells[3] = b"%.9f" % (float(cells[3]) + 3e-3)
        elif row == 12:
            cells[3:] = last[3:]
        elif row == 14:
            cells[3:6] = [b"%.6f" % (1e3 * float(c)) for c in cells[3:6]]
        elif row == 16:
            cells[4] = b"nothing"
        return b",".join(cells)

    said = led(now, cell, 18, spoil)
    assert [(alarm.row, alarm.what) for alarm in alarms(said)] == [
        (11, "outlier"),
        (13, "stale"),
        (15, "unit"),
        (17, "table"),
    ]
    assert [event.row for event in said if isinstance(event, RowRead) and not event.ok] == [11, 13, 15, 17]
    assert "again" in alarms(said)[0].do


@pytest.mark.usefixtures("cell")
def test_a_rejected_pose_is_replaced_by_one_elsewhere(tmp_path: Path) -> None:
    now = begun(tmp_path)
    first = now.taken([])[-1]
    others = [now.reject()[-1] for _ in range(3)]
    poses = np.array([[*event.joints.values()] for event in (first, *others) if isinstance(event, Next)])
    apart = np.abs(poses[:, None] - poses[None]).max(axis=2)[np.triu_indices(4, 1)]
    assert len(poses) == 4
    assert apart.min() > 0.2


def test_a_row_that_is_left_out_is_as_far_off_as_a_fit_without_it_says(tmp_path: Path, cell: LiveArm) -> None:
    """The closed form of all rows at once, against the posterior with one row really taken away."""
    now = begun(tmp_path)
    led(now, cell, 10)
    assert now.posterior is not None
    assert now.read.rows is not None
    F, r = now.posterior.columns(now.read.rows, np.arange(len(now.read.rows)))
    r[[0, 5]] += 5.0  # sigmas: clearly off
    together = beside_others(now.posterior, F, r, now.inflation)
    for k in (0, 5):
        without = now.posterior.with_rows(F[k : k + 1], r[k : k + 1], -1.0)
        error = r[k] - F[k] @ without.step
        square = error @ np.linalg.solve(np.eye(6) + F[k] @ without.covariance @ F[k].T, error) / now.inflation.variance
        assert together[k] == pytest.approx(float(exceeded(square, 6, 30.0 + now.inflation.numbers)), rel=1e-4)


def test_a_table_may_be_swapped_cut_off_and_begun_anew() -> None:
    """Half a line waits for its end; what was taken stays taken, and comes once."""
    table = GrowingTable(2)
    assert table.take(b"a,b") == []
    assert table.take(b"a,b\n1,2\n3,") == [0]
    assert table.take(b"a,b\r\n1,2\r\n3,4\r\n") == [1]  # written anew by another system
    assert table.take(b"a,b\n") == []  # rotated
    assert table.take(b"a,b\n5,6\n") == [2]
    assert table.take(b"a,b\n5,6\n5,6\n") == [3]
    assert table.take(b"a,b\n1,2\n3,4\n5,6\n5,6\n7,8\n") == [4]
    assert table.rows == [b"1,2", b"3,4", b"5,6", b"5,6", b"7,8"]
    assert [table.line(k) for k in (0, 4)] == [2, 6]
    with pytest.raises(aridcal.AridcalError, match="other column names"):
        table.take(b"b,a\n")


def test_python_is_led_pose_by_pose_and_goes_on_where_the_table_ends(tmp_path: Path, cell: LiveArm) -> None:
    guided = aridcal.guide(tmp_path / "campaign.yaml", tolerance="3mm")
    for number, pose in enumerate(guided):
        (row,) = cell.measured(np.array([*pose.joints.values()])).to_dict("records")
        assert pose.record(row) == []
        if number == 4:
            break
    again = aridcal.guide(tmp_path / "campaign.yaml", tolerance="3mm")
    assert [event.row for event in again.rows] == [2, 3, 4, 5, 6]
    with pytest.raises(aridcal.AridcalError, match="record"):
        for _ in again:
            pass
    again.end()
    assert again.stop is not None
    assert again.stop.why == "asked"
    with pytest.raises(aridcal.AridcalError, match=r"tolerance: .*0\.2mm"):
        aridcal.guide(tmp_path / "campaign.yaml", tolerance="fine")


def test_a_driver_follows_the_events_and_gets_a_report(tmp_path: Path, cell: LiveArm) -> None:
    """The command as a process of its own: a next or a stop follows every row, and it ends with status 0 and a report."""
    command = [sys.executable, "-m", "aridcal", "guide", str(tmp_path / "campaign.yaml"), "--json", "--no-page"]
    process = subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    assert process.stdin is not None
    assert process.stdout is not None
    events, rows = [], 0
    for line in process.stdout:
        event = json.loads(line)
        events.append(event["event"])
        if event["event"] == "next" and rows < 9:
            lines = cell.measured(np.array([*event["joints"].values()])).to_csv(index=False).splitlines()
            process.stdin.write("".join(f"{text}\n" for text in lines[0 if rows == 0 else 1 :]))
            rows += 1
        elif event["event"] == "next":
            process.stdin.write("reject\n" if events[-2] != "next" else "stop\n")
        process.stdin.flush()
    assert process.wait(60) == 0
    assert events[0] == "next"
    assert events[-3:] == ["next", "next", "stop"]
    assert events.count("row") == 9
    assert all("next" in events[k : k + 3] for k, name in enumerate(events) if name == "row")
    assert (tmp_path / "results" / "report.html").is_file()
    assert len((tmp_path / "measurements.csv").read_text().splitlines()) == 10


def test_a_table_of_another_kind_of_campaign_is_refused_in_words(
    tmp_path: Path, cell: LiveArm, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "measurements.csv").write_text("one,two\n" + "0.1,0.2\n" * 4)
    assert main([str(tmp_path / "campaign.yaml"), "--no-page"]) == 2
    assert "no column" in capsys.readouterr().err


def test_what_ten_rows_ahead_tell_is_what_a_greedy_choice_tells_that_inverts_information_anew(
    tmp_path: Path, cell: LiveArm
) -> None:
    now = begun(tmp_path)
    led(now, cell, 8)
    known = now.posterior
    assert known is not None
    some = now._pool(known)
    chosen = greedy(some.choice, AHEAD)
    F = some.choice.rows[chosen].reshape(-1, len(known.information))
    assert len(set(chosen)) == AHEAD
    np.testing.assert_allclose(ahead(some, known), F.T @ F, rtol=1e-9, atol=1e-9 * float(np.abs(F.T @ F).max()))


def test_the_first_look_at_ways_shuts_out_none_that_is_free_and_the_order_stays(tmp_path: Path, cell: LiveArm) -> None:
    now = begun(tmp_path)
    led(now, cell, 8)
    known, here = now.posterior, now.here()
    assert known is not None and here is not None
    some = now._pool(known)
    gain, readings = worth(some, known), some.candidates.readings
    far, left, offered = np.abs(readings - here).max(axis=1), list(range(len(gain))), []
    for _ in range(WAYS):
        top = max(gain[k] for k in left)
        k = min((k for k in left if gain[k] >= AS_GOOD * top), key=lambda k: far[k])
        left.remove(k)
        offered += [k] if reaches(known, here, readings[k], int(some.candidates.first[k])) else []
    assert 0 < len(offered) < WAYS  # the box is in the way of some
    assert list(best_first(some, gain, known, here, ())) == offered


def test_the_page_shows_the_last_row_and_the_last_alarm_where_an_earlier_row_is_judged_again() -> None:
    board = Board("cell", None, "measurements.csv")
    board.note([RowRead(2, True), RowRead(3, True), RowRead(4, True), Alarm(2, "outlier", "off", "do")])
    board.note([RowRead(2, False, ("off",))])
    state = json.loads(board.text)
    assert (state["last"]["row"], state["last"]["ok"]) == (4, True)
    assert (state["alarms"][-1]["row"], state["alarms"][-1]["after"]) == (2, 4)
    assert [(row["row"], row["ok"]) for row in state["rows"]][-1] == (2, False)
    assert (state["measured"], state["subject"]) == ("rows", "the target")
    board.note([RowRead(4, False)])
    assert json.loads(board.text)["last"]["ok"] is False


def test_the_page_serves_this_computer_only_and_takes_two_words(tmp_path: Path) -> None:
    incoming = Incoming()
    board = Board("cell", 2e-4, "measurements.csv")
    board.note([RowRead(2, True), Known(3, 1e-3, 2e-3), Next({"one": 0.5}, "why")])
    server = GuideServer(board, incoming)

    def ask(path: str, body: bytes | None = None, **headers: str) -> tuple[int, str]:
        request = urllib.request.Request(server.url + path, body, headers)
        try:
            with urllib.request.urlopen(request, timeout=10) as answer:
                return answer.status, answer.read().decode()
        except urllib.error.HTTPError as error:
            return error.code, ""

    status, page = ask("")
    assert status == 200
    assert server.key in page
    assert "http://" not in page.replace("http://www.w3.org/2000/svg", "")
    state = json.loads(ask("state")[1])
    assert (state["next"]["joints"], state["tolerance_mm"]) == ({"one": 0.5}, 0.2)
    assert ask(f"state?have={state['number']}")[0] == 204
    assert ask("", Host="evil.example")[0] == 403
    assert ask("say", b"stop")[0] == 403
    assert ask("say", b"rm", **{"X-Key": server.key})[0] == 400
    assert ask("say", b"reject", **{"X-Key": server.key})[0] == 204
    deadline = time.monotonic() + 10.0
    words: list[str | None] = []
    while not words and time.monotonic() < deadline:
        words = incoming.waiting()
    assert words == ["reject"]


SOCKETS = """format: 1
robot: {urdf: scara.urdf, tip: tool}
measurements: {kind: point, noise: {position: 5.0e-5}}
frames: {tip_target: {xyz: [0.05, 0.02, -0.03], rpy: [0, 0, 0]}}
"""


def test_points_of_which_nobody_says_where_they_are_are_found_and_then_proposed(tmp_path: Path) -> None:
    """Touches by hand at first; then each pose that is proposed holds the ball within 3 mm of where the socket is."""
    (tmp_path / "scara.urdf").write_text(SCARA)
    (tmp_path / "campaign.yaml").write_text(SOCKETS.replace("kind: point", "file: measurements.csv, kind: point"))
    sockets = "{a: [0.4, 0.2, 0.25], b: [0.3, -0.3, 0.2], c: [0.45, 0.1, 0.3]}"
    truth = f"truth: {{n: 24, seed: 1, noise: {{position: 5.0e-5}}, instruments: {{points: {sockets}}}}}\n"
    (tmp_path / "scenario.yaml").write_text(SOCKETS + truth)
    simulation = simulate(load_settings(tmp_path / "scenario.yaml", Scenario))
    head, *lines = simulation.measurements.to_csv(index=False).encode().splitlines()
    now = begun(tmp_path)
    first = now.taken([])[-1]
    assert isinstance(first, Next)
    assert not first.joints
    now.table.add(head)
    said: list[Event] = []
    for line in lines:
        said += now.taken(now.table.add(line))
    proposed = [event for event in said if isinstance(event, Next) and event.joints]
    assert alarms(said) == []
    assert proposed
    real = dict(zip(simulation.real["point"].names, simulation.real["point"].states, strict=True))
    model = Model(now.robot, (), tip_target=((None, simulation.frames["tip_target"]),))
    for pose in proposed:
        _, p = model.poses(np.zeros(0), model.rows(np.array([[*pose.joints.values()]])))
        assert np.linalg.norm(p[0] - real[pose.labels["point"]]) < 3e-3


def test_a_point_touched_for_the_first_time_right_after_the_model_began_is_among_those_to_choose_from(
    tmp_path: Path,
) -> None:
    """A fit takes in all that the table names: taken for known, the point was asked for by hand again and again."""
    (tmp_path / "scara.urdf").write_text(SCARA)
    (tmp_path / "campaign.yaml").write_text(SOCKETS.replace("kind: point", "file: measurements.csv, kind: point"))
    places = {"a": [0.4, 0.2, 0.25], "b": [0.3, -0.3, 0.2], "c": [0.45, 0.1, 0.3], "d": [0.35, 0.3, 0.22]}
    truth = f"truth: {{n: 40, seed: 1, noise: {{position: 5.0e-5}}, instruments: {{points: {json.dumps(places)}}}}}\n"
    (tmp_path / "scenario.yaml").write_text(SOCKETS + truth)
    table = simulate(load_settings(tmp_path / "scenario.yaml", Scenario)).measurements
    in_turn = [table[table["point"] == name][:count] for name, count in (("a", 3), ("b", 3), ("c", 1), ("d", 1))]
    order = pd.concat(in_turn).index.tolist()
    head, *lines = pd.concat(in_turn).to_csv(index=False).encode().splitlines()
    now = begun(tmp_path)
    now.table.add(head)
    began = 0
    for row, line in enumerate(lines, start=1):
        now.taken(now.table.add(line))
        if now.posterior is not None:
            began = began or row
            touched = [{"point": name} for name in dict.fromkeys(table["point"][index] for index in order[:row])]
            assert [*offers(now.posterior.setup).titles] == touched
    assert began == 6


def test_a_point_to_which_no_planned_pose_comes_is_not_proposed_and_its_touches_count_all_the_same(
    tmp_path: Path,
) -> None:
    """One such point ended the guide in the middle of the measurements."""
    (tmp_path / "scara.urdf").write_text(SCARA)
    places = {"a": [0.4, 0.2, 0.25], "b": [0.3, -0.3, 0.2], "c": [0.45, 0.1, 0.3], "d": [0.35, 0.3, 0.22]}
    around_d = "design: {keep_out: [{min: [0.3, 0.25, 0.17], max: [0.4, 0.35, 0.27]}]}\n"
    (tmp_path / "campaign.yaml").write_text(
        SOCKETS.replace("kind: point", "file: measurements.csv, kind: point") + around_d
    )
    truth = f"truth: {{n: 48, seed: 1, noise: {{position: 5.0e-5}}, instruments: {{points: {json.dumps(places)}}}}}\n"
    (tmp_path / "scenario.yaml").write_text(SOCKETS + truth)
    head, *lines = (
        simulate(load_settings(tmp_path / "scenario.yaml", Scenario))
        .measurements.to_csv(index=False)
        .encode()
        .splitlines()
    )
    now = begun(tmp_path)
    now.table.add(head)
    said: list[Event] = []
    for line in lines[:30]:
        said += now.taken(now.table.add(line))
    proposed = {event.labels["point"] for event in said if isinstance(event, Next) and event.joints}
    assert proposed
    assert "d" not in proposed
    assert alarms(said) == []
    assert now.posterior is not None and now.read.rows is not None
    assert {"point": "d"} in offers(now.posterior.setup).titles
    of_d = now.read.rows.labels.refers[:, 0] == "d"
    assert of_d.any() and now._knows()[of_d].all()
    F, _ = now._columns(np.flatnonzero(of_d))
    place = np.flatnonzero(np.any(F[:, :, : now.posterior.things] != 0.0, axis=(0, 1)))
    assert len(place) == 3  # and it is known no better than its touches tell
    noise = 5e-5 / np.sqrt(of_d.sum())  # were all else known; the prior of its place is a millionth of that
    assert np.all(np.sqrt(np.diag(now.posterior.covariance)[place]) > 0.999 * noise)


def test_a_point_that_only_a_length_names_is_asked_for_by_hand_until_it_is_touched_or_refused(tmp_path: Path) -> None:
    """Touched, it may be proposed like the others; refused, it is not asked for again, and rows go on."""
    (tmp_path / "scara.urdf").write_text(SCARA)
    places = {"a": [0.4, 0.2, 0.25], "b": [0.3, -0.3, 0.2], "c": [0.45, 0.1, 0.3], "d": [0.35, 0.3, 0.22]}
    apart = float(np.linalg.norm(np.subtract(places["c"], places["d"])))
    length = f"instruments: {{lengths: [{{between: [c, d], length: {apart}, std: 1.0e-5}}]}}\n"
    (tmp_path / "campaign.yaml").write_text(
        SOCKETS.replace("kind: point", "file: measurements.csv, kind: point") + length
    )
    truth = f"truth: {{n: 40, seed: 1, noise: {{position: 5.0e-5}}, instruments: {{points: {json.dumps(places)}}}}}\n"
    (tmp_path / "scenario.yaml").write_text(SOCKETS + truth)
    table = simulate(load_settings(tmp_path / "scenario.yaml", Scenario)).measurements
    head, *lines = table[table["point"] != "d"].to_csv(index=False).encode().splitlines()

    now = begun(tmp_path)
    now.table.add(head)
    asked: Event | None = None
    for line in lines[:12]:
        asked = now.taken(now.table.add(line))[-1]
    assert isinstance(asked, Next)
    assert (asked.joints, asked.labels) == ({}, {"point": "d"})

    refused = deepcopy(now)
    assert refused.reject()[-1].document()["joints"]
    said = refused.taken(refused.table.add(lines[12]))
    assert not isinstance(said[-1], Next) or said[-1].joints
    # The campaign's own length to it would be an error of `identify`, after all is measured.
    refused.campaign.measurements.files[0].write_bytes(b"\n".join([head, *lines[:13], b""]))
    assert to_calibrate(refused).instruments.lengths == ()
    assert to_calibrate(now).instruments.lengths == now.campaign.instruments.lengths

    touch = table[table["point"] == "d"][:1].to_csv(index=False).encode().splitlines()[1]
    said = now.taken(now.table.add(touch))
    assert now.posterior is not None and alarms(said) == []
    assert {"point": "d"} in offers(now.posterior.setup).titles
    assert not isinstance(said[-1], Next) or said[-1].joints


def test_without_a_length_an_arm_that_is_larger_than_designed_is_not_said_to_be_known(tmp_path: Path) -> None:
    """The attack: an arm enlarged as a whole, whose touches the nominal one explains. Its error is then that of its size."""
    larger = 1.008
    (tmp_path / "scara.urdf").write_text(SCARA)
    (tmp_path / "campaign.yaml").write_text(SOCKETS.replace("kind: point", "file: measurements.csv, kind: point"))
    places = {"a": [0.4, 0.2, 0.25], "b": [0.3, -0.3, 0.2], "c": [0.45, 0.1, 0.3], "d": [0.35, 0.3, 0.22]}
    truth = {
        "n": 40,
        "seed": 1,
        "noise": {"position": 5e-5},
        "parameters": {"two.x": 0.325 * (larger - 1.0), "lift.x": 0.275 * (larger - 1.0)},
        "instruments": {"points": places},
    }
    (tmp_path / "scenario.yaml").write_text(SOCKETS + yaml.safe_dump({"truth": truth}))
    simulation = simulate(load_settings(tmp_path / "scenario.yaml", Scenario))
    head, *lines = simulation.measurements.to_csv(index=False).encode().splitlines()
    now = begun(tmp_path)
    now.table.add(head)
    said = now.taken([now.table.add(line)[0] for line in lines])
    stop = said[-1]
    assert isinstance(stop, Stop)
    assert "instruments.lengths" in stop.words
    # What a robot enlarged about its base is off by, over the region, wherever its base is laid.
    _, p = Model(now.robot, (), tip_target=((None, simulation.frames["tip_target"]),)).poses(
        np.zeros(0), Model(now.robot, ()).rows(now.region)
    )
    off = float(np.quantile(np.linalg.norm((larger - 1.0) * (p - p.mean(axis=0)), axis=1), 0.95))
    assert 1e-3 < off < stop.known.position
