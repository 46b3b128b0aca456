"""Results of a network as its report reads them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from heliogauge.camera.model import Camera
from heliogauge.results.folder import (
    PhotoPose,
    PointTable,
    Summary,
    read_cameras_json,
    read_columns_csv,
    read_points_csv,
    read_summary,
    read_table_csv,
)
from heliogauge.results.thumbnails import MOST_THUMBNAILS, thumbnail_names
from heliogauge.validate import FloatArray, IntArray

#: Small tables of a network, read as text.
_TABLES = ("rejected", "constraints", "intrinsics", "lengths")
_PAIRS = {"xx": (0, 0), "yy": (1, 1), "zz": (2, 2), "xy": (0, 1), "xz": (0, 2), "yz": (1, 2)}


@dataclass(frozen=True, slots=True, eq=False)
class UsedImagePoints:
    """Image points that were used, with their residuals, as ``residuals.csv`` holds them.

    photo (n,): Place of each one's photo among the poses of the network.
    targets length n: Names of their targets.
    pixels_px (n, 2): Places [px].
    sigma_px (n, 2): Standard deviations [px].
    residuals_px (n, 2): Predicted minus measured [px].
    redundancy (n, 2): Share of an error that shows in the residual.
    """

    photo: IntArray
    targets: Sequence[str]
    pixels_px: FloatArray
    sigma_px: FloatArray
    residuals_px: FloatArray
    redundancy: FloatArray


@dataclass(frozen=True, eq=False)
class NetworkResults:
    """What a folder of a network's results holds.

    covariance_m2 (n, 3, 3): Covariance of each point [m^2]; NaN where it has no coordinates.
    used: Image points; none for a plan.
    tables: Small tables by the name of their file.
    """

    folder: Path
    summary: Summary
    points: PointTable
    covariance_m2: FloatArray
    cameras: Mapping[str, Camera]
    poses: Mapping[str, PhotoPose]
    used: UsedImagePoints
    tables: Mapping[str, Mapping[str, list[str]]]

    def column(self, file: str, name: str) -> FloatArray:
        """Return a column of numbers of a small table; empty cells are NaN."""
        return np.array([float(cell) if cell else np.nan for cell in self.tables[file][name]])

    @property
    def camera(self) -> Camera:
        """The first camera."""
        return next(iter(self.cameras.values()))

    @cached_property
    def known(self) -> IntArray:
        """Places of the points that have coordinates and a covariance."""
        good = np.isfinite(self.points.xyz_m).all(axis=1) & np.isfinite(self.covariance_m2).all(axis=(1, 2))
        return np.nonzero(good)[0]

    @cached_property
    def sigma_mm(self) -> FloatArray:
        """Square root of the trace of each known point's covariance, shape (k,) [mm]."""
        return np.asarray(1e3 * np.sqrt(np.maximum(np.einsum("nii->n", self.covariance_m2[self.known]), 0.0)))

    @cached_property
    def extent_m(self) -> float:
        """Diagonal of the box around the known points [m]."""
        points = self.points.xyz_m[self.known]
        return float(np.linalg.norm(np.ptp(points, axis=0))) if len(points) > 1 else 1.0

    @cached_property
    def counts(self) -> IntArray:
        """Image points used in each photo of the network."""
        return np.bincount(self.used.photo, minlength=len(self.poses))

    @cached_property
    def photos_left_out(self) -> tuple[str, ...]:
        """Photos in which something was looked for and that are not in the network."""
        seen = [*self.tables["rejected"].get("image", ()), *thumbnail_names(self.folder)]
        return tuple(name for name in dict.fromkeys(seen) if name and name not in self.poses)

    @cached_property
    def shown_photos(self) -> tuple[str, ...]:
        """Photos that the report shows: the largest residuals first, then those left out."""
        rms = {name: pose.residual_rms_px or 0.0 for name, pose in self.poses.items()}
        left_out = self.photos_left_out[: MOST_THUMBNAILS // 3]
        worst = sorted(rms, key=lambda name: -rms[name])[: MOST_THUMBNAILS - len(left_out)]
        return (*worst, *left_out)

    @cached_property
    def photo_marks(self) -> dict[str, str]:
        """Place in the page of each photo that is shown."""
        return {name: f"photo-{number}" for number, name in enumerate(self.shown_photos, start=1)}


def open_network(folder: str | Path = ".") -> NetworkResults:
    """Read a folder of results.

    folder: The folder; the working directory without it.
    """
    return _read(Path(folder), _TABLES)


def open_planned(folder: str | Path = ".") -> NetworkResults:
    """Read a folder with a plan: without image points.

    folder: The folder; the working directory without it.
    """
    return _read(Path(folder), ("stations", "trials"))


def _read(folder: Path, tables: Sequence[str]) -> NetworkResults:
    summary = read_summary(folder / "summary.json")
    cameras, poses = read_cameras_json(folder / "cameras.json")
    points = read_points_csv(folder / "points.csv")
    measured = "rejected" in tables
    return NetworkResults(
        folder=folder,
        summary=summary,
        points=points,
        covariance_m2=_read_covariances(folder / "points_covariance.csv", points),
        cameras=cameras,
        poses=poses,
        used=_read_used(folder / "residuals.csv", tuple(poses)) if measured else _no_image_points(),
        tables={name: read_table_csv(folder / f"{name}.csv", _NEEDED.get(name, ())) for name in tables},
    )


#: Columns without which nothing can be said.
_NEEDED = {"rejected": ("name", "reason", "is_outlier")}


def _read_covariances(path: Path, points: PointTable) -> FloatArray:
    texts, numbers = read_columns_csv(path, ("id",), tuple(f"{pair}_m2" for pair in _PAIRS))
    place = {name: row for row, name in enumerate(texts["id"])}
    rows = np.array([place.get(name, -1) for name in points.ids], dtype=np.intp)
    result = np.full((len(points.ids), 3, 3), np.nan)
    for pair, (i, j) in _PAIRS.items():
        values = np.append(numbers[f"{pair}_m2"], np.nan)[rows]
        result[:, i, j] = result[:, j, i] = values
    return result


def _read_used(path: Path, photos: Sequence[str]) -> UsedImagePoints:
    pairs = ("{}_px", "sigma_{}_px", "residual_{}_px", "redundancy_{}")
    names = [[pair.format(axis) for axis in "xy"] for pair in pairs]
    texts, numbers = read_columns_csv(path, ("image", "target"), [one for pair in names for one in pair])
    place = {name: number for number, name in enumerate(photos)}
    photo = np.array([place.get(name, -1) for name in texts["image"]], dtype=np.intp)
    own = np.nonzero(photo >= 0)[0]
    pixels, sigma, residuals, redundancy = (np.stack([numbers[x], numbers[y]], axis=1)[own] for x, y in names)
    return UsedImagePoints(photo[own], [texts["target"][i] for i in own], pixels, sigma, residuals, redundancy)


def _no_image_points() -> UsedImagePoints:
    none = np.zeros((0, 2))
    return UsedImagePoints(np.zeros(0, dtype=np.intp), (), none, none, none, none)
