"""Pictures of beams in a result folder: which are drawn, what is in them, and that the report shows them."""

from pathlib import Path

import cv2
import numpy as np

from calibration.heliostat.keys import load_heliostat
from calibration.heliostat.pipeline import beam_pictures as pipeline_pictures
from calibration.heliostat.pipeline.field import run_into
from calibration.heliostat.pipeline.measure import Options
from calibration.heliostat.report import sections as report_sections
from calibration.heliostat.report.results import open_heliostat
from heliogauge.results.tables import read_table_csv, write_table_csv
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


def photographed(folder: Path, *, thorough: bool) -> Path:
    """Calibrate a heliostat whose beams, of known places, are in photos of 320 x 240 px; one photo shows none."""
    write_field(folder / "in", observations=20)
    file = folder / "in" / "observations.csv"
    table = read_table_csv(file)
    x, y = (np.array(table.pop(name), dtype=np.float64) for name in ("x_m", "y_m"))
    table["image"] = [f"{row:02d}.png" for row in range(20)]
    for row, name in enumerate(table["image"]):
        draw(folder / "in" / name, (x[row], y[row]), 0.0 if row == 3 else 120.0)
    write_table_csv(file, table)
    text = (folder / "in" / "measurement.toml").read_text(encoding="utf-8")
    text += f'\n[[images]]\ntarget = "{TARGET.name}"\nwhole = "edge"\n'
    (folder / "in" / "measurement.toml").write_text(text, encoding="utf-8")
    run_into(load_heliostat(folder / "in"), folder / "out", Options(thorough=thorough, model="5", jobs=1))
    return folder / "out"


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
    pictures = sorted(out.glob("beam_*.png"))
    assert [file.name for file in pictures] == [f"beam_{number:02d}.png" for number in range(1, len(pictures) + 1)]
    assert 8 <= len(pictures) <= 12
    assert max(file.stat().st_size for file in pictures) < 120_000
    picture = cv2.imread(str(pictures[-1]))
    assert picture.shape[1] == 576
    text = report_sections.beam_section(open_heliostat(out)).text
    assert text.count("<img") == len(pictures)


def test_quick_runs_draw_nothing(tmp_path: Path) -> None:
    out = photographed(tmp_path, thorough=False)
    assert (out / "beams.csv").is_file()
    assert not list(out.glob("beam_*.png"))
    assert report_sections.beam_section(open_heliostat(out)).text == ""
