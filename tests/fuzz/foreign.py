"""Small files of other programs, and photographs of grey levels, with every part that is read of them."""

import json
from collections.abc import Callable
from pathlib import Path

import cv2
import h5py
import numpy as np


def write_opencsp(folder: Path) -> None:
    """Write small files of OpenCSP with every part that an import needs."""
    rng = np.random.default_rng(5)
    content = {
        "measurement": {
            "MeasurementSofastFringe/fringe_images": rng.integers(0, 255, (6, 8, 12), dtype=np.uint8),
            "MeasurementSofastFringe/mask_images": rng.integers(0, 255, (6, 8, 2), dtype=np.uint8),
            "MeasurementSofastFringe/fringe_periods_x": [0.9, 4.0],
            "MeasurementSofastFringe/fringe_periods_y": [0.8],
            "MeasurementSofastFringe/dist_optic_screen": 9.5,
            "MeasurementSofastFringe/v_measure_point_facet": [0.0, 0.1, 0.0],
            "MeasurementSofastFringe/name": "made here",
            "MeasurementSofastFringe/date": "2024-02-03T04:05:06",
        },
        "camera": {
            "Camera/intrinsic_mat": np.array([[700.0, 0, 4.0], [0, 690.0, 3.0], [0, 0, 1.0]]),
            "Camera/distortion_coef": [[-0.1, 0.2, 1e-4, 2e-4]],
            "Camera/image_shape_xy": [8, 6],
            "Camera/name": "small",
        },
        "display": {
            "DisplayShape/screen_model": "distorted2D",
            "DisplayShape/name": "wall",
            "DisplayShape/xy_screen_fraction": [[0.0, 1.0, 0.5], [0.0, 0.0, 0.9]],
            "DisplayShape/xy_screen_coords": [[-2.0, 2.1, 0.0], [-1.0, -1.1, 0.8]],
        },
        "orientation": {
            "SpatialOrientation/r_cam_screen": [-0.1, 0.3, -0.05],
            "SpatialOrientation/v_cam_screen_cam": [[1.0], [0.2], [0.3]],
        },
    }
    for name, parts in content.items():
        with h5py.File(folder / f"{name}.h5", "w") as file:
            for key, value in parts.items():
                file[key] = value
    corners = {"x": [0.5, -0.5, -0.5, 0.5], "y": [-0.4, -0.4, 0.4, 0.4], "z": [0.0] * 4}
    facet = {"v_facet_corners": corners, "v_centroid_facet": {"x": [0.01], "y": [0.02], "z": [0.0]}}
    (folder / "f.json").write_text(json.dumps(facet))


def write_grey(folder: Path) -> None:
    """Write photographs of uniform grey levels on a display of gamma 2.2."""
    rng = np.random.default_rng(6)
    levels = [0, 64, 128, 192, 255]
    listed = ", ".join(map(str, levels))
    (folder / "measurement.toml").write_text(
        f'kind = "response"\nname = "monitor"\n\n[display]\nlevels = [{listed}]\nfull_level = 255\n\n'
        '[images]\ngrey = "grey_*.png"\n'
    )
    for level in levels:
        seen = 5 + 240 * (level / 255) ** 2.2 + rng.normal(0, 1, (60, 80))
        cv2.imwrite(str(folder / f"grey_{level:03d}.png"), np.clip(np.rint(seen), 0, 255).astype(np.uint8))


def write_normals(folder: Path) -> None:
    """Write points on a paraboloid with their normals."""
    x, y = (axis.ravel() for axis in np.meshgrid(np.linspace(-0.5, 0.5, 12), np.linspace(-0.4, 0.4, 10)))
    normals = np.column_stack([-x / 4, -y / 4, np.ones_like(x)])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    rows = np.column_stack([x, y, (x**2 + y**2) / 8, normals])
    head = "x_m,y_m,z_m,normal_x,normal_y,normal_z"
    np.savetxt(folder / "points.csv", rows, fmt="%.9f", delimiter=",", header=head, comments="")


def write_nurbs(folder: Path) -> None:
    """Write two facets as ARTIST does: bilinear, z = x^2 / 10 in the middle of each knot interval."""
    degree, n = 3, 6
    knots = np.r_[np.zeros(degree), np.linspace(0, 1, n - degree + 1), np.ones(degree)]
    middles = np.stack([knots[k + 1 : k + 1 + n] for k in range(degree)]).mean(axis=0)
    x, y = np.meshgrid(middles - 0.5, middles - 0.5, indexing="ij")
    with h5py.File(folder / "surface.h5", "w") as file:
        for name, shift in (("facet_1", -0.6), ("facet_2", 0.6)):
            group = file.create_group(f"heliostats/A1/surface/facets/{name}")
            group["control_points"] = np.stack([x + shift, y, 0.1 * x**2], axis=-1)
            group["degrees"] = [degree, degree]


def write_given(folder: Path) -> None:
    """Write an entry of a heliostat's data sheet that was measured elsewhere."""
    (folder / "given.csv").write_text(
        "key,value,sigma,label,method,date,conditions\nmirror_area_m2,8.2,0.1,Area,tape,2026-03-04,indoors\n"
    )


#: What no command of ours writes.
WRITTEN: dict[str, Callable[[Path], None]] = {
    "opencsp": write_opencsp,
    "grey": write_grey,
    "normals": write_normals,
    "nurbs": write_nurbs,
}
