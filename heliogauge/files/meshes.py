"""Triangle meshes from CAD files (STL, PLY, OBJ), through open3d."""

import struct
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from heliogauge.errors import InputError
from heliogauge.files.memory import MIB, refuse_large
from heliogauge.files.ply import checked_ply
from heliogauge.files.regular import read_regular
from heliogauge.validate import FloatArray, IntArray

_KINDS = (".stl", ".ply", ".obj")
#: Largest mesh; a scan of ten million triangles in binary STL has 480 MiB.
MOST_MESH_BYTES = 1024 * MIB
# Corners and triangles as open3d holds them, twice, beside the file: 50 bytes of STL become three corners of 24 bytes.
_MESH_GROWTH = 6
_OBJ_SHAPE = ([b"v"], [b"f"])
_STL_HEAD_BYTES, _STL_TRIANGLE_BYTES = 84, 50


def read_triangles(path: Path, load_open3d: Callable[[], Any]) -> tuple[FloatArray, IntArray]:
    """Read a triangle mesh.

    load_open3d: Imports the library, once the file is found to be a mesh.
    Returns: Corners, shape (n, 3), in the unit of the file, those that STL repeats once; triangles, shape (m, 3).
    InputError: No such file, no regular file, too large, damaged or without triangles.
    """
    kind = path.suffix.lower()
    if kind not in _KINDS:
        raise InputError(f"{path}: a mesh is an {', '.join(_KINDS)} file")
    content = read_regular(path, "a mesh", MOST_MESH_BYTES)
    refuse_large(str(path), _MESH_GROWTH * len(content), f"a mesh of {len(content) / MIB:.0f} MiB")
    if kind == ".obj":
        # Materials and pictures are other files, anywhere; a shape needs none of them.
        content = b"\n".join(line for line in content.splitlines() if line.split()[:1] in _OBJ_SHAPE)
    elif kind == ".ply":
        content = checked_ply(path, content)
    else:
        _check_stl(path, content)
    open3d = load_open3d()
    with (
        TemporaryDirectory(prefix="heliogauge-mesh-") as folder,
        open3d.utility.VerbosityContextManager(open3d.utility.VerbosityLevel.Error),
    ):
        # A copy: open3d opens by name, and what stands under the name may have changed since it was checked.
        copy = Path(folder) / f"mesh{kind}"
        copy.write_bytes(content)
        try:
            mesh = open3d.io.read_triangle_mesh(str(copy))
            mesh.remove_duplicated_vertices()
            vertices, triangles = np.asarray(mesh.vertices), np.asarray(mesh.triangles)
        except MemoryError as error:
            raise InputError(f"{path}: there is not enough memory to read it") from error
    if len(triangles) == 0:
        raise InputError(f"{path}: no triangles could be read; export the part as a mesh, not as points or curves")
    if not np.isfinite(vertices).all():
        raise InputError(f"{path}: a corner has a coordinate that is no finite number; export the part again")
    return vertices, triangles.astype(np.intp)


def _check_stl(path: Path, content: bytes) -> None:
    """Refuse a binary STL that claims more triangles than it holds; a text begins with "solid"."""
    if content[:5] == b"solid" or len(content) < _STL_HEAD_BYTES:
        return
    (count,) = struct.unpack_from("<I", content, _STL_HEAD_BYTES - 4)
    if _STL_HEAD_BYTES + count * _STL_TRIANGLE_BYTES > len(content):
        raise InputError(f"{path}: claims {count} triangles, which {len(content)} bytes cannot hold; copy it again")
