"""Report of a screen's plan: from the files of its results."""

from pathlib import Path

import numpy as np

from deflectometry.report import sigma_plan
from deflectometry.screen_geometry.pipeline.geometry import POINTS_FILE
from deflectometry.screen_geometry.planning.plan import PHOTOS_FILE
from heliogauge.reporting.html import FirstScreen, Html, table_under_name
from heliogauge.reporting.look import FAINT, LINE_X
from heliogauge.results.folder import read_table_csv
from heliogauge.validate import FloatArray
from heliogauge.view.scenes import ColorScale, SceneGroup, SceneView
from heliogauge.view.tables import TableColumn, TableView


def first(folder: Path) -> FirstScreen:
    """Return what the photos will be worth, with the screen and the cameras."""
    return sigma_plan.first(folder, scene(folder))


def scene(folder: Path) -> SceneView:
    """Return the points of the screen by their sigma of depth, and the cameras with their axes."""
    table = read_table_csv(folder / POINTS_FILE, ("x_m", "sigma_z_m"))
    xyz, sigma = _columns(table, ""), 1e3 * _columns(table, "sigma_")
    scale = ColorScale(0.0, float(sigma[:, 2].max()), "sigma of depth [mm]", diverging=False)
    labels = [f"sigma {x:.3g} / {y:.3g} / {z:.3g} mm" for x, y, z in sigma.tolist()]
    photos = read_table_csv(folder / PHOTOS_FILE, ("photo", "x_m"))
    places = _columns(photos, "")
    axes = np.stack([places, 0.85 * places], axis=1).reshape(-1, 3)
    groups = (
        SceneGroup("points of the screen", xyz, scale.colors(sigma[:, 2]), labels=labels, scale=scale),
        SceneGroup("cameras", places, [LINE_X], labels=photos["photo"]),
        SceneGroup("their axes", axes, [FAINT], lengths=[2] * len(places)),
    )
    return SceneView("The screen and the photos", groups, "x to the right, y up, z towards the viewer")


def photos(folder: Path) -> Html:
    """Return where each photo is taken."""
    table = read_table_csv(folder / PHOTOS_FILE, ("photo", "turned"))
    places = _columns(table, "")
    columns = [TableColumn("photo", table["photo"])]
    for axis, values in zip("xyz", places.T.tolist(), strict=True):
        columns.append(TableColumn(f"{axis} [m]", [f"{one:.3f}" for one in values], values))
    columns.append(TableColumn("camera", table["turned"]))
    return table_under_name(TableView("Where the photos are taken, in the screen's frame", tuple(columns)))


def _columns(table: dict[str, list[str]], before: str) -> FloatArray:
    return np.array([[float(cell) for cell in table[f"{before}{axis}_m"]] for axis in "xyz"]).T
