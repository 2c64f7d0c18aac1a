"""Photographs of printed sheets: the SVG as it was written, seen by a camera whose pose and lens are known."""

from __future__ import annotations

import re

import cv2
import numpy as np
from lxml import etree

from aridcal.engine.instruments.camera import project
from aridcal.jobs.head1992.render import coverage

INTRINSICS = np.array([900.0, 905.0, 485.0, 352.0, -0.12, 0.04, 0.001, -0.0007, 0.0])
SIZE = (960, 720)


def printed(svg: str) -> tuple[list[list[np.ndarray]], np.ndarray, tuple[float, float]]:
    """Black loops and discs of an SVG in [mm] from its middle, y up, and the size of the sheet; letters are left out."""
    root = etree.fromstring(svg.encode())
    assert root.get("viewBox") == f"0 0 {root.get('width').removesuffix('mm')} {root.get('height').removesuffix('mm')}"
    width, height = (float(root.get(name).removesuffix("mm")) for name in ("width", "height"))
    middle = np.array([width, height]) / 2
    paths = [path.get("d") for path in root.findall(".//{*}path[@fill='black']")]
    loops = [
        [
            (np.array([pair.split(",") for pair in loop.split()], float) - middle) * [1, -1]
            for loop in re.findall(r"M ([^Z]+) Z", d)
        ]
        for d in paths
    ]
    circles = root.findall(".//{*}circle[@fill='black']")
    discs = [[float(c.get("cx")) - middle[0], middle[1] - float(c.get("cy")), float(c.get("r"))] for c in circles]
    return loops, np.array(discs).reshape(-1, 3), (width, height)


def looking(x: float, y: float, z: float, tilt: float = 0.0, pan: float = 0.0, roll: float = 0.0) -> np.ndarray:
    """T_camera_board of a board whose middle is at x y z, turned about the camera's x, y and z axes; upright at zero."""
    T = np.eye(4)
    turn = (
        cv2.Rodrigues(np.array([0, 0, roll]))[0]
        @ cv2.Rodrigues(np.array([tilt, 0, 0]))[0]
        @ cv2.Rodrigues(np.array([0, pan, 0]))[0]
    )
    T[:3, :3] = turn @ np.diag([1.0, -1, -1])
    T[:3, 3] = x, y, z
    return T


def pixels_of(places: np.ndarray, T: np.ndarray, intrinsics: np.ndarray = INTRINSICS) -> np.ndarray:
    """Where places on the board, shape (M, 3), [m], are seen: OpenCV's own projection."""
    K = np.array([[intrinsics[0], 0, intrinsics[2]], [0, intrinsics[1], intrinsics[3]], [0, 0, 1]])
    rvec, _ = cv2.Rodrigues(T[:3, :3])
    return cv2.projectPoints(places, rvec, T[:3, 3], K, intrinsics[4:])[0].reshape(-1, 2)


def outlines(loops: list[list[np.ndarray]], discs: np.ndarray) -> list[np.ndarray]:
    """All loops, discs as polygons of 96 corners."""
    around = np.linspace(0, 2 * np.pi, 97)[:-1]
    circles = [np.column_stack([x + r * np.cos(around), y + r * np.sin(around)]) for x, y, r in discs]
    return [*(loop for group in loops for loop in group), *circles]


def covered(polygons: list[np.ndarray], size: tuple[int, int]) -> np.ndarray:
    """Share of each pixel inside polygons of any number of corners; holes turn the other way round."""
    most = max(map(len, polygons))
    same = [np.concatenate([p, np.repeat(p[-1:], most - len(p), axis=0)]) for p in polygons]
    return np.minimum(coverage(np.array(same), *size), 1)


def photograph(svg: str, T: np.ndarray, intrinsics=INTRINSICS, size=SIZE, blur=0.7, noise=1.5, seed=0) -> np.ndarray:
    """A grey image of a printed sheet: exact shares of each pixel, blurred and noisy."""
    loops, discs, (width, height) = printed(svg)
    flat = outlines(loops, discs)
    corner = np.array([width, height]) / 2
    paper = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * corner

    def share(polygons: list[np.ndarray]) -> np.ndarray:
        return covered([_seen(polygon, T, intrinsics) for polygon in polygons], size)

    light = 140 + 90 * share([paper]) - 195 * share(flat)
    light = cv2.GaussianBlur(light, (0, 0), blur) if blur else light
    return np.clip(light + noise * np.random.default_rng(seed).normal(size=light.shape), 0, 255).astype(np.uint8)


def _seen(polygon: np.ndarray, T: np.ndarray, intrinsics: np.ndarray) -> np.ndarray:
    """Image of a polygon, its edges in pieces, which the lens bends."""
    share = np.linspace(0, 1, 7)[:-1, None]
    pieces = [a + share * (b - a) for a, b in zip(polygon, np.roll(polygon, -1, axis=0), strict=True)]
    points = np.concatenate(pieces) / 1e3
    places = np.column_stack([points, np.zeros(len(points))])
    return project(places @ T[:3, :3].T + T[:3, 3], intrinsics)
