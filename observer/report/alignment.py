"""Sections of the report of a prescription; each is one cell of its notebook."""

import base64
import html
from collections import Counter
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from heliogauge.files.regular import read_regular
from heliogauge.reporting import page
from heliogauge.reporting.html import FirstScreen, Html, join, wrap
from heliogauge.reporting.notation import light_text
from heliogauge.reporting.verdict import verdict_of
from heliogauge.results.folder import Summary, read_summary, read_table_csv
from heliogauge.validate import FloatArray
from heliogauge.view.maps import MapLayer, MapView
from heliogauge.view.stills import side_by_side
from observer.files import ALIGNMENT_OVERLAY, COLLECTOR, OVERLAY_STEM, read_collector
from observer.product.panel_turns import LEAST_GAIN_SHARE, TurnAdvice
from observer.report.figures_alignment import moves_sheet
from observer.report.lines import listed
from observer.report.maps import panel_lines
from observer.report.results import Columns, numbers
from observer.report.sections import headline_rows
from observer.trough.collector import Collector

_MRAD = 1e3
#: Nodes across and along in the map of the panels: edges are then within a centimetre or two.
_NODES = 240
#: Numbers of the first screen and what they are called there.
LABELS: dict[str, str] = {
    "rms_panel_theta_ra_rad": "Mean angle of a panel to the absorber, RMS",
    "largest_move_mm": "Largest move of a mount",
}


@dataclass(frozen=True, slots=True, eq=False)
class AlignmentResults:
    """What a folder with a prescription holds."""

    folder: Path
    summary: Summary
    collector: Collector
    panels: Columns
    mounts: Columns


def open_alignment(folder: str | Path = ".") -> AlignmentResults:
    """Read a folder with a prescription.

    folder: The folder; the working directory without it.
    """
    folder = Path(folder)
    tables = (read_table_csv(folder / name) for name in ("panels.csv", "mounts.csv"))
    return AlignmentResults(folder, read_summary(folder), read_collector(folder / COLLECTOR), *tables)


def panels_view(results: AlignmentResults) -> MapView:
    """Return the mean angles of the panels as a map."""
    collector = results.collector
    edges = collector.panel_edges_x_m, collector.panel_edges_y_m
    x, y = (np.linspace(one[0], one[-1], _NODES) for one in edges)
    column, row = (
        np.clip(np.searchsorted(one, nodes, "right") - 1, 0, one.size - 2)
        for one, nodes in zip(edges, (x, y), strict=True)
    )
    panel = row[:, None] * (edges[0].size - 1) + column[None, :]

    def spread(name: str) -> FloatArray:
        return np.asarray(numbers(results.panels, name)[panel])

    layers = tuple(
        MapLayer(
            name, f"mean {name} of each panel (+ to +x): {words}", "mrad", values, _MRAD, spread(f"sigma_{name}_rad")
        )
        for name, words in (("theta_ra", "to the absorber as it is"), ("theta_r", "to the design's focal line"))
        if np.isfinite(values := spread(f"{name}_rad")).any() or name == "theta_ra"
    )
    view = MapView(
        "Panels",
        x,
        y,
        layers,
        np.zeros(panel.shape, np.uint32),
        np.ones(panel.shape, np.bool_),
        note="Grey: less than half of the panel is measured, no prescription.",
        lines=panel_lines(collector),
    )
    # The table has the angles to the design; on paper the picture of the moves then fits below.
    return replace(view, stills=[view.layer_still("theta_ra")])


def head(results: AlignmentResults) -> FirstScreen:
    """Return the first screen: verdict, headline numbers, the panels."""
    summary = results.summary
    known = int(np.isfinite(numbers(results.panels, "theta_ra_rad")).sum())
    count = len(results.panels["panel"])
    missing = [f"{count - known} of {count} panels without a prescription"] if known < count else []
    passed = [f"{known} of {count} panels with a prescription"] if known else []
    line = f"prescription for {count} panels; heliogauge {summary.version}"
    rows = [*_to_turn(results.panels), *headline_rows(summary, LABELS)]
    return page.first_screen(summary.name, line, verdict_of(summary, missing, passed), rows, panels_view(results))


def _to_turn(panels: Columns) -> list[tuple[str, ...]]:
    """Say which panels are worth a turn, the largest gain first; nothing where the measurement has no gains."""
    if "turn" not in panels:
        return []
    gain, sigma = numbers(panels, "gain_ratio"), numbers(panels, "sigma_gain_ratio")
    best = [k for k in np.argsort(-np.nan_to_num(gain)) if panels["turn"][k] == TurnAdvice.TURN]
    gains = ", ".join(f"panel {panels['panel'][k]} gains {light_text(gain[k], sigma[k])}" for k in best)
    kinds = Counter(one for one in panels["turn"] if one != TurnAdvice.TURN)
    others = ", ".join(f"{count} {kind}" for kind, count in kinds.most_common())
    said = (gains, f"others: {others}" if others else "")
    note = "; ".join(text for text in said if text)
    return [("Panels to turn", ", ".join(panels["panel"][k] for k in best) or "none", note)]


def doubts(results: AlignmentResults) -> Html:
    """Return all doubts with all their words."""
    return page.doubts_box(results)


def moves(results: AlignmentResults) -> Html:
    """Return how far each mount is to be moved."""
    note = (
        "Moves along the mirror's normal, positive towards the absorber; a panel turns about its middle. Colours: mean "
        "theta_ra of each panel, positive where its normal is turned towards +x. Move to design is for the design's "
        "focal line instead of the absorber as it is."
    )
    panels, mounts = results.panels, results.mounts
    advice = panels.get("turn")
    if advice is not None:
        note += (
            " Moves take the mean angle to zero, whether or not that gains light: a turn can lose where the panel is "
            "bent, because the mean counts all of it alike and light is lost at its worst part. Under each number, and "
            "in the column turn: what to do (gain: share of the trough's light; sure: angle and gain beyond three "
            f"sigma; not worth it: below {100 * LEAST_GAIN_SHARE:g} % of the panel's own light)."
        )
    places = np.stack([numbers(mounts, "x_m"), numbers(mounts, "y_m")], axis=1)
    moved, sigma = (1e-3 * numbers(mounts, name) for name in ("move_mm", "sigma_move_mm"))
    sheet = moves_sheet(results.collector, numbers(panels, "theta_ra_rad"), places, (moved, sigma), advice)
    picture = side_by_side([sheet.html("Panels with the move of each mount")], caption=note)
    return join(picture, listed(panels, "panels"), listed(mounts, "mounts"))


def overlay(results: AlignmentResults) -> Html:
    """Return the theoretical image of the absorber over a photo."""
    note = (
        "In a well-aligned collector the dark band would lie between the dashed lines; panel by panel it is moved "
        "aside. overlay.csv has the corners for every photo."
    )
    path = results.folder / ALIGNMENT_OVERLAY
    paths = [path] if path.is_file() else sorted(results.folder.glob(f"{OVERLAY_STEM}*.svg"))
    return join(*(_image(path, note) for path in paths)) if paths else Html("<p>The result holds no photo.</p>")


def inputs(results: AlignmentResults) -> Html:
    """Return the input files."""
    return page.input_table(results)


def _image(path: Path, note: str) -> Html:
    data = base64.b64encode(read_regular(path)).decode("ascii")
    words = html.escape(note, quote=True)
    image = Html(f'<figure class="wide"><img alt="{words}" src="data:image/svg+xml;base64,{data}"></figure>')
    return join(wrap('<div class="figures">', [image], "</div>"), Html(f'<p class="caption">{html.escape(note)}</p>'))
