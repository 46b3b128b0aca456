"""Bad input of the Observer through the command: one clear message, or a flagged and explained result."""

import re
import shutil
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from data_synth.troughs.dataset import TroughOptions, write_trough_dataset
from data_synth.troughs.presets import TroughChoice, trough_scene
from heliogauge.doubts import Doubt, Severity
from heliogauge.errors import EstimationError, MetrologyError
from heliogauge.running.cli import main
from heliogauge.running.progress import SilentProgress
from observer import Options, run
from observer.keys import load_observer
from observer.pipeline.cameras import Cameras, adjust_cameras
from observer.pipeline.inputs import read_inputs
from observer.pipeline.reading.photos import look_first
from observer.pipeline.target_list import check_list


@pytest.fixture(scope="session")
def drawn_trough(tmp_path_factory) -> Path:
    """Sixteen photos of a short trough: no test may change it."""
    folder = tmp_path_factory.mktemp("trough") / "measurement"
    write_trough_dataset(folder, trough_scene("small", TroughChoice(n_photos=16)), TroughOptions(0))
    return folder


@pytest.fixture
def trough(drawn_trough, tmp_path) -> Path:
    """A copy to spoil, in a folder with spaces and letters that are not ASCII."""
    return shutil.copytree(drawn_trough, tmp_path / "Rinne Süd 1")


def photos_of(folder: Path) -> list[Path]:
    return sorted(folder.glob("photo_*.png"))


def each_target(folder: Path, change) -> None:
    file = folder / "targets.csv"
    head, *lines = file.read_text().splitlines()
    rows = [change(number, line.split(",")) for number, line in enumerate(lines)]
    file.write_text("\n".join([head, *(",".join(row) for row in rows if row)]) + "\n")


def refused(folder: Path) -> str:
    with pytest.raises(MetrologyError) as caught:
        run(load_observer(folder), Options(jobs=1))
    return str(caught.value)


def warnings_of(folder: Path) -> str:
    return "\n".join(map(str, run(load_observer(folder), Options(jobs=1)).doubts))


def scaled(factor: float, *columns: int):
    def change(_, row):
        return [str(float(cell) * factor) if place in columns else cell for place, cell in enumerate(row)]

    return change


# --- refused before anything is computed ----------------------------------------------------------------------------


def test_no_list_of_targets(trough):
    (trough / "targets.csv").unlink()
    assert "there is no file targets.csv in" in refused(trough)


def test_folder_without_photos(trough):
    for file in photos_of(trough):
        file.unlink()
    assert "images.photos = 'photo_*.png': no file in" in refused(trough)


def test_target_listed_twice(trough):
    each_target(trough, lambda number, row: ["1", *row[1:]] if number == 3 else row)
    assert "targets.csv, line 5: target 1 stands in line 2 already" in refused(trough)


@pytest.mark.parametrize(("cell", "said"), [("1;5", "is not a number"), ("0", "a value above 0 is needed")])
def test_cells_that_cannot_be_meant(trough, cell, said):
    each_target(trough, lambda number, row: [*row[:4], cell, *row[5:]] if number == 2 else row)
    text = refused(trough)
    assert "targets.csv, line 4: sigma_x_mm" in text
    assert said in text


@pytest.mark.parametrize(("key", "new"), [("aperture_width_m", "5000.0"), ("absorber_diameter_mm", "0.07")])
def test_collector_in_other_units(trough, rewrite, key, new):
    rewrite(trough, (rf"^{key} = .*", f"{key} = {new}"))
    assert "are the units right" in refused(trough)


def test_photo_cut_off(trough):
    file = photos_of(trough)[5]
    content = file.read_bytes()
    file.write_bytes(content[: len(content) // 2])
    assert re.search(rf"{file.name}: the PNG file is cut off", refused(trough))


def test_video_that_is_none(trough, rewrite):
    (trough / "pass.mp4").write_bytes(b"no video" * 100)
    rewrite(trough, (r"^photos = .*", 'video = "pass.mp4"'))
    assert "pass.mp4: cannot be opened as a video" in refused(trough)


def test_output_that_cannot_be_written(trough, tmp_path, start):
    """The result's folder would lie in a file."""
    (tmp_path / "file").write_text("x")
    done = start("observer", "measure", trough, "-o", tmp_path / "file" / "result", "-q")
    _, said = done.communicate(timeout=60)
    assert done.returncode == 2
    assert said.count("\n") == 1
    assert "Traceback" not in said


# --- photos that do not belong to the flight -------------------------------------------------------------------------


def adjusted(folder: Path) -> tuple[tuple[str, ...], str]:
    """The photos that were adjusted, and every doubt about photos and targets."""
    cameras, said = adjusted_cameras(folder)
    return tuple(file.name for file in cameras.files), "\n".join(map(str, said))


def adjusted_cameras(folder: Path) -> tuple[Cameras, tuple[Doubt, ...]]:
    inputs = read_inputs(load_observer(folder), SilentProgress())
    first = look_first(inputs.survey.photo_files, inputs.finder, jobs=1, progress=SilentProgress())
    listed = check_list(inputs.survey, inputs.finder, inputs.targets_file, first)
    listed, cameras = adjust_cameras(listed, inputs, 1, SilentProgress())
    return cameras, (*listed.doubts, *cameras.network.doubts, *cameras.doubts)


@pytest.mark.slow
def test_photo_of_another_size(trough, capsys):
    odd, *others = photos_of(trough)[::-1]
    cv2.imwrite(str(odd), cv2.resize(cv2.imread(str(odd), cv2.IMREAD_GRAYSCALE), (360, 480)))
    used, said = adjusted(trough)
    assert used == tuple(file.name for file in others[::-1])
    text = f"photo {odd.name} has another size than the others (360 x 480 px against 480 x 640 px): not of this camera"
    assert text in said
    with pytest.raises(SystemExit, match=r"^0$"):
        main(["check", str(trough)])
    assert text in "".join(capsys.readouterr())


# --- entries of the list that contradict the others ------------------------------------------------------------------


def contradiction(folder: Path) -> Doubt | None:
    found = [one for one in adjusted_cameras(folder)[1] if one.code == "targets_contradict_list"]
    assert len(found) < 2
    return found[0] if found else None


def kept_and_moved(kept: Sequence[int], moved: int, column: int, by_m: float):
    def change(_, row):
        if int(row[0]) == moved:
            row = [*row[:column], f"{float(row[column]) + by_m:.6f}", *row[column + 1 :]]
        return row if int(row[0]) in kept else None

    return change


@pytest.mark.parametrize(("moved", "column", "axis"), [(5, 3, "z"), (12, 1, "x")])
def test_a_mistyped_target_is_left_out_by_name(trough, moved, column, axis):
    each_target(trough, kept_and_moved(range(1, 13), moved, column, 0.02))
    doubt = contradiction(trough)
    assert doubt is not None
    assert doubt.severity is Severity.DOUBT
    assert re.search(
        rf"listed place of target {moved} \(-(1[7-9]|2[0-3])\.\d mm in {axis}\).* all others agree", doubt.text
    )


@pytest.mark.parametrize("moved", [1, 6])
def test_of_two_on_a_rim_both_are_named_and_none_is_left_out(trough, moved):
    each_target(trough, kept_and_moved((1, 6, *range(7, 13)), moved, 3, 0.02))
    doubt = contradiction(trough)
    assert doubt is not None
    assert doubt.severity is Severity.SERIOUS
    assert "any of 1, 6 may be wrong, which cannot be told: they were used" in doubt.text
    assert "not used" not in doubt.text


def test_a_sound_list_contradicts_nothing(trough):
    """Each target is a millimetre from where it is listed, as stated."""
    assert contradiction(trough) is None


# --- refused by what the photos say ---------------------------------------------------------------------------------


def test_list_mirrored(trough):
    each_target(trough, scaled(-1.0, 1))
    assert "the cameras are behind the mirror" in refused(trough)


def test_list_in_millimetres(trough):
    each_target(trough, scaled(1000.0, 1, 2, 3))
    said = refused(trough)
    # Where the adjustment does not settle, that is said; nothing is measured either way.
    assert "are the coordinates in metres" in said or "camera and list of targets" in said


@pytest.mark.slow
@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda number, row: [str(int(row[0]) + 100), *row[1:]], "the photos show 0, and 12 in all"),
        (lambda number, row: row if number < 6 else None, "free to turn, mostly about y"),
        (lambda number, row: row if number < 2 else None, "of the 2 targets in targets.csv"),
        (scaled(-1.0, 3), "change the sign of z_m"),
    ],
)
def test_list_that_tells_no_frame(trough, change, said):
    each_target(trough, change)
    assert said in refused(trough)


def test_photo_that_is_there_twice(trough):
    shutil.copy(photos_of(trough)[8], trough / "photo_900.png")
    assert "photo_900.png is a copy of photo_009.png" in refused(trough)


def test_one_photo(trough):
    for file in photos_of(trough)[1:]:
        file.unlink()
    assert refused(trough)


# --- flagged --------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_good_photos_have_no_doubts(trough):
    """Sixteen bit, colour, one coordinate unknown."""
    files = photos_of(trough)
    for file in files[:3]:
        grey = cv2.imread(str(file), cv2.IMREAD_UNCHANGED)
        cv2.imwrite(str(file), cv2.merge([grey, np.minimum(grey, 250), grey]))
    each_target(trough, lambda number, row: [*row[:1], "nan", *row[2:]] if number == 3 else row)
    assert "does not fit" not in warnings_of(trough)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("key", "new"),
    # The tube's diameter, which these photos know to 0.27 mm: tests/recovery/test_observer.py.
    [("aperture_width_m", 5.05), ("length_m", 3.1916), ("focal_length_m", 1.5049)],
)
def test_dimension_wrong_by_a_hundredth_is_named(trough, rewrite, key, new):
    rewrite(trough, (rf"^{key} = .*", f"{key} = {new}"))
    said = warnings_of(trough)
    assert re.findall(r"collector\.(\w+) = \S+ m?m does not fit", said) == [key], said


@pytest.mark.slow
def test_pass_over_one_half(trough):
    for file in photos_of(trough)[7:]:
        file.unlink()
    said = warnings_of(trough)
    assert re.search(r"no photo shows an edge .* on \d+ % of the mirror \(x = .*; fly from x = ", said), said


def keep_every(folder, count):
    for number, file in enumerate(photos_of(folder)):
        if number % count:
            file.unlink()


@pytest.mark.slow
def test_photos_far_apart(trough):
    keep_every(trough, 3)
    assert "at most 0.2 m apart" in warnings_of(trough)


@pytest.mark.slow
def test_photos_too_far_apart_for_any_slope(trough):
    keep_every(trough, 5)
    with pytest.raises(EstimationError, match=r"none of \d+ edges in 4 photos .* at most 0.2 m apart"):
        warnings_of(trough)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("key", "new", "said"),
    [
        ("focal_px = .*", "focal_px = 1040.3", r"with focal_px = 10(29|30)\.?\d* \+- 0\.\d+ instead of 1040.3"),
        ("k1 = .*", "k1 = 0.0", r"k1 = -0.0\d+ \+- 0.\d+ instead of 0"),
    ],
)
def test_wrong_camera_is_named_and_the_collector_is_not_blamed(trough, rewrite, key, new, said):
    rewrite(trough, (rf"^{key}", new))
    warnings = warnings_of(trough)
    assert re.search(said, warnings), warnings
    assert "collector." not in warnings


@pytest.mark.slow
def test_two_targets_exchanged_in_the_list_are_named_and_used(trough):
    each_target(trough, lambda number, row: [{"3": "9", "9": "3"}.get(row[0], row[0]), *row[1:]])
    said = warnings_of(trough)
    assert re.search("exchanged in the list: (3 and 9|9 and 3)", said)
    assert "not where the list has them" not in said


@pytest.mark.slow
def test_stated_dimension_too_small(trough, rewrite):
    """Mirror and absorber both say more, the mirror by a third of what is wrong."""
    rewrite(trough, (r"^focal_length_m = .*", "focal_length_m = 1.4751"))
    assert "collector.focal_length_m = 1.4751 m does not fit" in warnings_of(trough)


@pytest.mark.slow
def test_glass_that_is_not_stated_is_told_and_a_bare_tube_is_not_blamed(trough, rewrite, tmp_path):
    rewrite(trough, (r"^glass_.*\n", ""))
    assert "there seems to be glass around the absorber" in warnings_of(trough)
    scene = trough_scene("small", TroughChoice(n_photos=16))
    receiver = scene.world.receiver
    bare = replace(receiver, collector=replace(receiver.collector, glass=None))
    bare_scene = replace(scene, world=replace(scene.world, receiver=bare))
    write_trough_dataset(tmp_path / "bare", bare_scene, TroughOptions(0))
    rewrite(tmp_path / "bare", (r"^glass_.*\n", ""))
    assert "glass" not in warnings_of(tmp_path / "bare")


def drawn_otherwise(folder: Path, **finish: float) -> Path:
    """Return the same scene with parts of another brightness."""
    scene = trough_scene("small", TroughChoice(n_photos=16))
    scene = replace(scene, world=replace(scene.world, finish=replace(scene.world.finish, **finish)))
    write_trough_dataset(folder, scene, TroughOptions(0))
    return folder


@pytest.mark.slow
def test_tube_as_bright_as_the_sky_ends_with_the_reason(tmp_path):
    assert re.search(
        r"absorber: 0 photos .* as bright as what is seen behind it",
        refused(drawn_otherwise(tmp_path / "shiny", absorber=0.6)),
    )


@pytest.mark.slow
def test_weak_mirror_is_not_blamed_for_its_width(tmp_path):
    """At a reflectance of 0.7 it is as bright as the ground behind its rims."""
    assert "aperture_width_m" not in warnings_of(drawn_otherwise(tmp_path / "weak", reflectance=0.7))


@pytest.mark.slow
def test_overexposed_targets_are_said_and_the_camera_is_not_blamed(tmp_path):
    scene = trough_scene("small", TroughChoice(n_photos=16))
    bright = replace(scene.optics, sensor=replace(scene.optics.sensor, exposure=1.6))
    write_trough_dataset(tmp_path / "bright", replace(scene, optics=bright), TroughOptions(0))
    said = warnings_of(tmp_path / "bright")
    assert "overexposed white" in said
    assert "camera:" not in said
    assert "absorber_diameter" not in said


@pytest.mark.slow
def test_video_with_dropped_frames_measures_the_same(trough, rewrite):
    """Every photo a frame; some are lost, one is there twice."""
    writer = cv2.VideoWriter(str(trough / "Überflug.avi"), cv2.VideoWriter_fourcc(*"MJPG"), 25, (480, 640))
    for number, file in enumerate(photos_of(trough)):
        frame = cv2.cvtColor(cv2.imread(str(file), cv2.IMREAD_GRAYSCALE), cv2.COLOR_GRAY2BGR)
        for _ in range({3: 0, 8: 2}.get(number, 1)):
            writer.write(frame)
    writer.release()
    rewrite(trough, (r"^photos = .*", 'video = "Überflug.avi"'))
    result = run(load_observer(trough), Options(jobs=1))
    assert len(result.photos.poses) == 15
    assert "video_frames_repeat" in [one.code for one in result.doubts]
    assert result.network.solved.bundle.problem.observations.photos[0] == "Überflug.avi#00000"
