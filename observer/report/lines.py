"""Profiles of the absorber, intercept factor and residuals in a trough's report."""

from typing import TYPE_CHECKING, Protocol

import numpy as np

from heliogauge.reporting.canvas import FAINT, INK, LINE_X, LINE_Y, add_legend, chart_figure
from heliogauge.reporting.html import Html, join, show, table
from heliogauge.reporting.notation import number_text
from heliogauge.validate import FloatArray
from observer.report.results import Columns, TroughResults, numbers
from observer.selection.edge_refusal import FATE_TEXTS, EdgeFate
from observer.trough.collector import Collector
from observer.trough.observation_equation import Sights, change_across, misfit

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_MM, _MRAD = 1e3, 1e3
_HEIGHT_IN = 3.6


class HasAbsorber(Protocol):
    """Results that say where an absorber runs."""

    @property
    def collector(self) -> Collector:
        """The design."""
        ...

    def table(self, name: str) -> Columns | None:
        """Return a table as text; None where there is none."""
        ...


def absorber(results: HasAbsorber) -> Html:
    """Return where the absorber runs."""
    note = "Bands: 1 sigma. Shaded: receiver supports. Crosses: stations without a value; absorber.csv says why."
    drawn = show(absorber_figure(results, "x"), absorber_figure(results, "z"), caption=note)
    return join(drawn, listed(results.table("absorber_spans.csv")))


def absorber_figure(results: HasAbsorber, axis: str) -> "Figure":
    """Draw the absorber's departure from the focal line.

    axis: "x" or "z".
    """
    columns = results.table("absorber.csv") or {}
    y, value, sigma = (numbers(columns, name) for name in ("y_m", f"{axis}_a_m", f"sigma_{axis}_a_m"))
    focal = results.collector.focal_length_m
    departure = value - (focal if axis == "z" else 0.0)
    words = {
        "x": "X_a: across the trough, from the plane of symmetry",
        "z": "Z_a: from the focal line, + away from the mirror",
    }
    seen = np.isfinite(departure)
    mean = float(np.nanmean(departure)) if seen.any() else float("nan")
    figure, axes = chart_figure(
        words[axis],
        f"mean {_MM * mean:+.2f} mm, range {_MM * float(np.ptp(departure[seen])):.2f} mm" if seen.any() else "not seen",
        "y along the trough [m]",
        f"{axis} [mm]",
        _HEIGHT_IN,
    )
    color = LINE_X if axis == "x" else LINE_Y
    for support in results.collector.support_y_m:
        half = results.collector.support_width_m / 2
        axes.axvspan(support - half, support + half, color=FAINT, alpha=0.15, linewidth=0)
    axes.fill_between(y, _MM * (departure - sigma), _MM * (departure + sigma), color=color, alpha=0.25, linewidth=0)
    axes.plot(y, _MM * departure, color=color, linewidth=1.2, marker=".", markersize=4)
    axes.axhline(0, color=FAINT, linewidth=0.7)
    axes.plot(y[~seen], np.zeros(int((~seen).sum())), "x", color=INK, markersize=4, linestyle="none")
    half = results.collector.length_m / 2
    axes.set_xlim(-half, half)
    return figure


def intercept(results: TroughResults) -> Html:
    """Return the intercept factor with its heading; nothing where it was not computed."""
    drawn = [figure for figure in (intercept_figure(results), spread_figure(results)) if figure is not None]
    if not drawn:
        return Html("")
    note = (
        "Share of the reflected light that meets the absorber, under the sun and errors named in the result. The "
        "curves of a perfect mirror or an aligned absorber say what either would gain; the top of each is the best "
        "tracking."
    )
    return join(Html("<h2>Intercept factor</h2>"), show(*drawn, caption=note))


def intercept_figure(results: TroughResults) -> "Figure | None":
    """Draw the intercept factor against the tracking offset.

    Returns: None where it was not computed.
    """
    columns = results.table("intercept.csv")
    if columns is None:
        return None
    offset, ratio, sigma = (
        numbers(columns, name) for name in ("tracking_offset_rad", "intercept_ratio", "sigma_intercept_ratio")
    )
    at_zero, own = float(np.interp(0, offset, ratio)), float(np.interp(0, offset, sigma))
    figure, axes = chart_figure(
        "Intercept factor",
        f"without tracking offset {at_zero:.4f} \u00b1 {own:.4f}",
        "tracking offset [mrad]",
        "intercept factor",
        _HEIGHT_IN,
    )
    axes.fill_between(_MRAD * offset, ratio - sigma, ratio + sigma, color=LINE_X, alpha=0.25, linewidth=0)
    axes.plot(_MRAD * offset, ratio, color=LINE_X, linewidth=1.3, label="as measured")
    others = (
        ("intercept_absorber_aligned_ratio", LINE_Y, "--", "absorber aligned"),
        ("intercept_mirror_perfect_ratio", FAINT, ":", "mirror perfect"),
    )
    for name, color, style, label in others:
        if name in columns:
            axes.plot(_MRAD * offset, numbers(columns, name), color=color, linestyle=style, linewidth=1.2, label=label)
    axes.axvline(0, color=FAINT, linewidth=0.6)
    axes.set_xlim(_MRAD * offset[0], _MRAD * offset[-1])
    add_legend(axes, loc="lower center")
    return figure


def spread_figure(results: TroughResults) -> "Figure | None":
    """Draw how the light is spread, and what the absorber accepts.

    Returns: None where it was not computed.
    """
    columns = results.table("beam_spread.csv")
    if columns is None:
        return None
    angle, error, beam, accepted = (
        numbers(columns, name)
        for name in ("angle_rad", "error_density_per_rad", "beam_density_per_rad", "acceptance_ratio")
    )
    figure, axes = chart_figure(
        "Spread of the reflected light",
        "errors of mirror and absorber; with sun, specularity and tracking",
        "angle of the reflected ray across the trough [mrad]",
        "density [1/mrad]",
        _HEIGHT_IN,
    )
    axes.fill_between(_MRAD * angle, error / _MRAD, color=FAINT, alpha=0.35, linewidth=0, label="errors alone")
    axes.plot(_MRAD * angle, beam / _MRAD, color=LINE_X, linewidth=1.3, label="with the sun")
    axes.set_ylim(bottom=0)
    # Room for the second scale.
    left, bottom, width, height = axes.get_position().bounds
    axes.set_position((left, bottom, width - 0.09, height))
    other = axes.twinx()
    for side in ("top", "right", "left", "bottom"):
        other.spines[side].set_visible(False)
    other.plot(_MRAD * angle, accepted, color=LINE_Y, linewidth=1.2, linestyle="--", label="accepted share")
    other.set_ylim(0, 1.05)
    other.set_ylabel("accepted share", fontsize=8.5, color=LINE_Y)
    other.tick_params(labelsize=8, colors=LINE_Y, length=3, width=0.6)
    lit = np.nonzero(beam > 1e-4 * beam.max())[0]
    half_window = float(np.abs(angle[accepted > 0.5]).max(initial=0.0))
    reach = _MRAD * max(float(np.abs(angle[lit[[0, -1]]]).max()), 2 * half_window)
    axes.set_xlim(-reach, reach)
    lines = [part for one in (axes, other) for part in one.get_legend_handles_labels()[0]]
    add_legend(axes, loc="upper left", handles=lines)
    return figure


def panels(results: TroughResults) -> Html:
    """Return the table of the panels with its heading; nothing where there is none."""
    columns = results.table("panels.csv")
    if columns is None:
        return Html("")
    # Short headings, and nothing where all cells are empty: the table must not be wider than the page.
    shown = {name.replace("mean_", "").replace("centre_", ""): cells for name, cells in columns.items() if any(cells)}
    return join(Html("<h2>Panels</h2><p>Means of the angles; the middle of each panel.</p>"), listed(shown))


def listed(columns: Columns | None) -> Html:
    """Return a table of results with units that are easy to read; nothing without one.

    columns: A table as it was read. A column ``sigma_NAME`` is joined to the column ``NAME``.
    """
    if not columns:
        return Html("")
    names = [name for name in columns if name.removeprefix("sigma_") not in columns or not name.startswith("sigma_")]
    count = len(columns[names[0]])
    shown, rows = [], [[""] * len(names) for _ in range(count)]
    for place, name in enumerate(names):
        values = [float(cell) for cell in columns[name] if _is_number(cell)]
        heading, factor = _readable(name, max((abs(value) for value in values), default=0.0))
        shown.append(heading)
        sigmas = columns.get(f"sigma_{name}")
        for k in range(count):
            rows[k][place] = _cell(columns[name][k], None if sigmas is None else sigmas[k], factor)
    return table(shown, rows, numbers=range(1, len(names)))


def _readable(name: str, largest: float) -> tuple[str, float]:
    """Return a column's heading with its unit, and the factor to that unit."""
    metres = ("_m", "mm", _MM) if largest < 0.1 else ("_m", "m", 1.0)
    for ending, unit, factor in (("_rad", "mrad", _MRAD), metres, ("_share", "%", 100.0), ("_ratio", "", 1.0)):
        if name.endswith(ending):
            words = name.removesuffix(ending).replace("_", " ")
            return (f"{words} [{unit}]" if unit else words), factor
    return name.replace("_", " "), 1.0


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _cell(text: str, sigma: str | None, factor: float) -> str:
    if not _is_number(text):
        return text or "-"
    if sigma is not None and _is_number(sigma) and float(sigma) > 0:
        return number_text(float(text) * factor, float(sigma) * factor, "")
    return text if text.lstrip("-").isdigit() else f"{float(text) * factor:.4g}"


def residuals(results: TroughResults) -> Html:
    """Return what remains of the edges' angles: distribution, photos, and what became of all edges."""
    edges = results.edges
    names, counts = np.unique(edges.fate, return_counts=True)
    order = np.argsort(-counts)
    rows = [
        (FATE_TEXTS[EdgeFate[str(names[k]).upper()]], f"{counts[k]}", f"{counts[k] / max(edges.fate.size, 1):.2%}")
        for k in order
    ]
    fates = table(("edges that were found", "count", "share"), rows, numbers=(1, 2))
    note = (
        "Residual: angle across the trough by which the line of sight through a found edge misses the tube's edge "
        "after all was adjusted, divided by the edge's standard deviation. Narrower than the normal distribution where "
        "few edges decide the slope together: each of them draws the solution to itself. Long tails would be errors "
        "that the standard deviations do not know."
    )
    return join(show(residual_figure(results), photo_figure(results), caption=note), fates)


def residual_figure(results: TroughResults) -> "Figure":
    """Draw the distribution of the normalised residuals of all edges that were used.

    Returns: A histogram against the normal distribution.
    """
    edges = results.edges
    ratio = (edges.residual_rad / _sigma_rad(results))[edges.used]
    ratio = ratio[np.isfinite(ratio)]
    rms = _MRAD * float(np.sqrt(np.mean(edges.residual_rad[edges.used] ** 2)))
    figure, axes = chart_figure(
        "Residuals of the edges", f"{ratio.size} edges; RMS {rms:.4f} mrad", "residual / sigma", "density", _HEIGHT_IN
    )
    bins = np.linspace(-5, 5, 81)
    density, _ = np.histogram(np.clip(ratio, -4.99, 4.99), bins)
    axes.stairs(density / max(ratio.size, 1) / np.diff(bins), bins, fill=True, color=LINE_X, alpha=0.7)
    fine = np.linspace(-5, 5, 201)
    axes.plot(fine, np.exp(-0.5 * fine**2) / np.sqrt(2 * np.pi), color=INK, linewidth=1, label="normal")
    add_legend(axes, loc="upper right")
    axes.set_xlim(-5, 5)
    return figure


def photo_figure(results: TroughResults) -> "Figure":
    """Draw mean and scatter of the residuals of each photo.

    Returns: RMS residual and mean of each photo over the camera's place.
    """
    edges = results.edges
    used, n = edges.used, len(results.photos)
    counts = np.bincount(edges.photo[used], minlength=n)
    safe = np.maximum(counts, 1)
    mean = np.bincount(edges.photo[used], weights=edges.residual_rad[used], minlength=n) / safe
    square = np.bincount(edges.photo[used], weights=edges.residual_rad[used] ** 2, minlength=n) / safe
    seen = counts > 0
    place = results.eyes_m[:, 0]
    figure, axes = chart_figure(
        "Residuals by photo",
        f"{int(seen.sum())} of {n} photos have edges that were used",
        "camera, x [m]",
        "residual [mrad]",
        _HEIGHT_IN,
    )
    axes.plot(place[seen], _MRAD * np.sqrt(square[seen]), ".", color=LINE_X, linestyle="none", label="RMS")
    axes.plot(place[seen], _MRAD * mean[seen], ".", color=LINE_Y, linestyle="none", label="mean")
    axes.plot(
        place[~seen], np.zeros(int((~seen).sum())), "x", color=INK, markersize=4, linestyle="none", label="no edge used"
    )
    axes.axhline(0, color=FAINT, linewidth=0.7)
    _room_above(axes)
    add_legend(axes, loc="upper right", ncols=3)
    return figure


def _room_above(axes: "Axes") -> None:
    low, high = axes.get_ylim()
    axes.set_ylim(low, high + 0.18 * (high - low))


def _sigma_rad(results: TroughResults) -> FloatArray:
    """Return the standard deviation of each edge's angle, shape (m,) [rad]."""
    from observer.trough.absorber_path import AbsorberPath

    edges, collector = results.edges, results.collector
    focal = collector.focal_length_m
    points = np.stack([edges.x_m, edges.y_m, edges.x_m**2 / (4 * focal)], axis=1)
    sights = Sights(points, results.eyes_m[edges.photo], edges.side)
    slope = points[:, 0] / (2 * focal)
    tube = AbsorberPath.straight(0.0, focal, collector.length_m / 2)
    found = misfit(sights, (slope, np.zeros_like(slope)), tube, collector.absorber_diameter_m / 2)
    factor = float(results.base.summary.numbers.get("edge_noise_factor") or 1.0)
    return np.asarray(factor * np.abs(change_across(sights, found, focal)) * edges.sigma_x_m)
