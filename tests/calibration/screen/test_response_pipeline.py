"""`heliogauge screen measure`: photographs of grey levels with a known response, from folder to results."""

import csv
import json
import re
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from calibration.screen.files import Result, read_readings, read_response
from calibration.screen.keys import load_response
from calibration.screen.pipeline import Options, lit_pixels, run
from deflectometry import load_deflectometry
from heliogauge.errors import EstimationError, InputError
from heliogauge.images.photos import write_image
from heliogauge.measurement.templates import write_template
from heliogauge.measurement.writer import write_measurement
from heliogauge.reporting.build import build_report
from heliogauge.results.folder import read_summary
from heliogauge.running import cli
from tests.without_plots import without_plots

LEVELS = np.rint(np.linspace(0, 255, 17))


@dataclass(frozen=True)
class Photographs:
    """A display with a gamma, photographed so that it fills a part of a dark room."""

    gamma: float = 2.2
    gain_dn: float = 220.0
    ambient_dn: float = 6.0
    noise_dn: float = 1.0
    seed: int = 0

    def expected_dn(self, level: np.ndarray) -> np.ndarray:
        """Mean reading of the display's pixels."""
        return self.ambient_dn + self.gain_dn * (level / 255) ** self.gamma

    def write(self, folder: Path) -> Path:
        rng = np.random.default_rng(self.seed)
        folder.mkdir(parents=True, exist_ok=True)
        y, x = np.mgrid[0:60, 0:80]
        # Vignetting of 10 %, mean 1 over the display.
        seen = (np.abs(x - 42) < 24) & (np.abs(y - 28) < 18)
        shade = 1 - 0.1 * ((x - 42) ** 2 + (y - 28) ** 2) / 24**2
        shade /= shade[seen].mean()
        for index, level in enumerate(LEVELS):
            signal = self.ambient_dn + seen * shade * (self.expected_dn(level) - self.ambient_dn)
            noisy = signal + self.noise_dn * rng.standard_normal(signal.shape)
            write_image(folder / f"grey_{index}.png", np.clip(np.rint(noisy), 0, 255).astype(np.uint8))
        content = {"kind": "response", "name": "monitor", "display": {"levels": LEVELS.tolist()}}
        write_measurement(folder, content | {"images": {"grey": "grey_*.png"}})
        return folder


def change(folder: Path, old: str, new: str) -> None:
    file = folder / "measurement.toml"
    text = file.read_text(encoding="utf-8")
    assert text.count(old) == 1
    file.write_text(text.replace(old, new), encoding="utf-8")


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return Photographs().write(tmp_path / "grey")


def evaluate(folder: Path) -> Result:
    return run(load_response(folder), Options(jobs=1))


def test_the_response_is_found_within_its_sigma(tmp_path: Path) -> None:
    ratios = []
    for seed in range(6):
        photographs = Photographs(gamma=2.2, seed=seed)
        folder = photographs.write(tmp_path / str(seed))
        # The mean over the whole display is the truth; pixels found by themselves miss its corners, which are darker.
        change(folder, 'grey = "grey_*.png"', 'grey = "grey_*.png"\nregion_px = [19, 11, 65, 45]')
        response = evaluate(folder).response
        expected = photographs.expected_dn(255 * response.display_level)
        assert response.sigma_camera_dn is not None
        # Rounding to whole DN adds nothing that averages out over 2000 shaded pixels.
        ratios.append((response.camera_dn - expected) / response.sigma_camera_dn)
    # 99 % band of the mean of about 90 squares.
    squares = np.concatenate(ratios) ** 2
    assert 80 < squares.size <= 102
    assert 0.65 < squares.mean() < 1.45


def test_the_display_is_found_and_the_room_left_out(folder: Path) -> None:
    result = evaluate(folder)
    assert result.readings.pixels == pytest.approx(47 * 35, rel=0.01)
    assert result.readings.gain_spread < 0.05
    assert result.doubts == ()
    assert result.response.display_level[[0, -1]] == pytest.approx([0.0, 1.0])


def test_a_region_is_used_as_it_is_and_doubted_where_it_shows_the_room(folder: Path) -> None:
    change(folder, 'grey = "grey_*.png"', 'grey = "grey_*.png"\nregion_px = [30, 20, 49, 29]')
    assert evaluate(folder).readings.pixels == 200
    change(folder, "[30, 20, 49, 29]", "[0, 0, 79, 59]")
    assert [one.code for one in evaluate(folder).doubts] == ["pixels_differ_in_brightness"]
    change(folder, "[0, 0, 79, 59]", "[0, 0, 80, 59]")
    with pytest.raises(InputError, match=r"80 x 60 px, so the last pixel is \(79, 59\)"):
        evaluate(folder)


def test_saturated_steps_are_named_and_left_out(tmp_path: Path) -> None:
    photographs = Photographs(gain_dn=330.0)
    result = evaluate(photographs.write(tmp_path / "grey"))
    (warning,) = result.doubts
    dropped = np.flatnonzero(result.readings.is_saturated)
    assert dropped.size == 3
    assert warning.code == "grey_steps_saturated"
    assert warning.text.startswith("3 of 17 grey steps are saturated (pixels at 255 DN) and left out: grey_14.png")
    kept = result.response
    assert kept.display_level[-1] == pytest.approx(LEVELS[13] / 255)
    np.testing.assert_allclose(kept.camera_dn, photographs.expected_dn(255 * kept.display_level), atol=0.3)


def test_too_few_steps_that_are_not_saturated(tmp_path: Path) -> None:
    folder = Photographs(gain_dn=1e5).write(tmp_path / "grey")
    with pytest.raises(
        EstimationError, match=r"[12] of 17 grey steps are not saturated .* and \d+ more .* 3 are needed"
    ):
        evaluate(folder)


def test_a_display_that_does_not_brighten_is_refused(tmp_path: Path) -> None:
    with pytest.raises(EstimationError, match=r"separates only \d of 17 levels"):
        evaluate(Photographs(gain_dn=0.0).write(tmp_path / "dark"))
    with pytest.raises(EstimationError, match="no pixel is brighter"):
        evaluate(Photographs(gain_dn=0.0, noise_dn=0.0).write(tmp_path / "noiseless"))


def test_photographs_in_the_wrong_order_are_refused(folder: Path) -> None:
    (folder / "grey_5.png").rename(folder / "x")
    (folder / "grey_9.png").rename(folder / "grey_5.png")
    (folder / "x").rename(folder / "grey_9.png")
    with pytest.raises(EstimationError, match=r"falls from .* while the level rises"):
        evaluate(folder)


def test_one_bright_pixel_is_not_the_display() -> None:
    images = np.zeros((2, 40, 50), dtype=np.uint8)
    images[1, 5:25, 10:40] = 80
    images[1, 30, 45] = 255
    lit = lit_pixels(images)
    assert not lit[30, 45]
    assert np.count_nonzero(lit) == pytest.approx(20 * 30, abs=12)


@pytest.mark.parametrize(
    ("old", "new", "wanted"),
    [
        ("[0.0, 16.0,", "[16.0, 0.0,", r"display: levels must ascend, but level 1 is 16 and level 2 is 0"),
        ("[0.0, 16.0,", "[0.0, 0.0,", r"levels must ascend"),
        ("255.0]", "256.0]", r"level 256 is above full_level = 255"),
        ("levels =", "level =", r"display\.level is not a key here; did you mean 'levels'"),
        ("[0.0, 16.0, ", "[", r"gives 17 files, but display\.levels has 15 levels"),
        ('"grey_*.png"', '"photo_*.png"', r"images\.grey = 'photo_\*\.png': no file in"),
        ('"grey_*.png"', '"grey_*.png"\nregion_px = [5, 5, 4, 9]', r"x and y of the last pixel are below the first"),
        ('"grey_*.png"', '"grey_*.png"\nregion_px = [-1, 5, 4, 9]', r"region_px\[1\] = -1: a value not below 0"),
    ],
)
def test_mistakes_in_the_file_are_named(folder: Path, old: str, new: str, wanted: str) -> None:
    change(folder, old, new)
    with pytest.raises(InputError, match=wanted):
        load_response(folder)


def test_too_few_levels(folder: Path) -> None:
    content = {"kind": "response", "name": "a", "images": {"grey": "grey_*.png"}}
    with pytest.raises(InputError, match=r"display\.levels .*at least 3 entries are needed, there are 2"):
        write_measurement(folder, content | {"display": {"levels": [0, 255]}})


def test_folders_of_the_other_kind_name_the_command(folder: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="evaluate this folder with `heliogauge screen measure`"):
        load_deflectometry(folder)
    write_template("deflectometry", tmp_path / "other")
    with pytest.raises(InputError, match="evaluate this folder with `heliogauge deflectometry measure`"):
        load_response(tmp_path / "other")
    with pytest.raises(InputError, match="heliogauge screen init"):
        load_response(tmp_path)


def test_files_of_the_result(folder: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    out.mkdir()
    result = evaluate(folder)
    result.write(out)
    with (out / "response.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert list(rows[0]) == ["camera_dn", "display_level", "sigma_camera_dn"]
    assert [float(row["camera_dn"]) for row in rows] == result.response.camera_dn.tolist()
    summary = read_summary(out)
    assert summary.kind == "response"
    # A power law is furthest below its chord where its slope is that of the chord: level 2.2 ** (-1 / 1.2).
    at = 2.2 ** (-1 / 1.2)
    assert summary.numbers["nonlinearity_share"] == pytest.approx(at**2.2 - at, abs=0.003)
    assert summary.numbers["levels_count"] == 17
    assert len(summary.input_sha256) == 18
    readings = read_readings(out, summary)
    np.testing.assert_array_equal(readings.mean_dn, result.readings.mean_dn)
    np.testing.assert_array_equal(read_response(out).camera_dn, result.response.camera_dn)


def test_command_line(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "result"

    def leave(*arguments: str) -> int:
        with pytest.raises(SystemExit) as caught:
            cli.main([*arguments])
        return int(caught.value.code or 0)

    assert leave("screen", "measure", str(folder), "-o", str(out), "--jobs", "1") == 0
    assert "+-" in capsys.readouterr().out
    assert sorted(path.name for path in out.iterdir()) == [
        "readings.csv",
        "report.html",
        "report.ipynb",
        "response.csv",
        "summary.json",
    ]
    assert leave("screen", "measure", str(folder), "-o", str(out)) == 2
    assert "--force" in capsys.readouterr().err
    assert leave("screen", "measure", str(folder), "-o", str(tmp_path / "response.csv")) == 2
    assert "give a folder" in capsys.readouterr().err
    assert leave("heliostat", "measure", str(folder), "-o", str(tmp_path / "other")) == 2
    assert "evaluate this folder with `heliogauge screen measure`" in capsys.readouterr().err
    assert leave("telescope", "measure", str(folder), "-o", str(out)) == 2
    assert "No such command 'telescope'" in capsys.readouterr().err
    assert sorted(path.name for path in tmp_path.iterdir()) == ["grey", "result"]


def test_the_template_loads(tmp_path: Path) -> None:
    file = write_template("response", tmp_path)
    for index in range(17):
        (tmp_path / f"grey_{index:03d}.png").touch()
    assert len(load_response(tmp_path).grey_files) == 17
    text = file.read_text(encoding="utf-8").replace("#: ", "")
    file.write_text(text, encoding="utf-8")
    assert load_response(tmp_path).model.images.region_px == (100, 80, 900, 700)


def test_doubts_are_kept_in_the_summary(tmp_path: Path) -> None:
    result = evaluate(replace(Photographs(), gain_dn=330.0).write(tmp_path / "grey"))
    (tmp_path / "out").mkdir()
    result.write(tmp_path / "out")
    content = json.loads((tmp_path / "out" / "summary.json").read_text(encoding="utf-8"))
    assert content["numbers"]["saturated_levels_count"] == 3
    assert content["doubts"][0]["code"] == "grey_steps_saturated"
    assert content["doubts"][0]["numbers"]["saturated_count"] == 3
    assert content["doubts"][0]["severity"] == "doubt"


def test_the_report_says_what_the_files_say(folder: Path, tmp_path: Path) -> None:
    run(load_response(folder)).write(tmp_path)
    with without_plots():
        page = build_report(tmp_path).read_text(encoding="utf-8")
    first = page.partition("<h2")[0]
    numbers = read_summary(tmp_path).numbers
    assert f"{numbers['used_levels_count']} of {numbers['levels_count']}" in first
    shown = re.search(r"<td>(-?[0-9.]+) \u00b1 ([0-9.]+) %</td>", first)
    last_digit = 10.0 ** -len(shown[1].partition(".")[2])
    assert float(shown[1]) == pytest.approx(100 * numbers["nonlinearity_share"], abs=0.51 * last_digit)
    assert 'data-view="chart"' in first
    assert page.count('data-view="chart"') == 2
