"""Tables of a network's report: headline numbers, points, photos, lengths, camera, what was refused."""

from collections import Counter
from collections.abc import Mapping, Sequence

import numpy as np

from heliogauge.reporting.html import Html, table
from heliogauge.reporting.notation import number_text
from heliogauge.reporting.page import headline_numbers
from heliogauge.results.folder import Summary, unit_of
from heliogauge.validate import FloatArray
from heliogauge.view.tables import TableColumn, TableView
from photogrammetry.report.network import NetworkResults
from photogrammetry.report.scene import grouped

#: Rows of a table in a page; files hold them all.
MOST_ROWS = 1000

#: Numbers of the headline and what they are called there; the others are folded away.
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
    "relative_precision_ratio": "Relative precision",
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


def shown_number(summary: Summary, key: str) -> str:
    """Return a number of a summary with its sigma to the digits that make sense."""
    value, (name, unit) = summary.numbers[key], unit_of(key)
    if value is None:
        return "not determined"
    if key.endswith("precision_ratio"):
        return f"1 : {grouped(value)}"
    if key.endswith("_count"):
        return grouped(value)
    if key.endswith("_ratio") and f"sigma_{key}" not in summary.numbers:
        return _significant(value, 3)
    if "sigma" in name and unit == "m":
        # A sigma is known to two digits at best.
        scaled, unit = (1e6 * value, "\u00b5m") if value < 1e-5 else (1e3 * value, "mm")
        return f"{_significant(scaled, 2)} {unit}"
    sigma = summary.numbers.get(f"sigma_{key}")
    if sigma is None and "rms" in name and unit in ("m", "px"):
        # What so many residuals or lengths have in common is known to some per cent.
        scaled, unit = (1e3 * value, "mm") if unit == "m" else (value, unit)
        return f"{_significant(scaled, 3)} {unit}"
    return number_text(value, sigma, unit, name)


def _significant(value: float, digits: int) -> str:
    """Return a number with so many significant digits, zeros at its end included."""
    if value == 0 or not np.isfinite(value):
        return f"{value:g}"
    return f"{value:.{max(0, digits - 1 - int(np.floor(np.log10(abs(value)))))}f}"


def headline_rows(summary: Summary, labels: Mapping[str, str] = LABELS) -> list[tuple[str, str]]:
    """Return the headline numbers that were determined, in the order of the labels."""
    return [
        (label, shown_number(summary, key)) for key, label in labels.items() if summary.numbers.get(key) is not None
    ]


def number_table(summary: Summary) -> Html:
    """Return every number of the summary, with the reason where one was not determined."""
    rows = [
        (
            LABELS.get(key, unit_of(key)[0].replace("_", " ").replace("rms", "RMS")),
            shown_number(summary, key),
            summary.not_determined.get(key, ""),
        )
        for key in summary.numbers
        if not (key.startswith("sigma_") and key.removeprefix("sigma_") in summary.numbers)
    ]
    return headline_numbers(rows)


def text_table(summary: Summary) -> Html:
    """Return what belongs beside the numbers: datum, camera, meaning of sigma, quality in lengths."""
    return table(("", ""), [(name.replace("_", " "), text) for name, text in summary.texts.items()])


def number_column(name: str, values: FloatArray, digits: int, links: Sequence[str] | None = None) -> TableColumn:
    """Return a column of numbers with so many digits; empty where there is none."""
    texts = [f"{value:.{digits}f}" if np.isfinite(value) else "" for value in values]
    return TableColumn(name, texts, np.asarray(values, dtype=np.float64).tolist(), links)


def digits_for(sigmas: FloatArray) -> int:
    """Return how many digits numbers have whose standard deviations are these."""
    good = sigmas[np.isfinite(sigmas) & (sigmas > 0)]
    return int(np.clip(1 - np.floor(np.log10(np.median(good))), 0, 7)) if good.size else 4


def point_table(results: NetworkResults) -> TableView | None:
    """Return the points, the least certain first: places, sigmas, longest axis of the ellipsoid, rays, worst photo."""
    if not len(results.known):
        return None
    order = np.argsort(-results.sigma_mm, kind="stable")[:MOST_ROWS]
    chosen = results.known[order]
    points = results.points
    axes = 1e3 * np.sqrt(np.maximum(np.linalg.eigvalsh(results.covariance_m2[chosen])[:, 2], 0.0))
    sigma, places = 1e3 * points.sigma_m[chosen], 1e3 * points.xyz_m[chosen]
    digits = digits_for(sigma)
    names = [points.ids[i] for i in chosen]
    columns = [
        TableColumn("point", names),
        *(number_column(f"{axis} [mm]", places[:, i], digits) for i, axis in enumerate("xyz")),
        *(number_column(f"\u03c3 {axis} [mm]", sigma[:, i], digits) for i, axis in enumerate("xyz")),
        number_column("\u03c3 largest [mm]", axes, digits),
        TableColumn("rays", [str(n) for n in points.n_rays[chosen]], points.n_rays[chosen].astype(float).tolist()),
    ]
    worst = _worst_photos(results, names)
    if worst:
        photos = tuple(results.poses)
        found = [worst.get(name) for name in names]
        columns.append(
            TableColumn(
                "largest residual",
                ["" if one is None else f"{one[1]:.4f} px in {photos[one[0]]}" for one in found],
                [np.nan if one is None else one[1] for one in found],
                [_link(results, "" if one is None else photos[one[0]]) for one in found],
            )
        )
    rest = len(results.known) - len(order)
    more = f"; {grouped(rest)} more certain ones are in points.csv" if rest else ""
    return TableView(f"Points, the least certain first{more}", tuple(columns), most_rows=15)


def _worst_photos(results: NetworkResults, names: Sequence[str]) -> dict[str, tuple[int, float]]:
    """Return the photo with the largest residual of each of some targets."""
    used, wanted = results.used, set(names)
    sizes = np.linalg.norm(used.residuals_px, axis=1)
    found: dict[str, tuple[int, float]] = {}
    for row, name in enumerate(used.targets):
        if name in wanted and (name not in found or sizes[row] > found[name][1]):
            found[name] = int(used.photo[row]), float(sizes[row])
    return found


def _link(results: NetworkResults, photo: str) -> str:
    mark = results.photo_marks.get(photo)
    return f"#{mark}" if mark else ""


def photo_table(results: NetworkResults) -> TableView | None:
    """Return the photos, the largest residuals first, then those left out, with links to their pictures."""
    poses = sorted(results.poses.items(), key=lambda item: -(item[1].residual_rms_px or 0.0))
    names = [*(name for name, _ in poses), *results.photos_left_out]
    if not names:
        return None
    count = dict(zip(results.poses, results.counts.tolist(), strict=True))
    refused = Counter(results.tables["rejected"].get("image", ()))
    blank = np.full((len(results.photos_left_out), 3), np.nan)
    centers = [-one.cam_from_world.rotation.T @ one.cam_from_world.translation_m for _, one in poses]
    # The covariance is of steps in the camera's frame: its axes are the camera's.
    sigma = [1e3 * np.sqrt(np.maximum(np.diag(one.covariance), 0.0)) for _, one in poses]
    place, spread = (
        np.concatenate([np.reshape(rows, (-1, width)), blank[:, :1].repeat(width, 1)])
        for rows, width in ((centers, 3), (sigma, 6))
    )
    columns = (
        TableColumn("photo", names, links=[_link(results, name) for name in names]),
        number_column("image points", np.array([count.get(name, 0) for name in names], dtype=np.float64), 0),
        number_column("refused", np.array([refused.get(name, 0) for name in names], dtype=np.float64), 0),
        number_column(
            "RMS residual [px]",
            np.array([*(pose.residual_rms_px or 0.0 for _, pose in poses), *blank[:, 0]]),
            4,
        ),
        *(number_column(f"{axis} [m]", place[:, i], 3) for i, axis in enumerate("xyz")),
        number_column("sigma of place [mm]", np.linalg.norm(spread[:, 3:], axis=1), digits_for(spread[:, 3:])),
        number_column("sigma of rotation [mrad]", np.linalg.norm(spread[:, :3], axis=1), digits_for(spread[:, :3])),
    )
    return TableView("Photos, the largest residuals first", columns, most_rows=15)


def intrinsics_table(results: NetworkResults) -> Html | TableView:
    """Return the estimated intrinsics with sigma, significance and the strongest correlation."""
    columns = results.tables["intrinsics"]
    if not columns["name"]:
        return Html("<p>None was estimated.</p>")
    value, sigma, significance, correlation = (
        results.column("intrinsics", name) for name in ("value", "sigma", "significance", "correlation")
    )
    # Only what could be zero has a significance: aspect, skew, distortion.
    tested = np.isfinite(significance)
    ratio = np.where(tested, np.abs(value) / np.where(sigma > 0, sigma, np.nan), np.nan)
    rivals = [
        f"{size:+.3f} with {rival}" if rival else "" for size, rival in zip(correlation, columns["rival"], strict=True)
    ]
    shown = [number_text(v, s, "") for v, s in zip(value, sigma, strict=True)]
    return TableView(
        "Estimated intrinsics",
        (
            TableColumn("camera", columns["camera"]),
            TableColumn("intrinsic", columns["name"]),
            TableColumn("value \u00b1 1 sigma", shown, value.tolist()),
            number_column("value / sigma", ratio, 1),
            number_column("significance", significance, 4),
            TableColumn("strongest correlation", rivals, np.abs(correlation).tolist()),
        ),
    )


def length_table(results: NetworkResults) -> TableView | None:
    """Return known lengths against a network that did not use them [mm]; None where there are none."""
    columns = results.tables["lengths"]
    if not columns["name"]:
        return None
    keys = ("known_m", "sigma_known_m", "measured_m", "sigma_measured_m", "error_m", "sigma_error_m", "permissible_m")
    values = 1e3 * np.stack([results.column("lengths", key) for key in keys], axis=1)
    digits = digits_for(values[:, 5])
    heads = ("known [mm]", "sigma", "measured [mm]", "sigma", "error [mm]", "sigma")
    errors = TableColumn(heads[4], [f"{value:+.{digits}f}" for value in values[:, 4]], values[:, 4].tolist())
    numbers = [errors if i == 4 else number_column(head, values[:, i], digits) for i, head in enumerate(heads)]
    found = [
        TableColumn("length", columns["name"]),
        TableColumn("network", columns["role"]),
        TableColumn("line", columns["line"]),
        *numbers,
        number_column("error / sigma", np.abs(values[:, 4]) / values[:, 5], 1),
    ]
    if np.isfinite(values[:, 6]).any():
        found += [number_column("permissible", values[:, 6], digits), TableColumn("verdict", columns["verdict"])]
    return TableView("Known lengths that the network did not use", tuple(found), most_rows=10)


def constraint_table(results: NetworkResults) -> TableView | None:
    """Return all that was known beforehand beside what the network has; None where nothing was."""
    columns = results.tables["constraints"]
    if not columns["name"]:
        return None
    known, measured, error = (
        1e3 * results.column("constraints", name) for name in ("known_m", "measured_m", "error_m")
    )
    sigma = 1e3 * results.column("constraints", "sigma_known_m")
    sigma_measured = 1e3 * results.column("constraints", "sigma_measured_m")
    digits = digits_for(sigma_measured)
    return TableView(
        "Known lengths as adjusted",
        (
            TableColumn("length", columns["name"]),
            TableColumn("in the network", ["used" if one == "1" else "kept apart" for one in columns["used"]]),
            number_column("known [mm]", known, digits),
            number_column("sigma", sigma, digits),
            number_column("measured [mm]", measured, digits),
            number_column("sigma", sigma_measured, digits),
            TableColumn("error [mm]", [f"{value:+.{digits}f}" for value in error], error.tolist()),
        ),
        most_rows=20,
    )


def reason_table(results: NetworkResults) -> Html:
    """Return how much was left out for each reason."""
    rejected = results.tables["rejected"]
    # The reasons of outliers have numbers, which differ from line to line.
    reasons = Counter(
        "image point contradicts the others" if is_outlier == "1" else reason
        for reason, is_outlier in zip(rejected["reason"], rejected["is_outlier"], strict=True)
    )
    rows = [(reason, str(count)) for reason, count in reasons.most_common(30)]
    return table(("reason", "count"), rows, numbers=(1,)) if rows else Html("<p>Everything was used.</p>")


def refused_table(results: NetworkResults) -> TableView | None:
    """Return what was not used with the reason and a link to its photo; None where everything was used."""
    rejected = results.tables["rejected"]
    if not rejected["name"]:
        return None
    names, reasons = rejected["name"][:MOST_ROWS], rejected["reason"][:MOST_ROWS]
    photos = rejected.get("image", [""] * len(rejected["name"]))[:MOST_ROWS]
    photos = [photo or (name if name in results.photo_marks else "") for photo, name in zip(photos, names, strict=True)]
    rest = len(rejected["name"]) - len(names)
    more = f"; {grouped(rest)} more are in rejected.csv" if rest else ""
    return TableView(
        f"What was not used{more}",
        (
            TableColumn("what", names),
            TableColumn("why", reasons),
            TableColumn("photo", photos, links=[_link(results, photo) for photo in photos]),
        ),
        most_rows=15,
    )
