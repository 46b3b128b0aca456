"""Profiles of the absorber, intercept factor and residuals in a trough's report."""

from typing import Protocol

import numpy as np

from heliogauge.reporting.html import Html, beside, join, table
from heliogauge.reporting.look import FAINT, INK, LINE_X, LINE_Y
from heliogauge.reporting.notation import number_text
from heliogauge.validate import FloatArray
from heliogauge.view.charts import ChartSeries, ChartView, Mark
from heliogauge.view.tables import TableColumn, TableView
from observer.product.panel_turns import LEAST_GAIN_SHARE, turn_advice
from observer.report.results import Columns, TroughResults, numbers
from observer.selection.edge_refusal import FATE_TEXTS, EdgeFate
from observer.trough.collector import Collector
from observer.trough.observation_equation import Sights, change_across, misfit

_MM, _MRAD = 1e3, 1e3


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
    note = (
        "Bands: 1 sigma. Grey: receiver supports. Stations along the lower edge: not measured; absorber.csv says why."
    )
    drawn = beside(absorber_view(results, "x"), absorber_view(results, "z"))
    return join(
        drawn,
        Html(f'<p class="caption">{note}</p>'),
        listed(results.table("absorber_spans.csv"), "spans of the absorber"),
    )


_AXES = {
    "x": ("X_a, across the trough, from the plane of symmetry", LINE_X),
    "z": ("Z_a, from the focal line, + away from the mirror", LINE_Y),
}


def absorber_view(results: HasAbsorber, axes: str) -> ChartView:
    """Return the absorber's departure from the focal line.

    axes: "x", "z" or "xz".
    """
    columns = results.table("absorber.csv") or {}
    y = numbers(columns, "y_m")
    lines, ends, notes, unseen = [], [0.0], [], np.zeros(y.size, np.bool_)
    for axis in axes:
        value, sigma = (_MM * numbers(columns, f"{name}{axis}_a_m") for name in ("", "sigma_"))
        departure = value - (_MM * results.collector.focal_length_m if axis == "z" else 0.0)
        seen = np.isfinite(departure)
        band = np.where(seen, sigma, 0.0)
        words, color = _AXES[axis]
        lines.append(ChartSeries(words, y, departure, color, sigma=band, size_px=2.0))
        ends += [*(departure - band)[seen], *(departure + band)[seen]]
        if seen.any():
            notes.append(f"{axis}: mean {np.nanmean(departure):+.2f} mm, range {np.ptp(departure[seen]):.2f} mm")
        else:
            notes.append(f"{axis}: not seen")
        unseen |= ~seen
    if unseen.any():
        # Along the lower edge: at zero they would be taken for stations in the focal line.
        floor = np.full(int(unseen.sum()), min(ends))
        lines.append(ChartSeries("not measured (no value)", y[unseen], floor, INK, Mark.POINTS, size_px=4.0))
    # Each support from the lowest to the highest value, with a gap after it.
    supports = np.array(results.collector.support_y_m, dtype=np.float64)
    heights = np.tile([min(ends), max(ends), np.nan], supports.size)
    marked = [ChartSeries("receiver supports", np.repeat(supports, 3), heights, FAINT, size_px=1.0)]
    return ChartView(
        _AXES[axes][0] if axes in _AXES else "Absorber: departure from the focal line",
        "y along the trough [m]",
        " and ".join(axes) + " [mm]",
        (*(marked if supports.size else ()), *lines),
        "; ".join(notes),
    )


def intercept(results: TroughResults) -> Html:
    """Return the intercept factor with its heading; nothing where it was not computed."""
    drawn = [view for view in (intercept_view(results), spread_view(results)) if view is not None]
    if not drawn:
        return Html("")
    note = (
        "Share of the reflected light that meets the absorber, under the sun and errors named in the result. The "
        "curves of a perfect mirror or an aligned absorber say what either would gain; the top of each is the best "
        "tracking."
    )
    return join(Html("<h2>Intercept factor</h2>"), beside(*drawn), Html(f'<p class="caption">{note}</p>'))


def intercept_view(results: TroughResults) -> ChartView | None:
    """Return the intercept factor against the tracking offset; None where it was not computed."""
    columns = results.table("intercept.csv")
    if columns is None:
        return None
    offset, ratio, sigma = (
        numbers(columns, name) for name in ("tracking_offset_rad", "intercept_ratio", "sigma_intercept_ratio")
    )
    at_zero, own = float(np.interp(0, offset, ratio)), float(np.interp(0, offset, sigma))
    others = (
        ("intercept_absorber_aligned_ratio", LINE_Y, "absorber aligned"),
        ("intercept_mirror_perfect_ratio", FAINT, "mirror perfect"),
    )
    series = [
        ChartSeries(label, _MRAD * offset, numbers(columns, name), color, dashed=True)
        for name, color, label in others
        if name in columns
    ]
    series.append(ChartSeries("as measured", _MRAD * offset, ratio, LINE_X, sigma=sigma, size_px=2.0))
    return ChartView(
        "Intercept factor",
        "tracking offset [mrad]",
        "intercept factor",
        tuple(series),
        f"without tracking offset {number_text(at_zero, own, '')}",
    )


def spread_view(results: TroughResults) -> ChartView | None:
    """Return how the light is spread, and what the absorber accepts; None where it was not computed."""
    columns = results.table("beam_spread.csv")
    if columns is None:
        return None
    angle, error, beam, accepted = (
        numbers(columns, name)
        for name in ("angle_rad", "error_density_per_rad", "beam_density_per_rad", "acceptance_ratio")
    )
    highest = max(float(beam.max(initial=0.0)), float(error.max(initial=0.0)), 1e-9)
    half_window = float(np.abs(angle[accepted > 0.5]).max(initial=0.0))
    lit = np.abs(angle[beam > 1e-4 * beam.max(initial=0.0)])
    near = np.abs(angle) <= max(float(lit.max(initial=0.0)), 2 * half_window)
    series = (
        ("errors alone", error / highest, FAINT, False),
        ("with the sun", beam / highest, LINE_X, False),
        ("accepted share", accepted, LINE_Y, True),
    )
    return ChartView(
        "Spread of the reflected light",
        "angle of the reflected ray across the trough [mrad]",
        "density over its highest value; share",
        tuple(
            ChartSeries(name, _MRAD * angle[near], y[near], color, dashed=dashed) for name, y, color, dashed in series
        ),
        f"errors of mirror and absorber; with sun, specularity and tracking; highest {highest / _MRAD:.3g} 1/mrad",
    )


def panels(results: TroughResults) -> Html:
    """Return the table of the panels with its heading; nothing where there is none."""
    columns = results.table("panels.csv")
    if columns is None:
        return Html("")
    # Short headings, and nothing where all cells are empty: the table must not be wider than the page.
    shown = {
        name.replace("mean_", "").replace("centre_", "").replace("mount_move_", "mount_move_at_larger_x_"): cells
        for name, cells in (columns if "gain_is_sure" not in columns else _advised(columns)).items()
        if any(cells)
    }
    text = (
        "Means of the angles; the middle of each panel. A positive angle is taken back by turning the panel to -x. "
        "<em>gain</em>: what the intercept factor gains by turning this panel until its mean theta_ra is zero, the sun "
        "on the optical axis; it is sure where angle and gain are beyond three sigma. A turn to mean angle zero can "
        "lose light where the panel is bent: the mean counts all of it alike, the light is lost at its worst part. "
        f"A gain below {100 * LEAST_GAIN_SHARE:g} % of the panel's own light is not worth a turn. <em>turn</em>: what "
        "follows for the panel. <em>mount move at larger x</em>: of the mount at the panel's edge of larger x, along "
        "the mirror's normal, positive towards the absorber; the one at smaller x moves the other way. "
        "<code>heliogauge observer align</code> gives the moves of the mounts."
    )
    return join(Html(f"<h2>Panels</h2><p>{text}</p>"), listed(shown, "panels"))


def _advised(columns: Columns) -> Columns:
    """Return the panels' table with what to do in words, and without digits of gains that are as good as none."""
    gain, sigma = (numbers(columns, name) for name in ("gain_ratio", "sigma_gain_ratio"))
    advice = turn_advice(gain, sigma, numbers(columns, "gain_is_sure") == 1)
    found: Columns = {}
    for name, cells in columns.items():
        if name == "gain_is_sure":
            found["turn"] = [str(one) for one in advice]
        elif name == "gain_ratio":
            # A thousandth of what is worth a turn.
            none = (np.abs(gain) + 3 * sigma) * gain.size < 1e-3 * LEAST_GAIN_SHARE
            found[name] = ["none" if one else cell for one, cell in zip(none, cells, strict=True)]
        else:
            found[name] = cells
    return found


def listed(columns: Columns | None, name: str = "numbers") -> Html:
    """Return a table of results with units that are easy to read; nothing without one.

    columns: A table as it was read. A column ``sigma_NAME`` is joined to the column ``NAME``.
    name: What the table lists.
    """
    if not columns:
        return Html("")
    shown = []
    for key, cells in columns.items():
        if key.startswith("sigma_") and key.removeprefix("sigma_") in columns:
            continue
        values = [float(cell) if _is_number(cell) else np.nan for cell in cells]
        heading, factor = _readable(key, max((abs(value) for value in values if np.isfinite(value)), default=0.0))
        sigmas = columns.get(f"sigma_{key}") or [""] * len(cells)
        texts = [_cell(cell, sigma or None, factor) for cell, sigma in zip(cells, sigmas, strict=True)]
        shown.append(TableColumn(heading, texts, values if np.isfinite(values).any() else None))
    return join(TableView(name, tuple(shown)))


def _readable(name: str, largest: float) -> tuple[str, float]:
    """Return a column's heading with its unit, and the factor to that unit."""
    if name == "gain_ratio":
        return "gain [% of the light]", 100.0
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
    drawn = beside(residual_view(results), photo_residual_view(results))
    return join(drawn, Html(f'<p class="caption">{note}</p>'), fates)


def residual_view(results: TroughResults) -> ChartView:
    """Return the distribution of the normalised residuals of all edges that were used, and the normal one."""
    edges = results.edges
    ratio = (edges.residual_rad / _sigma_rad(results))[edges.used]
    ratio = ratio[np.isfinite(ratio)]
    rms = _MRAD * float(np.sqrt(np.mean(edges.residual_rad[edges.used] ** 2)))
    bins = np.linspace(-5, 5, 81)
    middles = 0.5 * (bins[1:] + bins[:-1])
    density = np.histogram(np.clip(ratio, -4.99, 4.99), bins)[0] / max(ratio.size, 1) / np.diff(bins)
    series = (
        ChartSeries("edges", middles, density, LINE_X, Mark.BARS),
        ChartSeries("normal", middles, np.exp(-0.5 * middles**2) / np.sqrt(2 * np.pi), INK),
    )
    note = f"{ratio.size} edges; RMS {rms:.4f} mrad"
    return ChartView("Residuals of the edges", "residual / sigma", "density", series, note)


def photo_residual_view(results: TroughResults) -> ChartView:
    """Return RMS and mean of the residuals of each photo over the camera's place."""
    edges = results.edges
    used, n = edges.used, len(results.photos)
    counts = np.bincount(edges.photo[used], minlength=n)
    safe = np.maximum(counts, 1)
    mean = np.bincount(edges.photo[used], weights=edges.residual_rad[used], minlength=n) / safe
    square = np.bincount(edges.photo[used], weights=edges.residual_rad[used] ** 2, minlength=n) / safe
    seen = counts > 0
    place = results.eyes_m[:, 0]
    labels = np.array([f"{name}: {count} edges" for name, count in zip(results.photos, counts, strict=True)])
    kinds = (
        ("RMS", seen, _MRAD * np.sqrt(square), LINE_X),
        ("mean", seen, _MRAD * mean, LINE_Y),
        ("no edge used", ~seen, np.zeros(n), INK),
    )
    series = tuple(
        ChartSeries(name, place[chosen], y[chosen], color, Mark.POINTS, labels=labels[chosen].tolist(), size_px=6.0)
        for name, chosen, y, color in kinds
        if chosen.any()
    )
    note = f"{int(seen.sum())} of {n} photos have edges that were used"
    return ChartView("Residuals by photo", "camera, x [m]", "residual [mrad]", series, note)


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
