"""Sections of a network's report; each is one cell of the notebook and returns what it shows."""

from heliogauge.reporting import page
from heliogauge.reporting.html import Html, join, show
from photogrammetry.report import figures, network
from photogrammetry.report.network import NetworkResults
from photogrammetry.report.scene import network_scene


def head(results: NetworkResults) -> Html:
    """Return title and warnings."""
    line = f"{results.summary.kind}; {len(results.poses)} photos, {len(results.known)} points"
    return page.head(results, line)


def overview(results: NetworkResults) -> Html:
    """Return the headline numbers and what they refer to."""
    return join(network.headline_table(results.summary), network.text_table(results.summary))


def photos(results: NetworkResults) -> Html:
    """Return the network in space: turnable, and seen along two axes."""
    plans = show(figures.network_figure(results, 0, 1), figures.network_figure(results, 0, 2))
    return join(network_scene(results), plans)


def points(results: NetworkResults) -> Html:
    """Return the points with their uncertainty."""
    drawn = show(figures.sigma_figure(results), figures.ray_figure(results))
    return join(drawn, network.point_table(results))


def lengths(results: NetworkResults) -> Html:
    """Return known lengths against the network, and all that was known beforehand."""
    drawn = show(figures.length_figure(results))
    compared = network.length_table(results)
    used = network.csv_table(results, "constraints", "distances")
    return join(
        drawn,
        Html("<h3>Without the length itself</h3>"),
        compared,
        Html("<h3>As adjusted (used = 1) and kept apart (used = 0)</h3>"),
        used,
    )


def residuals(results: NetworkResults) -> Html:
    """Return the residuals in the images, every photo, and how they are distributed."""
    drawn = show(
        figures.residual_figure(results),
        figures.coverage_figure(results),
        figures.radius_figure(results),
        figures.histogram_figure(results),
    )
    return join(drawn, show(*figures.residual_sheets(results)), network.photo_table(results))


def camera(results: NetworkResults) -> Html:
    """Return the camera with significance and correlations."""
    return join(network.intrinsics_table(results), show(figures.correlation_figure(results)))


def refused(results: NetworkResults) -> Html:
    """Return what was not used, with reasons."""
    return join(network.reason_table(results), network.csv_table(results, "rejected", "items"))


def making(results: NetworkResults) -> Html:
    """Return times and input files."""
    return join(page.duration_table(results), page.input_table(results))
