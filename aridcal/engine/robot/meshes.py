"""Mesh files, read in a process of their own: whatever such a file does to its reader, the calibration goes on.

Run as a program, this module is that process. It reads names of files, one a line, and answers each with what is in it.
It dies of a file that takes too long or too much memory, and is then started anew for the files that are left.
"""

from __future__ import annotations

import ctypes
import io
import json
import os
import resource
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from typing import IO, Any

import numpy as np

from aridcal.system.errors import shortened

FORMATS = (".stl", ".dae", ".obj", ".ply", ".glb", ".gltf", ".off")
"""Formats that URDFs name. Archives are left out: what is in them has no size beforehand."""

# [MB] of one file, and of all files of a robot: detailed arms have meshes of 5 MB, and a text file of 50 MB holds half a
# million triangles, four times what is drawn of a whole robot.
FILE_MB, ROBOT_MB = 50, 250

# [s] for one file, and after which no other is begun: a file of 50 MB takes 7.
FILE_SECONDS, ROBOT_SECONDS = 30, 90

# [GB] of address space for the reader: COLLADA of 50 MB takes 1.1, of which the libraries themselves 0.35.
MESH_MEMORY_GB = 1.5

# Triangles kept of one file: as many as are drawn of a whole robot.
TRIANGLES = 120_000

# Colours kept of one file: more than one sees.
MOST_COLOURS = 64

# Cells of a thinned mesh's grid along its long side: at first, by which factor fewer each round, and at least.
FINEST, COARSER, COARSEST = 1000.0, 0.7, 16

READY = b"ready\n"

# Of Linux's prctl: the signal that a process gets when the one that started it dies.
PR_SET_PDEATHSIG = 1

Colour = tuple[float, ...] | None
MeshPart = tuple[Colour, np.ndarray, np.ndarray]
"""Red, green and blue from 0 to 1 (None: the file has no colour), vertices (V, 3) and faces (F, 3)."""


class NotDrawable(Exception):
    """Something has to be left out of a picture; the message says why."""


class MeshMissing(NotDrawable):
    """A mesh file is not there.

    Attributes:
        uri: As the URDF names it.
        package: Of ROS, that it is in, if that is not found either; empty if it is in none, or in one without this file.
    """

    def __init__(self, uri: str, package: str) -> None:
        super().__init__(f"no mesh {shortened(uri)!r}")
        self.uri, self.package = uri, package


def read_meshes(paths: Sequence[Path]) -> dict[Path, list[MeshPart] | NotDrawable]:
    """Read mesh files. Of the files that these name only an OBJ's colours and a glTF's numbers are looked at, never a texture.

    Returns:
        By path, the parts of each file, one for each colour, or why there are none.
    """
    answers: dict[Path, list[MeshPart] | NotDrawable] = {}
    waiting = []
    room = ROBOT_MB * 1e6
    for path in dict.fromkeys(paths):
        refused = _refusal(path, room)
        if refused is None:
            waiting.append(path)
            room -= path.stat().st_size
        else:
            answers[path] = refused
    end = time.monotonic() + ROBOT_SECONDS
    while waiting and time.monotonic() < end:
        for answer in _ask(tuple(waiting), end):
            answers[waiting.pop(0)] = answer
    for path in waiting:
        answers[path] = NotDrawable(f"mesh {path.name!r} is not read: those before it took {ROBOT_SECONDS} s")
    return answers


def _refusal(path: Path, room: float) -> NotDrawable | None:
    """Say why a file is not read, room being the bytes that are left for it; None if it is."""
    megabytes = path.stat().st_size / 1e6
    if path.suffix.lower() not in FORMATS:
        return NotDrawable(f"mesh {path.name!r} has none of the formats {', '.join(FORMATS)}")
    if megabytes > FILE_MB:
        return NotDrawable(f"mesh {path.name!r} has {megabytes:.0f} MB, more than {FILE_MB}: draw a simpler one")
    if 1e6 * megabytes > room:
        return NotDrawable(f"mesh {path.name!r} is left out: the robot's meshes have more than {ROBOT_MB} MB in all")
    return None


def _ask(paths: Sequence[Path], end: float) -> Iterator[list[MeshPart] | NotDrawable]:
    """Give a reader's answers, until it has no more to read, or dies, or it is too late."""
    environment = {
        **os.environ,
        "PYTHONPATH": os.pathsep.join(filter(None, sys.path)),  # what we can import, it can
        "OPENBLAS_NUM_THREADS": "1",  # each thread would reserve memory
        "OMP_NUM_THREADS": "1",
    }
    # -P: no module from the folder where the user happens to be
    command = [sys.executable, "-P", "-m", __name__, str(FILE_SECONDS), str(MESH_MEMORY_GB)]
    try:
        reader = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, env=environment
        )
    except OSError as error:
        yield from (NotDrawable(f"mesh {path.name!r} is not read: no reader can be started: {error}") for path in paths)
        return
    with reader:
        assert reader.stdin is not None
        assert reader.stdout is not None
        try:
            started = reader.stdout.readline() == READY
            for path in paths:
                if not started:
                    yield NotDrawable(f"mesh {path.name!r} is not read: the reader of meshes does not start")
                    continue
                with suppress(BrokenPipeError):  # it is dead: it has no answer, either
                    os.write(reader.stdin.fileno(), f"{json.dumps(str(path.absolute()))}\n".encode())
                answer = _answer(reader.stdout)
                if answer is None:
                    yield _died(path, reader.wait())
                    return
                yield answer
                if time.monotonic() > end:
                    return
        finally:
            reader.kill()


def _answer(stream: IO[bytes]) -> list[MeshPart] | NotDrawable | None:
    """Read what the reader says of one file; None if it died of it."""
    head = stream.readline()
    if not head.endswith(b"\n"):
        return None
    fields = json.loads(head)
    if "why" in fields:
        return NotDrawable(fields["why"])
    content = stream.read(fields["bytes"])
    if len(content) < fields["bytes"]:
        return None
    arrays = np.load(io.BytesIO(content), allow_pickle=False)
    return [
        (None if colour is None else tuple(colour), arrays[f"vertices {k}"], arrays[f"faces {k}"])
        for k, colour in enumerate(fields["colours"])
    ]


def _died(path: Path, status: int) -> NotDrawable:
    if status == -signal.SIGALRM:
        return NotDrawable(f"mesh {path.name!r} takes longer than {FILE_SECONDS} s to read")
    return NotDrawable(f"mesh {path.name!r} cannot be read: its reader died of it (status {status})")


def weld(vertices: np.ndarray, faces: np.ndarray, most: int) -> tuple[np.ndarray, np.ndarray]:
    """Snap vertices to a grid, join those that meet and drop faces that vanish.

    The grid starts at a thousandth of the mesh's size and is made coarser until at most ``most`` faces are left, or it is down
    to 16 cells (Rossignac and Borrel, "Multi-resolution 3D approximations", 1993).

    Args:
        vertices: Shape (V, 3), [m].
        faces: Indices of vertices, shape (F, 3).
        most: Wanted number of faces.

    Returns:
        Vertices and faces that are left, each joined one standing where its first one stood. What is thinner than the
        finest grid has none left; what would vanish on a coarser one keeps more than wanted.
    """
    low, cells = vertices.min(axis=0), FINEST
    size = max(float(np.ptp(vertices, axis=0).max()), 1e-12)
    result = vertices[:0], faces[:0]
    while True:
        x, y, z = ((vertices - low) * (cells / size)).round().astype(np.int64).T
        cell = (x << 40) + (y << 20) + z
        _, first, inverse = np.unique(cell, return_index=True, return_inverse=True)
        welded = inverse.reshape(-1)[faces]
        a, b, c = welded.T
        welded = welded[(a != b) & (b != c) & (c != a)]
        if not len(welded):
            return result
        numbers, again = np.unique(welded, return_inverse=True)
        result = vertices[first[numbers]], again.reshape(-1, 3)
        if len(welded) <= most or cells < COARSEST:
            return result
        cells *= COARSER


def load_mesh(path: Path) -> list[MeshPart]:
    """Read one mesh file with trimesh, here and now.

    Raises:
        NotDrawable: it cannot be read, or has no faces.
    """
    import trimesh

    try:
        with path.open("rb") as file:
            meshes = trimesh.load_scene(file, file_type=path.suffix[1:].lower(), resolver=_companions(path)).dump()
    except MemoryError:
        raise NotDrawable(f"mesh {path.name!r} takes too much memory to read") from None
    except Exception as error:  # whatever its many readers raise
        raise NotDrawable(f"mesh {path.name!r} cannot be read: {error or type(error).__name__}") from None
    groups: dict[Colour, list[Any]] = {}
    for mesh in meshes:
        if isinstance(mesh, trimesh.Trimesh) and _sound(mesh.vertices, mesh.faces):
            groups.setdefault(_mesh_colour(mesh, path), []).append(mesh)
    if not groups:
        raise NotDrawable(f"mesh {path.name!r} has no faces")
    if len(groups) > MOST_COLOURS:
        raise NotDrawable(f"mesh {path.name!r} has more than {MOST_COLOURS} colours: draw a simpler one")
    return [(colour, *_joined(group)) for colour, group in groups.items()]


def _companions(path: Path) -> dict[str, bytes]:
    """Read the files beside a mesh that it may need, by name: an OBJ's colours, a glTF's numbers. No texture is one."""
    endings = {".obj": "*.mtl", ".gltf": "*.bin"}.get(path.suffix.lower())
    if endings is None:
        return {}
    beside = [file for file in path.parent.glob(endings) if file.is_file() and file.stat().st_size <= FILE_MB * 1e6]
    return {file.name: file.read_bytes() for file in beside}


def _sound(vertices: np.ndarray, faces: np.ndarray) -> bool:
    """Whether there are faces, all of vertices that there are."""
    return bool(len(faces) and np.isfinite(vertices).all() and faces.min() >= 0 and faces.max() < len(vertices))


def _joined(meshes: list[Any]) -> tuple[np.ndarray, np.ndarray]:
    """Join meshes of one colour, and thin them to what can be drawn at all.

    By hand: trimesh would join their textures, too, and decode these for it.
    """
    starts = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes[:-1])])
    vertices = np.vstack([mesh.vertices for mesh in meshes])
    faces = np.vstack([mesh.faces + start for mesh, start in zip(meshes, starts, strict=True)])
    return weld(vertices, faces, TRIANGLES) if len(faces) > TRIANGLES else (vertices, faces)


def _mesh_colour(mesh: Any, path: Path) -> Colour:
    """Return a mesh's main colour, red, green and blue from 0 to 1; None for STL, whose colours nobody agrees on."""
    if path.suffix.lower() == ".stl":
        return None
    rgba = getattr(getattr(mesh.visual, "material", None), "main_color", None)
    if rgba is None:
        rgba = getattr(mesh.visual, "main_color", None)
    if rgba is None:
        return None
    rgb = np.asarray(rgba[:3], float) / 255
    return tuple(rgb.tolist())


def _serve(answers: IO[bytes], seconds: int, gigabytes: float) -> None:
    """Answer each file named on the standard input; die of one that takes too long."""
    import trimesh  # noqa: F401  (before the clock runs)

    with suppress(AttributeError):  # elsewhere than on Linux it lives on until its time is over
        ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
    most = int(1e9 * gigabytes)
    resource.setrlimit(resource.RLIMIT_AS, (most, most))
    signal.signal(signal.SIGALRM, signal.SIG_DFL)
    answers.write(READY)
    answers.flush()
    for line in sys.stdin:
        signal.alarm(seconds)
        content = io.BytesIO()
        fields: dict[str, Any] = {}
        try:
            parts = load_mesh(Path(json.loads(line)))
            arrays = {f"vertices {k}": vertices for k, (_, vertices, _) in enumerate(parts)}
            arrays |= {f"faces {k}": faces for k, (_, _, faces) in enumerate(parts)}
            np.savez(content, allow_pickle=False, **arrays)
            fields |= {"colours": [colour for colour, _, _ in parts], "bytes": len(content.getbuffer())}
        except NotDrawable as error:
            fields |= {"why": str(error)}
        answers.write(json.dumps(fields).encode() + b"\n" + content.getbuffer())
        answers.flush()


if __name__ == "__main__":
    with os.fdopen(os.dup(1), "wb") as ours:
        os.dup2(2, 1)  # what a reader prints is no answer
        _serve(ours, int(sys.argv[1]), float(sys.argv[2]))
