"""Input that every step swallows and that makes a wrong result: refused, or said in the warnings."""

import re

import cv2
import numpy as np
import pytest

from data_synth.fringes.dataset import DatasetOptions, write_dataset
from data_synth.fringes.faults import Fault
from data_synth.fringes.knowledge import Knowledge
from data_synth.fringes.presets import preset_scene
from deflectometry import load_deflectometry, run
from deflectometry.exchange.opencsp_files import read_opencsp_file
from heliogauge.errors import InputError, MetrologyError

GROSS, CURL, SHAPE = ("too far for any solar mirror", "no surface has these", "curvature is not")


def warnings_of(folder) -> str:
    result = run(load_deflectometry(folder))
    assert result.summarise().doubts == result.doubts
    return "\n".join(
        one.text for one in result.doubts if one.code not in ("sigma_of_setup_missing", "inputs_unconfirmed")
    )


def refused(folder) -> str:
    with pytest.raises(MetrologyError) as caught:
        run(load_deflectometry(folder))
    return str(caught.value)


def each_image(folder, change) -> None:
    for file in folder.glob("*.png"):
        cv2.imwrite(str(file), np.ascontiguousarray(change(cv2.imread(str(file), cv2.IMREAD_UNCHANGED))))


def test_good_measurement_has_no_doubts(drawn):
    assert warnings_of(drawn) == ""


@pytest.mark.slow
@pytest.mark.parametrize(
    ("change", "exchanged"),
    [(lambda image: image[:, ::-1], "left and right"), (lambda image: image[::-1], "top and bottom")],
    ids=["left and right", "top and bottom"],
)
def test_mirrored_images(folder, rewrite, change, exchanged):
    """60 mrad of error with a sigma of 0.01 mrad and no warning before."""
    rewrite(folder, (r"^\[mirror.distance\]\n.*\n.*\n", ""))
    each_image(folder, change)
    said = refused(folder)
    assert f"{exchanged} of the images are exchanged" in said
    assert "\n" not in said


@pytest.mark.slow
@pytest.mark.parametrize(
    ("pattern", "new", "doubts"),
    [
        ("^width_m = .*\nheight_m = .*", "width_m = 4.3635\nheight_m = 1.738", (CURL, GROSS)),
        (r"^rotation_vector_rad = .*", "rotation_vector_rad = [0.0, 0.0, 0.0]", (GROSS,)),
        ("^focal_length_m = .*", "focal_length_m = 100000.0", (SHAPE,)),
    ],
    ids=["screen half as large", "screen not turned", "focal length in mm"],
)
def test_wrong_setup(folder, rewrite, pattern, new, doubts):
    rewrite(folder, (pattern, new))
    said = warnings_of(folder)
    assert all(doubt in said for doubt in doubts), said


@pytest.mark.slow
def test_exchanged_axes(folder, rewrite):
    rewrite(folder, ('axis = "x"', 'axis = "z"'), ('axis = "y"', 'axis = "x"'), ('axis = "z"', 'axis = "y"'))
    said = refused(folder)
    assert CURL in said
    assert 'axis = "x" and axis = "y" of [[pattern.set]] are exchanged' in said


@pytest.mark.parametrize(
    ("pattern", "new", "says"),
    [
        ("^rotation_vector_rad = .*", "rotation_vector_rad = [31.66, 3.21, -176.47]", "is it in degrees"),
        ("^steps_deg = .*", "steps_deg = [0.0, 1.5708, 3.1416, 4.7124]", "are they in radians"),
        ("^saturation_dn = .*", "pixel_noise_dn = 0.01", "pixel_noise_dn = 0.01, but the readings scatter"),
        ("^saturation_dn = .*", "saturation_dn = 100.0", "reach 100 DN"),
        ("^width_px = .*", "width_px = 1624", "the images have 203 x 154 px"),
        ("^align = .*", "grid_step_mm = 0.001", "nodes on facet"),
        ("^center_x_px = .*", "center_x_px = 1010.6", "distance"),
    ],
)
def test_refused(folder, rewrite, pattern, new, says):
    rewrite(folder, (pattern, new))
    assert says in refused(folder)


def test_camera_behind_the_mirror(tmp_path, rewrite):
    write_dataset(tmp_path / "m", preset_scene("small"), DatasetOptions(0, Knowledge(pose_known=True)))
    rewrite(tmp_path / "m", (r"(mirror.pose\]\nrotation_vector_rad = ).*", r"\g<1>[0.0, 0.0, 0.0]"))
    assert "behind the mirror" in refused(tmp_path / "m")


@pytest.mark.slow
def test_pose_beside_the_mirror(tmp_path, rewrite):
    write_dataset(tmp_path / "m", preset_scene("small"), DatasetOptions(0, Knowledge(pose_known=True)))
    rewrite(tmp_path / "m", (r"(mirror.pose\]\n.*\ntranslation_m = ).*", r"\g<1>[0.25, 0.08, 9.65]"))
    assert "of the pixels on the mirror were rejected" in warnings_of(tmp_path / "m")


def test_full_well_of_12_bits_in_16_is_found(folder, rewrite):
    """Clipped at 4095 in a file that goes to 65535: 0.08 mrad of error and a warning of a gamma of 0.3."""
    rewrite(folder, ("^saturation_dn = .*\n", ""))
    each_image(folder, lambda image: np.minimum(image.astype(np.uint16) * 25, 4095))
    assert "reach 4095 DN" in refused(folder)


@pytest.mark.slow
def test_jpeg_is_doubtful(folder, rewrite):
    for file in folder.glob("*.png"):
        cv2.imwrite(str(file.with_suffix(".jpg")), cv2.imread(str(file), cv2.IMREAD_UNCHANGED))
        file.unlink()
    rewrite(folder, (r"\.png", ".jpg"))
    assert "JPEG" in warnings_of(folder)


@pytest.fixture
def curved(tmp_path):
    write_dataset(tmp_path / "m", preset_scene("curved-screen"), DatasetOptions(0, Knowledge()))
    return tmp_path / "m"


def spoil_table(folder, change) -> None:
    file = folder / "screen_points.csv"
    header, *rows = file.read_text().splitlines()
    changed = change([[float(cell) for cell in row.split(",")] for row in rows])
    file.write_text("\n".join([header, *(",".join(map(repr, row)) for row in changed)]) + "\n")


def test_screen_table_that_ends_early(curved):
    spoil_table(curved, lambda rows: [row for row in rows if row[0] < 0.5])
    assert "see beyond the measured points" in warnings_of(curved)


@pytest.mark.slow
def test_screen_table_with_one_wrong_point(curved):
    def change(rows):
        rows[3280][4] += 0.5
        return rows

    spoil_table(curved, change)
    assert "the worst in line 3282 (u = 0.5, v = 0.5) by 500 mm" in warnings_of(curved)


def test_screen_table_in_pixels(curved):
    spoil_table(curved, lambda rows: [[1920 * row[0], 1080 * row[1], *row[2:]] for row in rows])
    assert "screen_points.csv: u, v go from 0 to 1920" in refused(curved)


@pytest.mark.parametrize("text", ["drift:nan", "swapped:5.7", "saturated:0", "gamma:-1", "drift:-2"])
def test_impossible_faults_of_synthetic_frames(text):
    with pytest.raises(InputError, match="is needed"):
        Fault.parse(text)


def test_damaged_hdf5_of_opencsp(tmp_path):
    file = tmp_path / "m.h5"
    file.write_bytes(b"\x89HDF\r\n\x1a\n" + b"0" * 50)
    with pytest.raises(InputError, match=r"not a readable HDF5 .* or damaged"):
        read_opencsp_file(file)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("change", "named"),
    [
        ((r"(?m)^translation_m = \[([^,]*),", 0.02), "moved along its x axis"),
        ((r"(?m)^center_x_px = (.*)()$", 3.0), "principal point moved along x"),
    ],
    ids=["screen moved by 20 mm", "principal point off by 3 px"],
)
def test_setup_that_no_surface_allows_is_named(folder, change, named):
    """Neither shows in the outline, nor in the curl of single points."""
    pattern, amount = change
    file = folder / "measurement.toml"
    text = file.read_text()
    found = re.search(pattern, text)
    moved = text[: found.start(1)] + repr(float(found[1]) + amount) + text[found.end(1) :]
    file.write_text(re.sub(r"(?m)^\[mirror.distance\]\n.*\n.*\n", "", moved))
    doubts = {one.code: one for one in run(load_deflectometry(folder)).doubts}
    assert "setup_contradicts_slopes" in doubts
    assert named in doubts["setup_contradicts_slopes"].text
    assert doubts["setup_contradicts_slopes"].numbers["unexplained_ratio"] < 2.5
