"""Results of a trough as its report reads them."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from heliogauge.reporting.results import Results, open_results
from heliogauge.results.arrays import read_arrays
from heliogauge.results.folder import PhotoPose, PointTable, read_cameras_json, read_points_csv, read_table_csv
from heliogauge.results.tables import read_columns_csv
from heliogauge.slopes.map import NODE_FIELDS, SlopeMap
from heliogauge.validate import BoolArray, FloatArray, IntArray
from observer.files import ANGLES, COLLECTOR, SLICES, StoredSlices, read_collector, read_slices
from observer.selection.edge_refusal import EdgeFate
from observer.trough.collector import Collector

Columns = dict[str, list[str]]


@dataclass(frozen=True, slots=True, eq=False)
class EdgeTable:
    """Edges of the reflection: one entry for each.

    photo (m,): Number of the photo among `TroughResults.photos`.
    x_m, y_m (m,): Where on the mirror [m].
    side (m,): Which edge of the tube, +1 or -1.
    sigma_x_m (m,): Standard deviation of the position [m].
    residual_rad (m,): What remains of the angle [rad].
    fate (m,): `EdgeFate.code` of each.
    used (m,): Those that the result rests on.
    """

    photo: IntArray
    x_m: FloatArray
    y_m: FloatArray
    side: FloatArray
    sigma_x_m: FloatArray
    residual_rad: FloatArray
    fate: npt.NDArray[np.str_]
    used: BoolArray


@dataclass(frozen=True, slots=True, eq=False)
class TroughResults:
    """What a folder of a trough's results holds.

    base: Summary and slope map.
    collector: The design.
    angles (ny, nx): ``theta_ra``, ``theta_r``, ``theta_a`` and their sigmas [rad].
    photos: Names of the photos.
    poses: Their poses, from targets and reflection together.
    poses_by_targets: Their poses from the targets alone.
    edges: Edges of the reflection.
    slices: Rows of the mirror in all photos.
    """

    base: Results
    collector: Collector
    angles: dict[str, npt.NDArray[np.float64]]
    photos: tuple[str, ...]
    poses: dict[str, PhotoPose]
    poses_by_targets: dict[str, PhotoPose]
    targets: PointTable
    edges: EdgeTable
    slices: StoredSlices

    @property
    def eyes_m(self) -> FloatArray:
        """Centres of the cameras, shape (k, 3) [m]."""
        return np.array([self.poses[name].cam_from_world.inverse().translation_m for name in self.photos])

    def table(self, name: str) -> Columns | None:
        """Return a table of the folder as text; None where there is none."""
        path = self.base.folder / name
        return read_table_csv(path) if path.is_file() else None


def open_trough(folder: str | Path = ".") -> TroughResults:
    """Read a folder of results.

    folder: The folder; the working directory without it.
    """
    folder = Path(folder)
    names = ("theta_ra", "theta_r", "theta_a", "sigma_theta_r", "sigma_theta_a", "sigma_theta_ra")
    angles, _ = read_arrays(folder / ANGLES, names)
    base = open_results(folder)
    rows, columns = _outline(base.slope_map.aperture)
    # Read already; a folder without the file is refused here.
    poses = base.poses or read_cameras_json(folder / "cameras.json")[1]
    _, by_targets = read_cameras_json(folder / "network" / "cameras.json")
    photos = tuple(poses)
    return TroughResults(
        base=replace(base, slope_map=_cut_out(base.slope_map, rows, columns)),
        collector=read_collector(folder / COLLECTOR),
        angles={name: angles[name][rows, columns].astype(np.float64) for name in names},
        photos=photos,
        poses=poses,
        poses_by_targets=by_targets,
        targets=read_points_csv(folder / "points.csv"),
        edges=_read_edges(folder / "reflection_edges.csv", photos),
        slices=read_slices(folder / SLICES),
    )


def _outline(aperture: BoolArray) -> tuple[slice, slice]:
    """Return the rows and columns that hold the mirror: of a single panel, they are few of the aperture's."""
    if not aperture.any():
        return slice(None), slice(None)
    along, across = np.flatnonzero(aperture.any(axis=1)), np.flatnonzero(aperture.any(axis=0))
    return slice(int(along[0]), int(along[-1]) + 1), slice(int(across[0]), int(across[-1]) + 1)


def _cut_out(slope_map: SlopeMap, rows: slice, columns: slice) -> SlopeMap:
    """Return some rows and columns of a map."""
    fields = {name: getattr(slope_map, name)[rows, columns] for name in NODE_FIELDS}
    return replace(slope_map, x_m=slope_map.x_m[columns], y_m=slope_map.y_m[rows], **fields)


def _read_edges(path: Path, photos: tuple[str, ...]) -> EdgeTable:
    wanted = ("x_m", "y_m", "side", "sigma_x_m", "residual_rad")
    texts, columns = read_columns_csv(path, ("image", "fate"), wanted)
    x, y, side, sigma, residual = (columns[name] for name in wanted)
    place = {name: number for number, name in enumerate(photos)}
    photo = np.array([place[name] for name in texts["image"]], dtype=np.intp)
    fate = np.array(texts["fate"], dtype=np.str_)
    return EdgeTable(photo, x, y, side, sigma, residual, fate, np.asarray(fate == EdgeFate.USED.code))


def numbers(columns: Columns, name: str) -> FloatArray:
    """Return a column as numbers.

    Returns (n,): Empty cells are NaN.
    """
    return np.array([float(cell) if cell else np.nan for cell in columns[name]], dtype=np.float64)
