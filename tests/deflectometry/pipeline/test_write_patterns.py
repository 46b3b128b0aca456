"""Frames for a display on disk: what is shown, what is said of it, and what a camera sees of it."""

import tomllib
from pathlib import Path

import numpy as np
import pytest

from calibration.screen.keys import load_response
from calibration.screen.pipeline import run as calibrate
from deflectometry.keys import load_deflectometry
from deflectometry.pipeline.write_patterns import DisplayOptions, PatternOptions, display_levels, write_patterns
from deflectometry.setup.patterns import Axis, render_frames, response_table
from heliogauge.errors import InputError
from heliogauge.images.photos import read_frames, read_image, write_image
from heliogauge.measurement.load import parse_measurement
from heliogauge.measurement.templates import write_template
from heliogauge.measurement.writer import write_text
from heliogauge.results.tables import write_table_csv
from heliogauge.running import cli

SMALL = DisplayOptions(96, 64)
FEW = PatternOptions(periods=(0.9, 3.9), steps=3, grey_steps=5)


def camera_dn(level: np.ndarray) -> np.ndarray:
    """What the camera reads of a display with an exponent of 2.2 in a room that is not dark."""
    return 6.0 + 220.0 * np.asarray(level, dtype=np.float64) ** 2.2


def response_file(folder: Path, level: np.ndarray, full: float = 1.0) -> Path:
    path = folder / "measured.csv"
    write_table_csv(path, {"camera_dn": camera_dn(level), "display_level": full * level})
    return path


def harmonics(signal: np.ndarray) -> np.ndarray:
    """Amplitudes of the second to fourth harmonic relative to the first, of one whole period."""
    spectrum = np.abs(np.fft.rfft(signal))
    return spectrum[2:5] / spectrum[1]


def test_files_hold_the_frames_in_natural_order(tmp_path: Path) -> None:
    pattern = write_patterns(tmp_path / "out", SMALL, FEW)
    files = sorted((tmp_path / "out").glob("fringe_*.png"))
    assert len(files) == pattern.n_frames == 12
    frames = read_frames(files).images_dn
    np.testing.assert_array_equal(frames, np.stack(list(render_frames(pattern, 96, 64))))
    assert frames.dtype == np.uint8
    assert frames.shape == (12, 64, 96)
    # The first set varies from top to bottom, the last one from left to right.
    assert np.ptp(frames[0], axis=1).max() == 0 < np.ptp(frames[0], axis=0).min()
    assert np.ptp(frames[-1], axis=0).max() == 0
    assert read_image(tmp_path / "out" / "bright.png").min() == 255
    assert read_image(tmp_path / "out" / "dark.png").max() == 0
    greys = [int(read_image(path)[0, 0]) for path in sorted((tmp_path / "out").glob("grey_*.png"))]
    assert greys == [0, 64, 128, 191, 255]
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


def test_sixteen_bit_levels_and_the_other_order(tmp_path: Path) -> None:
    display = DisplayOptions(96, 64, bits=16, level_min=0.25, level_max=0.75)
    pattern = write_patterns(tmp_path / "out", display, PatternOptions((0.9, 7.9), 4, Axis.X, 3))
    assert [one.axis for one in pattern.sets] == [Axis.X, Axis.X, Axis.Y, Axis.Y]
    frames = read_frames(sorted((tmp_path / "out").glob("fringe_*.png"))).images_dn
    assert frames.dtype == np.uint16
    np.testing.assert_allclose([frames.min(), frames.max()], [0.25 * 65535, 0.75 * 65535], atol=200)
    assert frames.min() >= 0.25 * 65535 - 1
    bright, dark = (read_image(tmp_path / "out" / name) for name in ("bright.png", "dark.png"))
    # White is as bright as the fringes are; black is as dark as the display can be.
    assert (int(bright.max()), int(dark.max())) == (round(0.75 * 65535), 0)
    greys = tomllib.loads((tmp_path / "out" / "grey.toml").read_text(encoding="utf-8"))
    assert greys["display"] == {"levels": [0, 32768, 65535], "full_level": 65535}


def test_the_table_fits_into_a_measurement(tmp_path: Path) -> None:
    """Pasted in place of the template's own tables, with the frames as their own photographs."""
    out = tmp_path / "out"
    pattern = write_patterns(out, SMALL, FEW)
    template = tomllib.loads(write_template("deflectometry", tmp_path / "t").read_text(encoding="utf-8"))
    tables = tomllib.loads((out / "pattern.toml").read_text(encoding="utf-8"))
    assert set(tables) == {"pattern", "images"}
    model = parse_measurement({**template, **tables}, Path("measurement.toml"))
    for stated, one in zip(model.pattern.set, pattern.sets, strict=True):
        assert (stated.axis, stated.periods) == (one.axis, one.periods)
        np.testing.assert_allclose(np.radians(stated.steps_deg), one.steps_rad, atol=1e-11)
    text = (tmp_path / "t" / "measurement.toml").read_text(encoding="utf-8")
    start, end = text.index("[[pattern.set]]"), text.index("# The mirror. Facet frame")
    pasted = text[:start] + (out / "pattern.toml").read_text(encoding="utf-8") + text[end:]
    write_text(out / "measurement.toml", pasted)
    assert [file.name for file in load_deflectometry(out).fringe_files] == [f"fringe_{k:03d}.png" for k in range(12)]


@pytest.mark.parametrize("bits", [8, 16])
def test_the_camera_sees_a_sinusoid(tmp_path: Path, bits: int) -> None:
    options = PatternOptions(periods=(1.0,), steps=4, grey_steps=3)
    response = response_file(tmp_path, np.linspace(0, 1, 33))
    seen = []
    for name, file in (("plain", None), ("compensated", response)):
        write_patterns(tmp_path / name, DisplayOptions(512, 512, bits=bits, response_file=file), options)
        frame = read_image(tmp_path / name / "fringe_000.png")
        seen.append(camera_dn(frame[:, 0] / (2**bits - 1)))
    assert harmonics(seen[0])[0] > 0.15
    # Levels of 8 bit are 0.4 % steps; with 16 bit what is left is the straight line between 33 nodes.
    assert harmonics(seen[1]).max() < (6e-4 if bits == 8 else 2e-4)
    # A whole period from the darkest to the brightest the camera can see.
    np.testing.assert_allclose([seen[1].min(), seen[1].max()], [6.0, 226.0], atol=0.5)


def test_levels_stay_where_the_response_was_measured(tmp_path: Path) -> None:
    file = response_file(tmp_path, np.linspace(0.125, 0.875, 25))
    levels = display_levels(DisplayOptions(96, 64, response_file=file))
    assert (levels.minimum, levels.maximum) == (0.125, 0.875)
    pattern = write_patterns(
        tmp_path / "out", DisplayOptions(96, 96, bits=16, response_file=file), PatternOptions((1.0,), 4, Axis.Y, 3)
    )
    frames = np.stack([read_image(tmp_path / "out" / f"fringe_{k:03d}.png") for k in range(pattern.n_frames)])
    assert frames.min() / 65535 == pytest.approx(0.125, abs=0.01)
    assert frames.max() / 65535 == pytest.approx(0.875, abs=0.01)
    assert harmonics(camera_dn(frames[0][:, 0] / 65535)).max() < 1e-3
    assert "leave response_file out" in (tmp_path / "out" / "pattern.toml").read_text(encoding="utf-8")
    with pytest.raises(InputError, match=r"levels 0\.125 to 1: .*covers 0\.125 to 0\.875 only"):
        display_levels(DisplayOptions(96, 64, level_max=1.0, response_file=file))


def test_levels_of_other_programs(tmp_path: Path) -> None:
    file = response_file(tmp_path, np.linspace(0, 1, 33), full=255.0)
    with pytest.raises(InputError, match=r"goes up to 255, above full range 1; .*response_full_level"):
        display_levels(DisplayOptions(96, 64, response_file=file))
    table = display_levels(DisplayOptions(96, 64, response_file=file, response_full_level=255.0)).level_from_light
    light = np.linspace(0, 1, table.size)
    np.testing.assert_allclose(table**2.2, light, atol=4e-4)


def test_a_response_that_does_not_ascend_is_refused() -> None:
    with pytest.raises(InputError, match="strictly ascending"):
        response_table([1.0, 3.0, 2.0], [0.0, 0.5, 1.0])
    with pytest.raises(InputError, match="share of the display's range"):
        response_table([1.0, 2.0, 3.0], [0.0, 0.5, 1.5])


def test_from_grey_frames_to_compensated_fringes(tmp_path: Path) -> None:
    """What an engineer does: show the grey steps, photograph them, calibrate, make the fringes again."""
    out, photographs = tmp_path / "out", tmp_path / "photographs"
    write_patterns(out, SMALL, PatternOptions((0.9, 3.9), 4, Axis.Y, 33))
    photographs.mkdir()
    (photographs / "measurement.toml").write_text((out / "grey.toml").read_text(encoding="utf-8"), encoding="utf-8")
    rng = np.random.default_rng(1)
    for path in out.glob("grey_*.png"):
        signal = camera_dn(read_image(path) / 255)
        photo = np.rint(signal + rng.standard_normal(signal.shape))
        write_image(photographs / path.name, np.clip(photo, 0, 255).astype(np.uint8))
    (tmp_path / "response").mkdir()
    calibrate(load_response(photographs)).write(tmp_path / "response")
    display = DisplayOptions(512, 512, bits=16, response_file=tmp_path / "response" / "response.csv")
    write_patterns(tmp_path / "again", display, PatternOptions((1.0,), 4, Axis.Y, 3))
    seen = camera_dn(read_image(tmp_path / "again" / "fringe_000.png")[:, 0] / 65535)
    assert harmonics(seen).max() < 1e-3


@pytest.mark.parametrize(
    ("display", "options", "wanted"),
    [
        (SMALL, PatternOptions((0.9, 24.1)), r"24\.1 periods over the height of 64 px are 2\.7 px each; .*at most 16"),
        (DisplayOptions(96, 64, bits=12), FEW, r"bits: 8 or 16"),
        (DisplayOptions(96, 64, level_min=0.6, level_max=0.4), FEW, r"minimum < maximum"),
        (DisplayOptions(0, 64), FEW, r"width_px: a positive number"),
        (SMALL, PatternOptions((0.9,), 2), r"at least 3 frames"),
        (SMALL, PatternOptions((0.9,), grey_steps=2), r"3 to 256 levels"),
        (SMALL, PatternOptions((-1.0,)), r"periods: a positive number"),
    ],
)
def test_what_cannot_be_shown_is_refused(
    tmp_path: Path, display: DisplayOptions, options: PatternOptions, wanted: str
) -> None:
    with pytest.raises(InputError, match=wanted):
        write_patterns(tmp_path / "out", display, options)
    assert list(tmp_path.iterdir()) == []


def test_command_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "out"

    def leave(*arguments: str) -> int:
        size = ["--width-px", "96", "--height-px", "64", "--periods", "0.9,3.9"]
        with pytest.raises(SystemExit) as caught:
            cli.main(["deflectometry", "patterns", "-o", str(out), *size, *arguments])
        return int(caught.value.code or 0)

    assert leave("--steps", "3", "--grey-steps", "4", "--first", "x") == 0
    assert "12 fringe frames" in capsys.readouterr().out
    assert tomllib.loads((out / "pattern.toml").read_text())["pattern"]["set"][0]["axis"] == "x"
    assert len(list(out.iterdir())) == 12 + 2 + 4 + 2
    assert leave() == 2
    assert "--force" in capsys.readouterr().err
    assert leave("--force", "--bits", "16", "--level-max", "0.5") == 0
    assert read_image(out / "bright.png").max() == round(0.5 * 65535)
    (out / "measurement.toml").touch()
    assert leave("--force") == 2
    assert "something else" in capsys.readouterr().err
    assert leave("--response", str(tmp_path / "absent.csv"), "--force") == 2
