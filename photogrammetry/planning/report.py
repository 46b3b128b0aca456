"""Sections of the report of a planned network; each is one cell of its notebook."""

from pathlib import Path

import numpy as np

from heliogauge.reporting import page
from heliogauge.reporting.canvas import FAINT, INK, LINE_X, LINE_Y, add_legend, chart_figure
from heliogauge.reporting.html import Html, join, show
from heliogauge.reporting.scene import SceneGroup, scene
from heliogauge.validate import FloatArray
from photogrammetry.report.network import NetworkResults, folded_table, headline_table, open_network, text_table
from photogrammetry.report.scene import ellipsoid_lines, grouped, hex_colors, magnification, pyramid_lines

#: Numbers of the headline table and what they are called there.
LABELS: dict[str, str] = {
    "photos_count": "Photos to take",
    "point_sigma_rms_m": "RMS sigma of all coordinates",
    "point_sigma_largest_m": "Largest sigma of a coordinate",
    "wanted_sigma_m": "Wanted",
    "point_sigma_x_rms_m": "RMS sigma in x",
    "point_sigma_y_rms_m": "RMS sigma in y",
    "point_sigma_z_rms_m": "RMS sigma in z",
    "sigma_with_known_cameras_rms_m": "RMS sigma if cameras and scale were known without error",
    "relative_precision_ratio": "Relative precision, 1 in",
    "q_ratio": "q of the planning rule",
    "distance_m": "Distance of the camera",
    "convergence_median_deg": "Largest angle between two rays, median of the targets",
    "least_rays_count": "Photos that see the target seen least",
    "image_coverage_share": "Share of the image with targets",
}


def open_plan(folder: str | Path = ".") -> NetworkResults:
    """Read a folder with a plan.

    folder: The folder; the working directory without it.
    """
    return open_network(folder, ("stations", "trials", "points_covariance"))


def head(results: NetworkResults) -> Html:
    """Return title and warnings."""
    return page.head(results, "plan of a photogrammetric measurement")


def overview(results: NetworkResults) -> Html:
    """Return the answer and its numbers."""
    return join(text_table(results.summary), headline_table(results.summary, LABELS))


def network(results: NetworkResults) -> Html:
    """Return the planned network in space."""
    points, covariances = results.points.xyz_m, results.covariances_m2
    known = np.asarray(np.isfinite(covariances).all(axis=(1, 2)))
    extent = float(np.linalg.norm(np.ptp(points, axis=0)))
    sigma_mm = 1e3 * np.sqrt(np.einsum("nii->n", covariances[known]))
    factor = magnification(covariances[known], extent)
    vertices, counts = ellipsoid_lines(points[known], covariances[known], factor)
    names = [name for name, fine in zip(results.points.ids, known, strict=True) if fine]
    rays = results.points.n_rays[known]
    labels = [f"{n}: sigma {s:.3g} mm, {r} rays" for n, s, r in zip(names, sigma_mm, rays, strict=True)]
    pyramids = [pyramid_lines(results.camera, pose.cam_from_world, 0.06 * extent) for pose in results.poses.values()]
    centers = np.array(
        [-one.cam_from_world.rotation.T @ one.cam_from_world.translation_m for one in results.poses.values()]
    )
    roll = results.column("stations", "roll_deg")
    stations = [f"{name}: turned by {turn:.0f} deg" for name, turn in zip(results.poses, roll, strict=True)]
    groups = [
        SceneGroup("targets", points[known], hex_colors(sigma_mm), labels=labels, size_px=6),
        SceneGroup(
            f"error ellipsoids (1 sigma, {grouped(factor)} times)", vertices, [LINE_Y], lengths=counts, size_px=0.7
        ),
        SceneGroup(
            "cameras",
            np.concatenate([lines for lines, _ in pyramids]),
            [FAINT],
            lengths=[n for _, lengths in pyramids for n in lengths],
            size_px=1.0,
        ),
        SceneGroup("projection centres", centers, [INK], labels=stations, size_px=5),
    ]
    note = (
        f"Targets coloured from {sigma_mm.min():.3g} mm (dark) to {sigma_mm.max():.3g} mm (yellow). A camera's roof is "
        "over the top edge of its image; it shows which cameras are turned."
    )
    return scene(groups, name="plan", note=note)


def search(results: NetworkResults) -> Html:
    """Return sigma against the number of photos for every layout that was tried."""
    figure, axes = chart_figure(
        "Sigma against the number of photos",
        "of all layouts that were tried",
        "photos",
        "RMS sigma of all coordinates [mm]",
        height_in=4.4,
    )
    layouts = np.array(results.tables["trials"]["layout"])
    count, sigma = results.column("trials", "photos_count"), 1e3 * results.column("trials", "sigma_rms_m")
    colors = (
        "#1b6ca8",
        "#c8552b",
        "#2f8f5b",
        "#8a4fa3",
        "#b8860b",
        "#66717d",
        "#d14d8b",
        "#3aa6a6",
        "#000000",
        "#999900",
    )
    for place, layout in enumerate(dict.fromkeys(layouts.tolist())):
        own = np.nonzero((layouts == layout) & np.isfinite(sigma))[0]
        own = own[np.argsort(count[own], kind="stable")]
        axes.plot(
            count[own], sigma[own], ".-", color=colors[place % len(colors)], linewidth=1, markersize=5, label=layout
        )
    chosen = np.nonzero(results.column("trials", "chosen") == 1)[0]
    axes.plot(count[chosen], sigma[chosen], "o", markersize=10, markerfacecolor="none", color=INK, label="chosen")
    wanted = results.summary.numbers["wanted_sigma_m"]
    axes.axhline(1e3 * float(wanted or 0.0), color=INK, linestyle="--", linewidth=0.9, label="wanted")
    axes.set_xscale("log")
    axes.set_yscale("log")
    _plain_ticks(axes, count, sigma)
    add_legend(axes, loc="upper right")
    columns = results.tables["trials"]
    rows = [
        (
            name,
            n,
            "-" if not rms else f"{1e3 * float(rms):.4f}",
            "-" if not largest else f"{1e3 * float(largest):.4f}",
            rays,
            why,
        )
        for name, n, rms, largest, rays, _, why in zip(*columns.values(), strict=True)
    ]
    head_line = ("layout", "photos", "RMS sigma [mm]", "largest sigma [mm]", "least rays", "why not")
    return join(show(figure), folded_table(head_line, rows, numbers=(1, 2, 3, 4), what="networks"))


def _plain_ticks(axes: object, count: FloatArray, sigma: FloatArray) -> None:
    """Label logarithmic axes with plain numbers."""
    from matplotlib.axes import Axes
    from matplotlib.ticker import FixedLocator, NullFormatter, NullLocator, ScalarFormatter

    if not isinstance(axes, Axes):
        return
    steps = np.array([1, 1.5, 2, 3, 4, 5, 7])
    for axis, values in ((axes.xaxis, count), (axes.yaxis, sigma)):
        good = values[np.isfinite(values) & (values > 0)]
        ticks = (steps[:, None] * 10.0 ** np.arange(-6, 6)).ravel()
        axis.set_major_locator(FixedLocator(sorted(t for t in ticks if 0.7 * good.min() <= t <= 1.4 * good.max())))
        axis.set_major_formatter(ScalarFormatter())
        axis.set_minor_locator(NullLocator())
        axis.set_minor_formatter(NullFormatter())


def sigmas(results: NetworkResults) -> Html:
    """Return the expected sigma of each target."""
    from matplotlib.ticker import MaxNLocator

    sigma_mm = 1e3 * np.sqrt((results.points.sigma_m**2).mean(axis=1))
    figure, axes = chart_figure(
        "Expected sigma and number of rays",
        "RMS of the three coordinates; one dot for each target",
        "photos that see the target",
        "sigma [mm]",
    )
    axes.plot(results.points.n_rays, sigma_mm, ".", color=LINE_X, markersize=5, alpha=0.6, linestyle="none")
    axes.set_ylim(bottom=0)
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    order = np.argsort(-np.nan_to_num(sigma_mm, nan=np.inf), kind="stable")
    rows = [
        (
            results.points.ids[i],
            *(f"{value:.3f}" for value in results.points.xyz_m[i]),
            *(f"{1e3 * value:.4f}" for value in results.points.sigma_m[i]),
            str(results.points.n_rays[i]),
        )
        for i in order
    ]
    head_line = ("target", "x [m]", "y [m]", "z [m]", "sigma x [mm]", "sigma y [mm]", "sigma z [mm]", "rays")
    return join(show(figure), folded_table(head_line, rows, numbers=range(1, 8), what="targets, least certain first"))


def stations(results: NetworkResults) -> Html:
    """Return where to take the photos."""
    columns = results.tables["stations"]
    rows = []
    for row in zip(*columns.values(), strict=True):
        name, *numbers, seen = row
        values = [float(cell) for cell in numbers]
        place, look, (roll, ring, azimuth) = values[:3], values[3:6], values[6:]
        rows.append(
            (
                name,
                *(f"{v:.2f}" for v in place),
                ", ".join(f"{v:+.3f}" for v in look),
                f"{roll:.0f}",
                f"{ring:.0f}",
                f"{azimuth:.0f}",
                seen,
            )
        )
    head_line = (
        "photo",
        "x [m]",
        "y [m]",
        "z [m]",
        "looks along",
        "turned [deg]",
        "ring [deg]",
        "azimuth [deg]",
        "targets",
    )
    return folded_table(head_line, rows, numbers=(1, 2, 3, 5, 6, 7, 8), what="photos")


def making(results: NetworkResults) -> Html:
    """Return times and input files."""
    return join(page.duration_table(results), page.input_table(results))
