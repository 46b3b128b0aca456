"""Meshes from CAD files, and measured points as PLY, through open3d."""

import re
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from heliogauge.errors import InputError
from heliogauge.files.memory import MIB, refuse_large
from heliogauge.files.regular import read_regular
from heliogauge.validate import FloatArray
from photogrammetry.surface.mesh import MeshSurface, load_open3d, rainbow

_KINDS = (".stl", ".ply", ".obj")
#: Largest mesh; a scan of ten million triangles in binary STL has 480 MiB.
MOST_MESH_BYTES = 1024 * MIB
# Corners and triangles as open3d holds them, twice, beside the file: 50 bytes of STL become three corners of 24 bytes.
_MESH_GROWTH = 6
_OBJ_SHAPE = ([b"v"], [b"f"])


def read_mesh(path: Path, unit_m: float = 1.0) -> MeshSurface:
    """Read a triangle mesh.

    unit_m: Length of its unit; 0.001 for millimetres [m].
    Returns: The mesh in metres; corners that STL repeats are one.
    InputError: No such file, no regular file, too large, damaged or without triangles, or open3d cannot be imported.
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
        _check_ply(path, content)
    open3d = load_open3d()
    with (
        TemporaryDirectory(prefix="heliogauge-mesh-") as folder,
        open3d.utility.VerbosityContextManager(open3d.utility.VerbosityLevel.Error),
    ):
        # A copy: open3d opens by name, and what stands under the name may have changed since it was checked.
        copy = Path(folder) / f"mesh{kind}"
        copy.write_bytes(content)
        mesh = open3d.io.read_triangle_mesh(str(copy))
    mesh.remove_duplicated_vertices()
    vertices, triangles = np.asarray(mesh.vertices), np.asarray(mesh.triangles)
    if len(triangles) == 0:
        raise InputError(f"{path}: no triangles could be read; export the part as a mesh, not as points or curves")
    if not np.isfinite(vertices).all():
        raise InputError(f"{path}: a corner has a coordinate that is no finite number; export the part again")
    return MeshSurface(unit_m * vertices, triangles, path.name)


def _check_ply(path: Path, content: bytes) -> None:
    """Refuse a header that claims more than the file holds; open3d makes room for what it claims."""
    head = content.partition(b"end_header")[0].decode("latin-1")
    for name, count in re.findall(r"^element\s+(\S+)\s+(\d+)", head, re.MULTILINE):
        # A vertex and a face have three numbers at the least, each of one byte or one digit.
        if int(count) > len(content) // 3:
            raise InputError(f"{path}: claims {count} of {name}, which {len(content)} bytes cannot hold; copy it again")


def write_points_ply(path: Path, points_m: FloatArray, deviation_m: FloatArray) -> None:
    """Write points as PLY, coloured by their deviation: blue below, red above the surface.

    Shapes: points_m (n, 3).
    deviation_m (n,): Deviations; the colours end at the largest of 99 % of them [m].
    InputError: The file cannot be written, or open3d cannot be imported.
    """
    open3d = load_open3d()
    cloud = open3d.geometry.PointCloud(open3d.utility.Vector3dVector(np.array(points_m)))
    cloud.colors = open3d.utility.Vector3dVector(rainbow(deviation_m, _limit(deviation_m)))
    if not open3d.io.write_point_cloud(str(path), cloud):
        raise InputError(f"{path}: cannot be written; check permissions and space")


def write_mesh_ply(path: Path, mesh: MeshSurface, points_m: FloatArray, deviation_m: FloatArray) -> None:
    """Write a mesh as PLY, each corner coloured by the deviation of the nearest point.

    Shapes: deviation_m (n,).
    points_m (n, 3): Measured points in the frame of the mesh [m].
    InputError: The file cannot be written, or open3d cannot be imported.
    """
    from scipy.spatial import cKDTree

    open3d = load_open3d()
    nearest = cKDTree(points_m).query(mesh.vertices_m)[1]
    model = open3d.geometry.TriangleMesh(
        open3d.utility.Vector3dVector(np.array(mesh.vertices_m)),
        open3d.utility.Vector3iVector(mesh.triangles.astype(np.int32)),
    )
    model.vertex_colors = open3d.utility.Vector3dVector(rainbow(deviation_m[nearest], _limit(deviation_m)))
    if not open3d.io.write_triangle_mesh(str(path), model):
        raise InputError(f"{path}: cannot be written; check permissions and space")


def _limit(deviation_m: FloatArray) -> float:
    return float(np.nanquantile(np.abs(deviation_m), 0.99)) if deviation_m.size else 1.0
