"""Pictures of beams in a result folder: which are drawn, what is in them, and that the report shows them."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from calibration.heliostat.files.beam_files import PICTURE_COLUMNS
from calibration.heliostat.keys import load_heliostat
from calibration.heliostat.pipeline import beam_pictures as pipeline_pictures
from calibration.heliostat.pipeline.field import run_into
from calibration.heliostat.pipeline.measure import Options
from calibration.heliostat.report import sections as report_sections
from calibration.heliostat.report.charts import beam_view
from calibration.heliostat.report.results import open_heliostat
from heliogauge.results.tables import read_table_csv, write_table_csv
from heliogauge.results.thumbnails import read_thumbnails
from tests.calibration.heliostat.pipeline.test_heliostat_beams import draw
from tests.calibration.heliostat_folders import TARGET, write_field

RESIDUALS = np.array([0.1, 0.9, 0.3, np.nan, 0.5, 0.2, 0.7])


def test_left_out_worst_and_typical_each_once() -> None:
    rows = pipeline_pictures.informative_rows(RESIDUALS, [""] * 6 + ["outlier"], np.arange(7) != 2)
    assert [row for row, _ in rows] == [6, 1, 4, 5, 0]
    assert rows[0][1] == "left out (outlier)"
    assert "worst, 0.90 mrad" in rows[1][1]
    assert [why.startswith("typical") for _, why in rows] == [False, False, True, True, True]


def test_there_are_never_more_than_twelve() -> None:
    residuals, every = np.linspace(0.1, 2.0, 400), np.ones(400, dtype=np.bool_)
    rows = pipeline_pictures.informative_rows(residuals, ["image" if row % 3 == 0 else "" for row in range(400)], every)
    assert len(rows) == len({row for row, _ in rows}) == 12
    assert pipeline_pictures.informative_rows(residuals, [""] * 400, ~every) == []


def photographed(folder: Path, *, thorough: bool, n_heliostats: int = 1) -> Path:
    """Calibrate heliostats whose beams, of known places, are in photos of 320 x 240 px; one photo shows none."""
    write_field(folder / "in", heliostats=n_heliostats, observations=20)
    file = folder / "in" / "observations.csv"
    table = read_table_csv(file)
    x, y = (np.array(table.pop(name), dtype=np.float64) for name in ("x_m", "y_m"))
    table["image"] = [f"{row:02d}.png" for row in range(x.size)]
    for row, name in enumerate(table["image"]):
        draw(folder / "in" / name, (x[row], y[row]), 0.0 if row == 3 else 120.0)
    write_table_csv(file, table)
    text = (folder / "in" / "measurement.toml").read_text(encoding="utf-8")
    text += f'\n[[images]]\ntarget = "{TARGET.name}"\nwhole = "edge"\n'
    (folder / "in" / "measurement.toml").write_text(text, encoding="utf-8")
    run_into(load_heliostat(folder / "in"), folder / "out", Options(thorough=thorough, model="5", jobs=1))
    return folder / "out"


@pytest.mark.slow
def test_results_hold_the_beams_and_the_report_shows_them(tmp_path: Path) -> None:
    out = photographed(tmp_path, thorough=True)
    beams = read_table_csv(out / "beams.csv")
    assert len(beams["image"]) == 20
    assert [name for name, rejected in zip(beams["image"], beams["rejected"], strict=True) if rejected == "1"] == [
        "03.png"
    ]
    residuals = read_table_csv(out / "residuals.csv")
    told = np.array([float(cell or "nan") for cell in residuals["measured_x_m"]])
    np.testing.assert_allclose(np.delete(told, 3), np.delete([float(cell or "nan") for cell in beams["x_m"]], 3))
    pictures = read_table_csv(out / "beam_pictures.csv", PICTURE_COLUMNS)
    assert pictures["picture"] == [f"beam_{number:02d}" for number in range(1, len(pictures["picture"]) + 1)]
    assert 8 <= len(pictures["picture"]) <= 12
    thumbnails = read_thumbnails(out, pictures["picture"])
    assert list(thumbnails) == pictures["picture"]
    report = open_heliostat(out)
    view = beam_view(report)
    assert len(view.photos) == len(thumbnails)
    assert report_sections.beam_section(report).text.count("<img") == 1
    for photo in view.photos:
        observation = photo.mark.removeprefix("photo-")
        row = report.residuals.observation.index(observation)
        marks = {one.name: one for one in photo.marks}
        assert ("beam" in marks) != bool(report.residuals.flag[row])
        if "beam" not in marks:
            continue
        # The brightest light of the picture is where the mark is: within a pixel of the reduced picture or three.
        blurred = cv2.GaussianBlur(photo.image, (0, 0), 3)
        y, x = np.unravel_index(np.argmax(blurred), blurred.shape)
        scale = photo.width_px / photo.image.shape[1]
        np.testing.assert_allclose(marks["beam"].xy_px[0], (scale * x, scale * y), atol=6 * scale)
        assert photo.lines[0].name == "ellipse of D4-sigma"


@pytest.mark.slow
def test_each_heliostat_of_a_field_has_its_pictures(tmp_path: Path) -> None:
    out = photographed(tmp_path, thorough=True, n_heliostats=2)
    for folder in (out / name for name in read_table_csv(out / "field.csv")["heliostat"]):
        names = read_table_csv(folder / "beam_pictures.csv", PICTURE_COLUMNS)["picture"]
        assert len(names) >= 8
        assert list(read_thumbnails(folder, names)) == names


def test_quick_runs_draw_nothing(tmp_path: Path) -> None:
    out = photographed(tmp_path, thorough=False)
    assert (out / "beams.csv").is_file()
    assert not (out / "beam_pictures.csv").exists()
    assert not (out / "photos").exists()
    assert report_sections.beam_section(open_heliostat(out)).text == ""
