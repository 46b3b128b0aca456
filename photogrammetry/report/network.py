"""Results of a network as its report reads them, and the tables of the report."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from heliogauge.camera.model import Camera
from heliogauge.reporting.html import Html, join, table
from heliogauge.reporting.notation import number_text
from heliogauge.results.folder import (
    PhotoPose,
    PointTable,
    Summary,
    read_cameras_json,
    read_points_csv,
    read_summary,
    read_table_csv,
    unit_of,
)
from heliogauge.validate import FloatArray

_TABLES = ("residuals", "rejected", "constraints", "intrinsics", "lengths", "points_covariance")

#: Numbers of the headline table and what they are called there; the others are folded away.
LABELS: dict[str, str] = {
    "points_count": "Points",
    "photos_count": "Photos",
    "image_points_count": "Image points",
    "image_residual_rms_px": "RMS length of the image residuals",
    "sigma0_ratio": "Residuals over their stated sigma (sigma0)",
    "point_sigma_x_rms_m": "RMS sigma of the points in x",
    "point_sigma_y_rms_m": "RMS sigma of the points in y",
    "point_sigma_z_rms_m": "RMS sigma of the points in z",
    "extent_m": "Largest distance of two points",
    "relative_precision_ratio": "Relative precision, 1 in",
    "scale_bar_residual_rms_m": "RMS residual of the scale bars that were used",
    "length_error_rms_m": "RMS error of lengths kept apart",
    "length_error_left_out_rms_m": "RMS error of used lengths, each left out once",
    "rejected_image_points_count": "Image points rejected",
    "deviation_rms_m": "RMS deviation from the surface",
    "roughness_m": "of it the surface's own",
    "best_fit_focal_length_m": "Best-fit focal length",
    "best_fit_radius_m": "Best-fit radius",
    "sdx_rad": "SDx, RMS angle of the normal from the design's in x",
    "sdy_rad": "SDy, RMS angle of the normal from the design's in y",
    "measured_share": "Share of the surface measured",
    "canting_rms_x_rad": "RMS canting in x of the normal",
    "canting_rms_y_rad": "RMS canting in y of the normal",
    "moved_count": "Targets that moved since the other date",
}


@dataclass(frozen=True, slots=True, eq=False)
class NetworkResults:
    """What a folder of a network's results holds; ``tables`` by the name of the CSV file."""

    folder: Path
    summary: Summary
    points: PointTable
    cameras: dict[str, Camera]
    poses: dict[str, PhotoPose]
    tables: dict[str, dict[str, list[str]]]

    def column(self, file: str, name: str) -> FloatArray:
        """Return a column of numbers; empty cells are NaN."""
        return np.array([float(cell) if cell else np.nan for cell in self.tables[file][name]])

    @property
    def camera(self) -> Camera:
        """The first camera."""
        return next(iter(self.cameras.values()))

    @property
    def known(self) -> np.ndarray:
        """Places of the points that have coordinates."""
        return np.nonzero(np.isfinite(self.points.xyz_m).all(axis=1))[0]

    @property
    def covariances_m2(self) -> FloatArray:
        """Covariance of each point of `known`, shape (k, 3, 3) [m^2]."""
        place = {name: i for i, name in enumerate(self.tables["points_covariance"]["id"])}
        rows = [place[self.points.ids[i]] for i in self.known]
        result = np.empty((len(rows), 3, 3))
        for i, first in enumerate("xyz"):
            for j, second in enumerate("xyz"):
                name = "".join(sorted((first, second)))
                result[:, i, j] = self.column("points_covariance", f"{name}_m2")[rows]
        return result

    @property
    def photo_rows(self) -> dict[str, np.ndarray]:
        """Rows of residuals.csv of each photo."""
        images = np.array(self.tables["residuals"]["image"])
        return {name: np.nonzero(images == name)[0] for name in self.poses}


def open_network(folder: str | Path = ".", tables: Sequence[str] = _TABLES) -> NetworkResults:
    """Read a folder of results.

    folder: The folder; the working directory without it.
    tables: Names of the tables that are read.
    """
    folder = Path(folder)
    cameras, poses = read_cameras_json(folder / "cameras.json")
    return NetworkResults(
        folder=folder,
        summary=read_summary(folder / "summary.json"),
        points=read_points_csv(folder / "points.csv"),
        cameras=cameras,
        poses=poses,
        tables={name: read_table_csv(folder / f"{name}.csv") for name in tables},
    )


def headline_table(summary: Summary, labels: dict[str, str] = LABELS) -> Html:
    """Return the headline numbers, the less important ones folded away.

    labels: Keys that are shown, with their names.
    Returns: A table in the order of the labels, and one to unfold.
    """

    def shown(key: str) -> str:
        value, (name, unit) = summary.numbers[key], unit_of(key)
        if value is None:
            return f"not determined: {summary.not_determined.get(key, '')}"
        if key.endswith(("_count", "precision_ratio")):
            return f"{value:,.0f}".replace(",", "\u202f")
        return number_text(value, None, unit, name)

    headline = [(label, shown(key)) for key, label in labels.items() if key in summary.numbers]
    others = [
        (unit_of(key)[0].replace("_", " ").replace("rms", "RMS"), shown(key))
        for key in summary.numbers
        if key not in labels
    ]
    more = table(("", "value"), others, numbers=(1,))
    folded = f"<details><summary>{len(others)} more numbers</summary>{more.text}</details>" if others else ""
    return Html(f'<div class="headline">{table(("", "value"), headline, numbers=(1,)).text}</div>{folded}')


def text_table(summary: Summary) -> Html:
    """Return what belongs beside the numbers: datum, camera, meaning of sigma, quality in lengths."""
    return table(("", ""), [(name.replace("_", " "), text) for name, text in summary.texts.items()])


def point_table(results: NetworkResults) -> Html:
    """Return the points with their sigmas and the axes of their error ellipsoids, the least certain first."""
    points, chosen = results.points, results.known
    axes = np.sqrt(np.maximum(np.linalg.eigvalsh(results.covariances_m2), 0.0))
    order = np.argsort(-axes[:, 2], kind="stable")
    digits = _digits(float(np.median(1e3 * points.sigma_m[chosen])) if len(chosen) else 1.0)
    rows = []
    for place in order:
        i = chosen[place]
        sigma = 1e3 * points.sigma_m[i]
        rows.append(
            (
                points.ids[i],
                *(f"{1e3 * value:.{digits}f}" for value in points.xyz_m[i]),
                *(f"{value:.{digits}f}" for value in sigma),
                " / ".join(f"{1e3 * value:.{digits}f}" for value in axes[place][::-1]),
                f"{points.n_rays[i]}",
            )
        )
    unit = ("x [mm]", "y [mm]", "z [mm]", "sigma x [mm]", "sigma y [mm]", "sigma z [mm]", "ellipsoid axes [mm]", "rays")
    return folded_table(("point", *unit), rows, numbers=range(1, 9), what="points, least certain first")


def _digits(sigma: float) -> int:
    return 4 if not np.isfinite(sigma) or sigma <= 0 else int(np.clip(1 - np.floor(np.log10(sigma)), 0, 7))


def photo_table(results: NetworkResults) -> Html:
    """Return the photos, worst residual first: image points, residual, position, sigma of the pose."""
    rows = []
    poses = sorted(results.poses.items(), key=lambda item: -(item[1].residual_rms_px or 0.0))
    for name, pose in poses:
        sigma = np.sqrt(np.maximum(np.diag(pose.covariance), 0.0))
        cam_from_world = pose.cam_from_world
        center = -cam_from_world.rotation.T @ cam_from_world.translation_m
        # The covariance is of steps in the camera's frame: its axes are the camera's.
        spread = ", ".join(f"{1e3 * value:.3f}" for value in sigma[3:])
        turn = ", ".join(f"{1e3 * value:.4f}" for value in sigma[:3])
        place = ", ".join(f"{value:.3f}" for value in center)
        count = len(results.photo_rows[name])
        rows.append((name, str(count), f"{pose.residual_rms_px or 0.0:.4f}", place, spread, turn))
    head = (
        "photo",
        "image points",
        "RMS residual [px]",
        "position [m]",
        "sigma of translation, camera axes [mm]",
        "sigma of rotation [mrad]",
    )
    return folded_table(head, rows, numbers=(1, 2), what="photos, worst first")


def intrinsics_table(results: NetworkResults) -> Html:
    """Return the estimated intrinsics with sigma, significance and the strongest correlation."""
    columns = results.tables["intrinsics"]
    rows = []
    for camera, name, value, sigma, size, rival, correlation in zip(*columns.values(), strict=True):
        # Only what could be zero has a significance: aspect, skew, distortion.
        ratio, sure = (f"{abs(float(value)) / float(sigma):.1f}", f"{float(size):.4f}") if size else ("", "")
        other = f"{float(correlation):+.3f} with {rival}" if rival else ""
        rows.append((camera, name, f"{float(value):.8g}", f"{float(sigma):.2g}", ratio, sure, other))
    head = ("camera", "intrinsic", "value", "sigma", "value / sigma", "significance", "strongest correlation")
    return table(head, rows, numbers=(2, 3, 4, 5)) if rows else Html("<p>None was estimated.</p>")


def length_table(results: NetworkResults) -> Html:
    """Return known lengths against a network that did not use them [mm]."""
    columns = results.tables["lengths"]
    numbers = (
        "known_m",
        "sigma_known_m",
        "measured_m",
        "sigma_measured_m",
        "error_m",
        "sigma_error_m",
        "permissible_m",
    )
    values = np.stack([results.column("lengths", name) for name in numbers], axis=1) * 1e3
    sigma = values[:, 5]
    digits = _digits(float(np.median(sigma)) if len(sigma) else 1.0)
    rows = [
        (
            name,
            role,
            line,
            *(f"{value:.{digits}f}" for value in row[:4]),
            f"{row[4]:+.{digits}f}",
            f"{row[5]:.{digits}f}",
            f"{abs(row[4]) / row[5]:.1f}",
            *((f"{row[6]:.{digits}f}", verdict) if np.isfinite(row[6]) else ("", "")),
        )
        for name, role, line, row, verdict in zip(
            columns["name"], columns["role"], columns["line"], values, columns["verdict"], strict=True
        )
    ]
    head = (
        "length",
        "network",
        "line",
        "known [mm]",
        "sigma",
        "measured [mm]",
        "sigma",
        "error [mm]",
        "sigma",
        "error / sigma",
        "permissible",
        "verdict",
    )
    return folded_table(head, rows, numbers=range(2, 11), what="lengths") if rows else Html("<p>None.</p>")


def csv_table(results: NetworkResults, file: str, what: str) -> Html:
    """Return one of the result tables as it is in its file; a sentence where it is empty.

    file: "rejected", "constraints" or "lengths".
    """
    columns = {name: cells for name, cells in results.tables[file].items() if any(cells)}
    rows = [tuple(map(_short, row)) for row in zip(*columns.values(), strict=True)]
    return folded_table(tuple(columns), rows, numbers=(), what=what) if rows else Html("<p>None.</p>")


def folded_table(head: Sequence[str], rows: Sequence[Sequence[str]], *, numbers: Sequence[int], what: str) -> Html:
    """Return a table whose first lines are shown and the others unfold.

    head: Names of the columns.
    numbers: Columns that are aligned to the right.
    """
    first = 12
    shown = table(head, rows[:first], numbers=numbers)
    if len(rows) <= first:
        return shown
    rest = table(head, rows[first:], numbers=numbers)
    return join(
        shown, Html(f"<details><summary>{len(rows) - first} more of {len(rows)} {what}</summary>{rest.text}</details>")
    )


def reason_table(results: NetworkResults) -> Html:
    """Return how much was left out for each reason."""
    rejected = results.tables["rejected"]
    # The reasons of outliers have numbers, which differ from line to line.
    reasons = Counter(
        "image point contradicts the others" if is_outlier == "1" else reason
        for reason, is_outlier in zip(rejected["reason"], rejected["is_outlier"], strict=True)
    )
    rows = [(reason, str(count)) for reason, count in sorted(reasons.items(), key=lambda item: -item[1])]
    return table(("reason", "count"), rows, numbers=(1,)) if rows else Html("")


def _short(cell: str) -> str:
    """Return numbers to seven digits, text as it is."""
    try:
        return f"{float(cell):.7g}"
    except ValueError:
        return cell
