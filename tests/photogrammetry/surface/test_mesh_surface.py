"""Registration to a CAD mesh: distances, start from anywhere, honesty, files; all through open3d."""

import builtins
from pathlib import Path

import numpy as np
import pytest

from heliogauge.errors import InputError
from heliogauge.geometry.rigid import RigidTransform
from heliogauge.geometry.surfaces import paraboloid_xy, plane
from photogrammetry.surface.design import motion_words
from photogrammetry.surface.fit import fit_surface
from photogrammetry.surface.mesh import MeshSurface, load_open3d, mesh_start, rainbow
from photogrammetry.surface.store_mesh import read_mesh, write_mesh_ply, write_points_ply
from tests.photogrammetry.surfaces_synthetic import design, drawn, grid_xy, on_surface


@pytest.fixture
def open3d():
    try:
        return load_open3d()
    except InputError as error:
        pytest.skip(str(error))


def tessellated(surface, half_m: tuple[float, float] = (2.4, 1.6), n: int = 60) -> MeshSurface:
    x, y = np.meshgrid(np.linspace(-half_m[0], half_m[0], n), np.linspace(-half_m[1], half_m[1], n))
    corners = np.stack([x, y, surface.quadric.height(x, y)], axis=-1).reshape(-1, 3)
    i = np.arange(n * n).reshape(n, n)
    lower = np.stack([i[:-1, :-1], i[:-1, 1:], i[1:, 1:]], axis=-1).reshape(-1, 3)
    upper = np.stack([i[:-1, :-1], i[1:, 1:], i[1:, :-1]], axis=-1).reshape(-1, 3)
    return MeshSurface(corners, np.concatenate([lower, upper]), "panel")


def test_distances_are_those_of_the_closest_triangle(open3d) -> None:
    mesh = MeshSurface([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 1]], [[0, 1, 2], [1, 3, 2]], "two")
    feet = mesh.feet(np.array([[0.2, 0.2, 0.3], [0.2, 0.2, -0.1]]))
    np.testing.assert_allclose(feet.distance_m, [0.3, -0.1], atol=1e-15)
    np.testing.assert_allclose(feet.normals, [[0, 0, 1], [0, 0, 1]], atol=1e-15)


def test_flat_mesh_has_the_symmetries_of_a_plane() -> None:
    words = motion_words(tessellated(design(plane), n=5).symmetries())
    assert words == ("rotation about z", "shift along x", "shift along y")


@pytest.mark.parametrize("file", ["part.stl", "part.ply", "part.obj"])
def test_mesh_files_are_read_in_their_unit(open3d, tmp_path: Path, file: str) -> None:
    mesh = tessellated(design(plane), n=6)
    model = open3d.geometry.TriangleMesh(
        open3d.utility.Vector3dVector(1e3 * mesh.vertices_m),
        open3d.utility.Vector3iVector(mesh.triangles.astype(np.int32)),
    )
    model.compute_triangle_normals()
    with open3d.utility.VerbosityContextManager(open3d.utility.VerbosityLevel.Error):
        open3d.io.write_triangle_mesh(str(tmp_path / file), model)
    found = read_mesh(tmp_path / file, 1e-3)
    assert found.vertices_m.shape == (36, 3)
    assert found.triangles.shape == (50, 3)
    assert float(np.ptp(found.vertices_m[:, 0])) == pytest.approx(4.8)


def test_points_are_registered_from_anywhere_as_well_as_their_sigma_says(open3d) -> None:
    surface, rng = design(paraboloid_xy, 1.5, 3.0), np.random.default_rng(0)
    mesh = tessellated(surface)
    own = on_surface(surface, grid_xy(9) * [1.0, 0.6])
    far = RigidTransform.from_rotation_vector([1.6, -1.4, 1.0], [30.0, 2.0, -5.0])
    points = drawn(far.apply(own), 1e-4 * np.eye(243), rng)
    start, how = mesh_start(points.points_m, mesh, far.apply([0.0, 0, 6]))
    assert "principal axes" in how
    fit = fit_surface(points, mesh, start)
    error = fit.design_from_world @ far
    # A rectangle looks the same after half a turn about z; which one is met is open.
    turned = np.sign(error.rotation[0, 0]) * np.array([1.0, 1.0, 1.0])
    assert abs(error.rotation[2, 2]) == pytest.approx(1, abs=1e-5)
    sigma = np.sqrt(np.diag(fit.parameters.covariance))
    assert (np.abs(turned * error.translation_m) < 5 * sigma[3:] + 2e-4).all()
    assert fit.rms_deviation_m == pytest.approx(1e-4, rel=0.35)


def test_ply_files_hold_points_and_colours(open3d, tmp_path: Path) -> None:
    mesh = tessellated(design(plane), n=5)
    points = np.array([[0.0, 0, 0.001], [1, 0, -0.001], [0, 1, 0]])
    deviation = np.array([0.001, -0.001, 0.0])
    write_points_ply(tmp_path / "points.ply", points, deviation)
    write_mesh_ply(tmp_path / "mesh.ply", mesh, points, deviation)
    cloud = open3d.io.read_point_cloud(str(tmp_path / "points.ply"))
    np.testing.assert_allclose(np.asarray(cloud.points), points, atol=1e-12)
    red, blue, white = np.asarray(cloud.colors)
    assert red[0] > 0.6 > red[2]
    assert blue[2] > 0.6 > blue[0]
    assert white.min() > 0.9
    assert len(open3d.io.read_triangle_mesh(str(tmp_path / "mesh.ply")).triangles) == 32


def test_missing_library_is_named_with_its_remedy(monkeypatch: pytest.MonkeyPatch) -> None:
    real = builtins.__import__

    def refuse(name: str, *rest, **named):
        if name == "open3d":
            raise OSError("libusb-1.0.so.0: cannot open shared object file")
        return real(name, *rest, **named)

    monkeypatch.setattr(builtins, "__import__", refuse)
    with pytest.raises(InputError, match=r"pip install heliogauge\[3d\].*libusb-1.0-0"):
        load_open3d()


def test_impossible_meshes_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="none of its 1 triangles has an area"):
        MeshSurface([[0.0, 0, 0], [1, 0, 0], [2, 0, 0]], [[0, 1, 2]], "line")
    with pytest.raises(InputError, match="corners are needed"):
        MeshSurface([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 3]], "gap")
    with pytest.raises(InputError, match="there is no such mesh"):
        read_mesh(tmp_path / "absent.stl")
    (tmp_path / "part.step").write_text("x")
    with pytest.raises(InputError, match=r"a mesh is an .stl, .ply, .obj file"):
        read_mesh(tmp_path / "part.step")


def test_file_without_triangles_is_refused(open3d, tmp_path: Path) -> None:
    (tmp_path / "part.stl").write_text("not a mesh")
    with pytest.raises(InputError, match="no triangles could be read"):
        read_mesh(tmp_path / "part.stl")


def test_odd_mesh_files_are_refused_before_they_are_decoded(open3d, tmp_path: Path) -> None:
    (tmp_path / "folder.ply").mkdir()
    with pytest.raises(InputError, match="is a folder"):
        read_mesh(tmp_path / "folder.ply")
    head = "ply\nformat ascii 1.0\nelement vertex 90000000000\nproperty float x\nend_header\n"
    (tmp_path / "claims.ply").write_text(head)
    with pytest.raises(InputError, match="claims 90000000000 of vertex"):
        read_mesh(tmp_path / "claims.ply")
    (tmp_path / "odd.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 nan 0\nf 1 2 3\n")
    with pytest.raises(InputError, match="no finite number"):
        read_mesh(tmp_path / "odd.obj")


def test_materials_of_a_mesh_are_not_followed(open3d, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "part.obj").write_text("mtllib /nowhere/secret.mtl\nusemtl m\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    assert read_mesh(tmp_path / "part.obj").triangles.shape == (1, 3)
    assert "secret" not in "".join(capfd.readouterr())


def test_colours_are_grey_without_a_value() -> None:
    np.testing.assert_array_equal(rainbow(np.array([np.nan]), 1.0), [[0.5, 0.5, 0.5]])
