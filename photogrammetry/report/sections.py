"""Sections of a network's report; each is one cell of the notebook and returns what it shows."""

from heliogauge.reporting import page
from heliogauge.reporting.html import Html, Shown, beside, join, table_under_name
from heliogauge.reporting.verdict import Verdict, unmeasured, verdict_of
from heliogauge.view.scenes import SceneView
from photogrammetry.report import charts, tables
from photogrammetry.report.network import NetworkResults
from photogrammetry.report.photos import photo_view
from photogrammetry.report.scene import grouped, network_view

#: Numbers of the first screen; the section of numbers has them all.
_FIRST: dict[str, str] = {
    "sdx_rad": "SDx of the surface's normal",
    "sdy_rad": "SDy of the surface's normal",
    "deviation_rms_m": "RMS deviation from the surface",
    "point_sigma_x_rms_m": "RMS sigma of the points in x",
    "point_sigma_y_rms_m": "RMS sigma of the points in y",
    "point_sigma_z_rms_m": "RMS sigma of the points in z",
    "relative_precision_ratio": "Relative precision",
    "length_error_rms_m": "RMS error of lengths kept apart",
    "length_error_left_out_rms_m": "RMS error of lengths, each left out",
    "image_residual_rms_px": "RMS image residual",
    "moved_count": "Targets that moved since the other date",
}
#: Known lengths that chance leaves within so many sigmas agree.
_AGREES = 3.0


def first_screen(results: NetworkResults) -> Html:
    """Return name, verdict, headline numbers and the network in space."""
    summary = results.summary
    counts = [grouped(summary.numbers.get(f"{name}_count") or 0) for name in ("photos", "points", "image_points")]
    line = (
        f"photogrammetry; {counts[0]} photos, {counts[1]} points, {counts[2]} image points; "
        f"heliogauge {summary.version}"
    )
    return page.first_screen(
        summary.name, line, verdict(results), tables.headline_rows(summary, _FIRST), _scene(results)
    )


def _scene(results: NetworkResults) -> SceneView | None:
    if not len(results.known):
        return None
    notes = [
        f"{name}: {count} image points, RMS {pose.residual_rms_px or 0.0:.3f} px"
        for (name, pose), count in zip(results.poses.items(), results.counts, strict=True)
    ]
    return network_view(results, notes)


def verdict(results: NetworkResults) -> Verdict:
    """Return what was checked and found right, what is doubtful, and what is missing."""
    return verdict_of(results.summary, _missing(results), _passed(results))


def _missing(results: NetworkResults) -> list[str]:
    summary, missing = results.summary, list[str]()
    photos = int(summary.numbers.get("left_out_photos_count") or 0)
    if photos:
        missing.append(f"{photos} of {photos + len(results.poses)} photos left out")
    points = len(results.points.ids) - len(results.known)
    if points:
        missing.append(f"{points} of {len(results.points.ids)} targets without coordinates")
    share = summary.numbers.get("measured_share")
    return [*missing, *(() if share is None else unmeasured(share, "the surface"))]


def _passed(results: NetworkResults) -> list[str]:
    """Say what was checked without a finding."""
    summary, codes = results.summary, {one.code for one in results.summary.doubts}
    passed = []
    sigma0 = summary.numbers.get("sigma0_ratio")
    if sigma0 is not None and "residuals_contradict_stated_sigmas" not in codes:
        passed.append(f"residuals are as large as their sigmas say (sigma0 {sigma0:.2f})")
    for key, words in (("length_error", "kept apart"), ("length_error_left_out", "left out one by one")):
        ratio = summary.numbers.get(f"{key}_sigma_ratio")
        if ratio is not None and ratio <= _AGREES:
            passed.append(f"known lengths, {words}, agree within {ratio:.1f} sigma")
    least = int(results.points.n_rays[results.known].min()) if len(results.known) else 0
    if least > 2:
        passed.append(f"every point is seen in at least {least} photos")
    return passed


def numbers(results: NetworkResults) -> Html:
    """Return all numbers, folded, and what they refer to."""
    every = tables.number_table(results.summary).text
    folded = f"<details><summary>All {len(results.summary.numbers)} numbers</summary>{every}</details>"
    return join(tables.text_table(results.summary), Html(folded))


def photos(results: NetworkResults) -> Shown:
    """Return the photos with what was found in them."""
    return photo_view(results) or Html("<p>No photo is in the results.</p>")


def photo_table(results: NetworkResults) -> Shown:
    """Return a line for each photo."""
    listed = tables.photo_table(results)
    return Html("") if listed is None else table_under_name(listed)


def points(results: NetworkResults) -> Shown:
    """Return the points with their uncertainty."""
    listed = tables.point_table(results)
    if listed is None:
        return Html("<p>No point has coordinates.</p>")
    return join(charts.ray_chart(results), table_under_name(listed))


def lengths(results: NetworkResults) -> Shown:
    """Return known lengths against a network that did not use them."""
    compared = [charts.length_chart(results), tables.length_table(results)]
    pieces: list[Shown] = [one for one in compared if one is not None]
    return (
        join(*pieces) if pieces else Html("<p>No length was known: nothing but the residuals checks this network.</p>")
    )


def constraints(results: NetworkResults) -> Shown:
    """Return all that was known beforehand beside what the network has."""
    used = tables.constraint_table(results)
    return Html("") if used is None else table_under_name(used)


def residuals(results: NetworkResults) -> Shown:
    """Return the residuals over the image, along its radius, and over their sigmas."""
    if not len(results.used.photo):
        return Html("<p>No image point was used.</p>")
    return join(charts.residual_map(results), beside(charts.radius_chart(results), charts.histogram_chart(results)))


def camera(results: NetworkResults) -> Shown:
    """Return the camera with significance and correlations."""
    return join(tables.intrinsics_table(results), charts.correlations(results))


def refused(results: NetworkResults) -> Shown:
    """Return what was not used, with reasons."""
    listed = tables.refused_table(results)
    return join(tables.reason_table(results), *([] if listed is None else [table_under_name(listed)]))


def making(results: NetworkResults) -> Html:
    """Return times and input files."""
    return join(page.duration_table(results), page.input_table(results))
