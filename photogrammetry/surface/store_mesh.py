"""Meshes from CAD files, and measured points as PLY, through open3d."""

from pathlib import Path

import numpy as np

from heliogauge.errors import InputError
from heliogauge.files.meshes import read_triangles
from heliogauge.validate import FloatArray
from photogrammetry.surface.mesh import MeshSurface, load_open3d, rainbow


def read_mesh(path: Path, unit_m: float = 1.0) -> MeshSurface:
    """Read a triangle mesh.

    unit_m: Length of its unit; 0.001 for millimetres [m].
    Returns: The mesh in metres; corners that STL repeats are one.
    InputError: As `heliogauge.files.meshes.read_triangles`, or open3d cannot be imported.
    """
    vertices, triangles = read_triangles(path, load_open3d)
    return MeshSurface(unit_m * vertices, triangles, path.name)


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
