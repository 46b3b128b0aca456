"""A plan of an overlay for the report: photos as they will be, and each facet."""

from pathlib import Path

import numpy as np

from deflectometry.overlay.planning.plan import FACETS_FILE, SIGHTS_FILE
from deflectometry.report.overlay import photos
from deflectometry.report.sigma_plan import first as first_of_sigmas
from heliogauge.reporting.html import FirstScreen, Html, table_under_name
from heliogauge.results.folder import read_table_csv
from heliogauge.view.tables import TableColumn, TableView

_MRAD = 1e3


def first(folder: Path) -> FirstScreen:
    """Return what the photos will be worth, and what they will show."""
    return first_of_sigmas(folder, photos(folder, "Image of the source in each facet as designed."))


def facets(folder: Path) -> Html:
    """Return each facet's sigmas, and how much of the source's edge it shows."""
    table = read_table_csv(folder / FACETS_FILE, ("facet", "room_rad"))
    sights = read_table_csv(folder / SIGHTS_FILE, ("facet", "edge_share", "reason"))
    columns = [TableColumn("facet", table["facet"])]
    for label, key in (
        ("sigma of canting in x [mrad]", "sigma_canting_x_rad"),
        ("in y [mrad]", "sigma_canting_y_rad"),
        ("room [mrad]", "room_rad"),
    ):
        values = [_MRAD * float(one or "nan") for one in table[key]]
        texts = [f"{one:.3g}" if np.isfinite(one) else "\u2013" for one in values]
        columns.append(TableColumn(label, texts, values))
    least, reasons = [], []
    for name in table["facet"]:
        rows = [n for n, one in enumerate(sights["facet"]) if one == name]
        least.append(min(float(sights["edge_share"][n]) for n in rows))
        reasons.append("; ".join(dict.fromkeys(one for n in rows if (one := sights["reason"][n]))))
    columns.append(TableColumn("edge seen, least of all photos", [f"{one:.0%}" for one in least], least))
    if any(reasons):
        columns.append(TableColumn("where none is seen", reasons))
    words = "Facets; room: how far one may be turned before it cuts off an image of the source (negative: it does)"
    return table_under_name(TableView(words, tuple(columns)))
