"""A triangle mesh as the surface that points are fitted to; closest triangles and a start through open3d."""

from dataclasses import dataclass, field
from itertools import product
from typing import Any

import numpy as np

from heliogauge.errors import EstimationError, InputError
from heliogauge.geometry.rigid import RigidTransform, nearest_rotation
from heliogauge.validate import FloatArray, IntArray, float_array
from photogrammetry.surface.design import Feet, RigidReference, null_motions
from photogrammetry.surface.fit import quick_fit

_NAMES = "libusb-1.0-0 libgl1 libgomp1"
#: Points drawn from the mesh for ICP: enough for a start, the fit itself uses the triangles.
_DRAWN = 20_000
#: A motion counts as a symmetry of a mesh below this share: faces of a turned part repeat to rounding only.
_INVARIANT = 1e-6
_EQUAL = 1.05


def load_open3d() -> Any:
    """Import open3d.

    InputError: It is not installed, or a system library of it is missing.
    """
    try:
        import open3d
    except (ImportError, OSError) as error:
        raise InputError(
            f"meshes and PLY files need open3d, which cannot be imported ({error}); pip install heliogauge[3d], and "
            f"the system packages it needs: apt-get install {_NAMES} (libusb-1.0 is the one most often missing)"
        ) from error
    return open3d


@dataclass(frozen=True, slots=True, eq=False)
class MeshSurface(RigidReference):
    """A triangle mesh, its outer side towards the cameras.

    vertices_m (v, 3): Corners [m].
    triangles (t, 3): Corners of each triangle, counter-clockwise seen from outside.
    name: What it is, for messages.
    scene: What open3d searches in; built with the first search.
    InputError: No triangle with an area, or corners that do not exist.

    Distances are measured from the plane of the closest triangle: a point beyond the mesh's border is measured from
    its continuation. A curved part is no better than its tessellation.
    """

    vertices_m: FloatArray
    triangles: IntArray
    name: str
    scene: Any = field(init=False, default=None, repr=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "vertices_m", float_array("vertices_m", self.vertices_m, (None, 3)))
        triangles = np.array(self.triangles, dtype=np.int64).reshape(-1, 3)
        if triangles.size == 0 or triangles.min() < 0 or triangles.max() >= len(self.vertices_m):
            raise InputError(f"mesh {self.name}: triangles of its {len(self.vertices_m)} corners are needed")
        corners = self.vertices_m[triangles]
        across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        real = (across**2).sum(axis=1) > 1e-24
        if not real.any():
            raise InputError(f"mesh {self.name}: none of its {len(triangles)} triangles has an area")
        triangles = triangles[real]
        triangles.setflags(write=False)
        object.__setattr__(self, "triangles", triangles)

    @property
    def face_areas_and_normals(self) -> tuple[FloatArray, FloatArray]:
        """Area [m^2] and unit normal of each triangle, shapes (t,) and (t, 3)."""
        corners = self.vertices_m[self.triangles]
        across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        length = np.linalg.norm(across, axis=1)
        return 0.5 * length, across / length[:, None]

    def feet(self, points_m: FloatArray) -> Feet:
        """Return distances from the planes of the closest triangles, shape (n, 3) of points [m].

        Shapes: points_m (n, 3).
        InputError: The library open3d cannot be imported.
        """
        if not np.isfinite(points_m).all():
            gap = np.full(len(points_m), np.nan)
            return Feet(gap, np.full((len(points_m), 3), np.nan), np.zeros((len(points_m), 0)))
        closest = _closest_triangles(self, points_m)
        # The library works in float32; only its choice of the triangle is used.
        corners = self.vertices_m[self.triangles[closest]]
        across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        normals = across / np.linalg.norm(across, axis=1)[:, None]
        distance = np.einsum("ni,ni->n", normals, points_m - corners[:, 0])
        return Feet(distance, normals, np.zeros((len(points_m), 0)))

    def symmetries(self) -> FloatArray:
        """Return motions that leave the mesh as it is, shape (6, s)."""
        areas, normals = self.face_areas_and_normals
        corners = self.vertices_m[self.triangles]
        root = np.sqrt(areas / areas.sum())[:, None]
        rows = [root * np.concatenate([np.cross(corners[:, k], normals), normals], axis=1) for k in range(3)]
        return null_motions(np.linalg.qr(np.concatenate(rows))[1], _INVARIANT)

    def describe(self) -> str:
        """Return the mesh in words."""
        return f"mesh {self.name} of {len(self.triangles)} triangles"


def _closest_triangles(mesh: MeshSurface, points_m: FloatArray) -> IntArray:
    open3d = load_open3d()
    # About the middle: float32 then keeps 0.2 um over 4 m.
    center = mesh.vertices_m.mean(axis=0)
    if mesh.scene is None:
        scene = open3d.t.geometry.RaycastingScene()
        vertices = open3d.core.Tensor((mesh.vertices_m - center).astype(np.float32))
        scene.add_triangles(vertices, open3d.core.Tensor(mesh.triangles.astype(np.uint32)))
        object.__setattr__(mesh, "scene", scene)
    query = open3d.core.Tensor((points_m - center).astype(np.float32))
    return np.asarray(mesh.scene.compute_closest_points(query)["primitive_ids"].numpy(), dtype=np.int64)


def mesh_start(points_m: FloatArray, mesh: MeshSurface, viewer_m: FloatArray) -> tuple[RigidTransform, str]:
    """Find where a mesh lies among points: iterative closest points from several attitudes.

    Shapes: points_m (n, 3).
    mesh: The mesh, in its own frame.
    viewer_m (3,): Where the cameras were, on the outer side [m].
    design_from_world: Start for `photogrammetry.surface.fit.fit_surface`.
    InputError: The library open3d cannot be imported.
    EstimationError: No attitude fits.
    """
    open3d = load_open3d()
    model = open3d.geometry.TriangleMesh(
        open3d.utility.Vector3dVector(np.array(mesh.vertices_m)),
        open3d.utility.Vector3iVector(mesh.triangles.astype(np.int32)),
    )
    model.compute_triangle_normals()
    open3d.utility.random.seed(0)
    target = model.sample_points_uniformly(_DRAWN, use_triangle_normal=True)
    source = open3d.geometry.PointCloud(open3d.utility.Vector3dVector(np.array(points_m)))
    reach = float(np.linalg.norm(np.ptp(mesh.vertices_m, axis=0)))
    how = open3d.pipelines.registration.TransformationEstimationPointToPlane()
    limits = open3d.pipelines.registration.ICPConvergenceCriteria(max_iteration=60)
    found = []
    for place, start in enumerate((RigidTransform.identity(), *_attitudes(points_m, np.asarray(target.points)))):
        matrix = np.eye(4)
        matrix[:3, :3], matrix[:3, 3] = start.rotation, start.translation_m
        result = open3d.pipelines.registration.registration_icp(source, target, 0.5 * reach, matrix, how, limits)
        moved = np.array(result.transformation)
        fit = quick_fit(points_m, mesh, RigidTransform(nearest_rotation(moved[:3, :3]), moved[:3, 3]))
        feet = mesh.feet(fit.pose.apply(points_m))
        towards = np.einsum("ni,ni->n", feet.normals, fit.pose.apply(viewer_m) - fit.pose.apply(points_m))
        if np.isfinite(fit.rms_m) and np.median(towards) > 0:
            found.append((fit, place == 0))
    if not found:
        raise EstimationError(f"surface: {mesh.describe()} does not fit the points; is mesh_unit right?")
    least = min(fit.rms_m for fit, _ in found)
    own = [fit for fit, is_own in found if is_own and fit.rms_m <= _EQUAL * least + 1e-9]
    if own:
        return own[0].pose, "the frame of the network"
    return min((fit for fit, _ in found), key=lambda fit: fit.rms_m).pose, "the principal axes of points and mesh"


def _attitudes(points_m: FloatArray, target_m: FloatArray) -> list[RigidTransform]:
    """Return the rotations that bring the principal axes of points onto those of the mesh, one for each half turn."""
    own, other = points_m - points_m.mean(axis=0), target_m - target_m.mean(axis=0)
    axes, wanted = np.linalg.svd(own, full_matrices=False)[2], np.linalg.svd(other, full_matrices=False)[2]
    poses = []
    for signs in product((1.0, -1.0), repeat=3):
        rotation = wanted.T @ np.diag(signs) @ axes
        if np.linalg.det(rotation) > 0:
            poses.append(RigidTransform(rotation, target_m.mean(axis=0) - rotation @ points_m.mean(axis=0)))
    return poses


def rainbow(values: FloatArray, limit: float) -> FloatArray:
    """Return colours from blue through white to red for values from -limit to limit, shape (n, 3), grey for NaN."""
    share = np.clip(np.nan_to_num(values) / max(limit, 1e-12), -1, 1)[:, None]
    red, white, blue = np.array([0.70, 0.09, 0.17]), np.array([0.97, 0.97, 0.97]), np.array([0.13, 0.40, 0.67])
    colors = white + np.where(share > 0, share * (red - white), -share * (blue - white))
    return np.asarray(np.where(np.isfinite(values)[:, None], colors, 0.5))
