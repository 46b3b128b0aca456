"""Figures and tables of a network's report, from the files of its results."""

import html
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from heliogauge.camera import Camera
from heliogauge.figures_canvas import FAINT, INK, LINE_X, LINE_Y, SEQUENTIAL, chart_figure
from heliogauge.report_html import Html, table
from heliogauge.store import (
    PhotoPose,
    PointTable,
    Summary,
    read_cameras_json,
    read_points_csv,
    read_summary,
    read_table_csv,
)
from heliogauge.validate import FloatArray

if TYPE_CHECKING:
    from matplotlib.figure import Figure

#: The RMS residual is drawn as this share of the image's diagonal.
_ARROW_SHARE = 0.02


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


def open_network(folder: str | Path = ".") -> NetworkResults:
    """Read a folder of results.

    Parameters
    ----------
    folder : str or Path, optional
        The folder; the working directory without it.

    Returns
    -------
    NetworkResults
        Its content.

    Raises
    ------
    InputError
        A file is missing or damaged.
    """
    folder = Path(folder)
    cameras, poses = read_cameras_json(folder / "cameras.json")
    names = ("residuals", "rejected", "constraints", "intrinsics")
    return NetworkResults(
        folder=folder,
        summary=read_summary(folder / "summary.json"),
        points=read_points_csv(folder / "points.csv"),
        cameras=cameras,
        poses=poses,
        tables={name: read_table_csv(folder / f"{name}.csv") for name in names},
    )


def title(results: NetworkResults) -> Html:
    """Return the head of the report: name, size of the network, version."""
    summary = results.summary
    line = (
        f"{summary.kind}; {len(results.poses)} photos, {len(results.points.ids)} points; heliogauge {summary.version}"
    )
    return Html(f'<h1>{html.escape(summary.name)}</h1><p class="subtitle">{html.escape(line)}</p>')


def network_figure(results: NetworkResults, first: int, second: int) -> "Figure":
    """Draw points and cameras seen along one axis.

    Parameters
    ----------
    results : NetworkResults
        The results.
    first, second : int
        Axes to the right and up: 0 x, 1 y, 2 z.

    Returns
    -------
    Figure
        The figure.
    """
    names = "xyz"
    note = f"{len(results.points.ids)} points, {len(results.poses)} photos; lines: where the cameras look"
    labels = f"{names[first]} [m]", f"{names[second]} [m]"
    figure, axes = chart_figure(f"Network in {names[first]} and {names[second]}", note, *labels)
    points = results.points.xyz_m
    poses = [pose.cam_from_world for pose in results.poses.values()]
    centers = np.array([-pose.rotation.T @ pose.translation_m for pose in poses])
    looks = np.array([pose.rotation[2] for pose in poses])
    reach = 0.15 * float(np.ptp(centers, axis=0).max(initial=0.1))
    for center, look in zip(centers, looks, strict=True):
        end = center + reach * look
        axes.plot([center[first], end[first]], [center[second], end[second]], color=FAINT, linewidth=0.7)
    axes.plot(centers[:, first], centers[:, second], "^", color=LINE_Y, markersize=4, linestyle="none")
    axes.plot(points[:, first], points[:, second], ".", color=LINE_X, markersize=3, linestyle="none")
    axes.set_aspect("equal", adjustable="datalim")
    return figure


def residual_figure(results: NetworkResults, photo: str | None = None) -> "Figure":
    """Draw the residuals of one photo, or of all, where they are in the image: also the coverage of the image.

    Parameters
    ----------
    results : NetworkResults
        The results.
    photo : str, optional
        The photo; all without it.

    Returns
    -------
    Figure
        The figure.
    """
    camera = next(iter(results.cameras.values()))
    chosen = np.array([photo in (None, name) for name in results.tables["residuals"]["image"]])
    x, y, dx, dy = (
        results.column("residuals", name)[chosen] for name in ("x_px", "y_px", "residual_x_px", "residual_y_px")
    )
    rms = float(np.sqrt((dx**2 + dy**2).mean()))
    scale = _ARROW_SHARE * float(np.hypot(camera.width_px, camera.height_px)) / max(rms, 1e-12)
    note = f"predicted minus measured, {scale:.0f} times enlarged; RMS {rms:.4f} px, {x.size} image points"
    figure, axes = chart_figure(f"Residuals, {photo or 'all photos'}", note, "x [px]", "y [px]")
    axes.quiver(x, y, scale * dx, scale * dy, angles="xy", scale_units="xy", scale=1, color=LINE_X, width=0.002)
    axes.plot(x, y, ".", color=INK, markersize=1, linestyle="none")
    axes.set_xlim(0, camera.width_px)
    axes.set_ylim(camera.height_px, 0)
    axes.set_aspect("equal")
    return figure


def sigma_figure(results: NetworkResults) -> "Figure":
    """Draw the standard deviation of each point where it is, seen along z.

    Parameters
    ----------
    results : NetworkResults
        The results.

    Returns
    -------
    Figure
        The figure.
    """
    points, sigma_mm = results.points.xyz_m, 1e3 * np.sqrt((results.points.sigma_m**2).sum(axis=1))
    figure, axes = chart_figure("Standard deviation of the points", "square root of the trace [mm]", "x [m]", "y [m]")
    dots = axes.scatter(points[:, 0], points[:, 1], c=sigma_mm, cmap=SEQUENTIAL, s=14)
    figure.colorbar(dots, ax=axes)
    axes.set_aspect("equal", adjustable="datalim")
    return figure


def text_table(results: NetworkResults) -> Html:
    """Return what must be said beside the numbers: datum, camera, meaning of sigma."""
    return table(("", ""), list(results.summary.texts.items()))


def photo_table(results: NetworkResults) -> Html:
    """Return a table of the photos: image points, residual, sigma of the pose."""
    images = results.tables["residuals"]["image"]
    rows = []
    for name, pose in results.poses.items():
        sigma = np.sqrt(np.diag(pose.covariance))
        spread = ", ".join(f"{1e3 * value:.3f}" for value in sigma[3:])
        turn = ", ".join(f"{1e3 * value:.4f}" for value in sigma[:3])
        rows.append((name, str(images.count(name)), f"{pose.residual_rms_px or 0.0:.4f}", spread, turn))
    head = ("photo", "image points", "RMS residual [px]", "sigma of translation [mm]", "sigma of rotation [mrad]")
    return table(head, rows, numbers=(1, 2))


def csv_table(results: NetworkResults, file: str, most: int = 200) -> Html:
    """Return one of the result tables; a sentence where it is empty.

    Parameters
    ----------
    results : NetworkResults
        The results.
    file : str
        "rejected", "constraints" or "intrinsics".
    most : int, optional
        Lines shown.

    Returns
    -------
    Html
        The table.
    """
    columns = results.tables[file]
    rows = list(zip(*columns.values(), strict=True))
    if not rows:
        return Html("<p>None.</p>")
    rest = f"<p>and {len(rows) - most} more in {file}.csv</p>" if len(rows) > most else ""
    shown = [tuple(_short(cell) for cell in row) for row in rows[:most]]
    return Html(table(tuple(columns), shown, numbers=()).text + rest)


def _short(cell: str) -> str:
    """Return numbers to seven digits, text as it is."""
    try:
        return f"{float(cell):.7g}"
    except ValueError:
        return cell
