"""Samples of ROS's robot_calibration as YAML, as `rostopic echo -b` and `ros2 topic echo` print its bags, as csv.

A sample (robot_calibration_msgs/CalibrationData) holds joint_states with name and position, and observations: of each sensor
a name and features, each with a point.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import yaml

from aridcal.system.errors import MeasurementError, name_list, shortened

FORMAT_NAME = "robot_calibration"

CALIBRATION_ENDINGS = (".yaml", ".yml")

MOST_EVENTS = 5_000_000
"""Of a file: some 20,000 samples of ten joints and a board of twenty corners."""

MOST_DEPTH = 30

LEAST_CHANGE = 1e-6
"""[m] by which points that are measured differ between samples; those of an arm, stated in its own tip, do not."""

_Loader: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)

_DEEPER = {yaml.MappingStartEvent: 1, yaml.SequenceStartEvent: 1, yaml.MappingEndEvent: -1, yaml.SequenceEndEvent: -1}


def sensors(content: bytes, path: Path) -> tuple[str, ...]:
    """Names of the sensors whose points change from one sample to the next.

    Raises:
        MeasurementError: it holds no such samples.
    """
    seen: dict[str, list[list[tuple[float, ...]]]] = {}
    for sample in _samples(content, path):
        for name, points in sample["observations"]:
            seen.setdefault(name, []).append(points)
    found = []
    for name, samples in seen.items():
        first = samples[0]
        moved = any(
            abs(a - b) > LEAST_CHANGE
            for points in samples[1:]
            for one, other in zip(first, points, strict=False)
            for a, b in zip(one, other, strict=True)
        )
        found += [name] if moved else []
    return tuple(found)


def as_csv(content: bytes, path: Path, sensor: str) -> bytes:
    """Joints and points of one sensor as csv; several points of a sample are as many targets.

    Raises:
        MeasurementError: it holds no such samples, or none of that sensor; naming the sample.
    """
    samples = list(_samples(content, path))
    joints = list(samples[0]["joints"])
    rows, several = [], False
    for number, sample in enumerate(samples, start=1):
        if list(sample["joints"]) != joints:
            raise MeasurementError(f"{path}: sample {number} has other joints than the first; export them alike")
        points = [point for name, found in sample["observations"] if name == sensor for point in found]
        several = several or len(points) > 1
        rows += [[number, *sample["joints"].values(), *point, k] for k, point in enumerate(points, start=1)]
    if not rows:
        known = sorted({name for sample in samples for name, _ in sample["observations"]})
        raise MeasurementError(f"{path}: no sample has points of {shortened(sensor)!r}; there are {name_list(known)}")
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    header = ["sample", *joints, "x", "y", "z", "target"]
    writer.writerows([header, *rows] if several else [row[:-1] for row in (header, *rows)])
    return out.getvalue().encode()


def _samples(content: bytes, path: Path) -> Iterator[dict[str, Any]]:
    """Each sample's joints, and for each sensor its points."""
    number = 0
    for document in _documents(content, path):
        for sample in document if isinstance(document, list) else [document]:
            if sample is None:
                continue
            number += 1
            try:
                states, observations = sample["joint_states"], sample["observations"]
                joints = dict(zip(map(str, states["name"]), map(float, states["position"]), strict=True))
                seen = [
                    (
                        str(one["sensor_name"]),
                        [tuple(float(f["point"][axis]) for axis in "xyz") for f in one["features"]],
                    )
                    for one in observations
                ]
                if len(joints) != len(states["name"]):
                    raise ValueError("a joint twice")
            except (KeyError, TypeError, ValueError, OverflowError):
                raise MeasurementError(
                    f"{path}: sample {number} has no joint_states with name and position and observations with features, as "
                    "robot_calibration writes them; print the bag anew"
                ) from None
            yield {"joints": joints, "observations": seen}
    if not number:
        raise MeasurementError(f"{path}: holds no samples of robot_calibration")


def _documents(content: bytes, path: Path) -> list[Any]:
    """Plain values of a file of several documents: no aliases, no tags, no depths."""
    try:
        text = content.decode("utf-8-sig")
        depth = 0
        for count, event in enumerate(yaml.parse(text, Loader=_Loader)):
            depth += _DEEPER.get(type(event), 0)
            tricks = type(event) is yaml.AliasEvent or getattr(event, "tag", None)
            if tricks or depth > MOST_DEPTH or count > MOST_EVENTS:
                mark = event.start_mark
                raise MeasurementError(
                    f"{path}, line {mark.line + 1 if mark else 1}: has aliases, tags, or is too deep or too long for samples of "
                    "robot_calibration; print the bag anew"
                )
        return list(yaml.load_all(text, Loader=_Loader))
    except UnicodeDecodeError:
        raise MeasurementError(f"{path}: is not UTF-8 text; save the file as UTF-8") from None
    except (yaml.YAMLError, ValueError, RecursionError, OverflowError) as problem:
        said = shortened(" ".join(str(problem).split()), 160)
        raise MeasurementError(f"{path}: is not valid YAML: {said}. Print the bag anew") from None
