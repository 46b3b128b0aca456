"""One flight over several modules: who belongs where, who fails alone, what is written."""

from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from heliogauge.camera.model import Camera
from heliogauge.doubts import Doubt
from heliogauge.errors import EstimationError, InputError
from heliogauge.geometry.rigid import RigidTransform
from heliogauge.results.folder import Summary, read_summary
from heliogauge.results.tables import read_table_csv, write_table_csv
from heliogauge.running.progress import SilentProgress
from observer.keys import load_observer
from observer.photo_edges.views import View
from observer.pipeline import measure as pipeline
from observer.pipeline import modules as pipeline_modules
from observer.pipeline import unknown_camera
from observer.pipeline.reading import photos as photos_module
from observer.pipeline.reading.photo_poses import PlacedPhoto
from observer.pipeline.reading.photos import FirstLook
from observer.pipeline.result import Result
from photogrammetry.detection import Detections
from photogrammetry.pipeline import OnePhoto

A_DOUBT = Doubt("sparse", "a doubt")
TOML = """
kind = "observer"
name = "a field"
[collector]
aperture_width_m = 5.0
length_m = 3.16
focal_length_m = 1.49
absorber_diameter_mm = 70.0
[camera]
width_px = 480
height_px = 640
focal_px = 1000.0
[images]
photos = "photo_*.png"
[targets]
dictionary = "aicon-12"
[[scale_bar]]
a = "1"
b = "3"
length_m = 3.0
sigma_mm = 1.0
[[module]]
name = "A"
[[module]]
name = "B"
place_m = [7.0, 0.0, 0.0]
"""


def flight(folder: Path, toml: str = TOML, photos: int = 3) -> Path:
    """Write a folder with six targets on the rims of each of two rows."""
    places = [[row * 7 + side * 2.6, y, 1.05] for row in (0, 1) for side in (-1, 1) for y in (-1.5, 0.0, 1.5)]
    columns = {"target": [str(k + 1) for k in range(12)], "sigma_mm": ["1"] * 12}
    columns |= {f"{axis}_m": [f"{place[k]}" for place in places] for k, axis in enumerate("xyz")}
    write_table_csv(folder / "targets.csv", columns)
    (folder / "measurement.toml").write_text(toml, encoding="utf-8")
    for k in range(photos):
        (folder / f"photo_{k}.png").write_bytes(b"")
    return folder


def shown(photo: str, names: tuple[str, ...]) -> OnePhoto:
    n = len(names)
    table = Detections(
        photo, names, np.zeros((n, 2)), np.tile(np.eye(2), (n, 1, 1)), np.ones(n), np.zeros(n, np.uint32)
    )
    none = table.chosen(np.zeros(0, dtype=np.intp))
    return OnePhoto(table, np.tile(np.eye(2), (n, 1, 1)), (480, 640), (), none, np.zeros((0, 2, 2)))


class Written(Result):
    """A result that is only its summary."""

    def write_files(self, folder: Path) -> None:
        pass

    def summarise(self) -> Summary:
        return self._summary({"rms_theta_r_rad": 3e-3}, {})


@pytest.fixture
def solved(monkeypatch: pytest.MonkeyPatch) -> dict[str, list[str]]:
    """Replace photos and solution: photo 0 shows A, 1 shows both, 2 B and one rim of A; B has no reflection."""
    first, second = tuple("123456"), ("7", "8", "9", "10", "11", "12")
    looked = (
        shown("photo_0.png", first),
        shown("photo_1.png", first + second),
        shown("photo_2.png", ("4", "5", "6", *second)),
    )
    seen: dict[str, list[str]] = {}

    def look(files, finders, **_):
        names = tuple(file.name for file in files)
        assert [len(one.known.names) for one in finders] == [6, 6]
        np.testing.assert_allclose(finders[1].known.points_m[:, 0], [-2.6] * 3 + [2.6] * 3)
        return [FirstLook(names, looked, {}, {}, {}, None) for _ in finders]

    def evaluate(inputs, first, options, progress):
        with progress.stage("adjust"):
            seen[inputs.name] = [one.detections.photo for one in first.targets]
        assert [file.name for file in inputs.survey.photo_files] == seen[inputs.name]
        assert len(inputs.survey.model.scale_bar) == (inputs.name == "A")
        if inputs.name == "B":
            raise EstimationError("reflection: only 0 edges")
        return Written(*([None] * 15), name=inputs.name, doubts=(A_DOUBT,), input_sha256=inputs.input_sha256)

    monkeypatch.setattr(pipeline_modules, "look_first_at_each", look)
    monkeypatch.setattr(pipeline_modules, "evaluate", evaluate)
    return seen


def test_a_module_that_fails_is_told_and_stops_nobody(tmp_path: Path, solved: dict[str, list[str]]) -> None:
    measurement = load_observer(flight(tmp_path))
    out = tmp_path / "out"
    out.mkdir()
    result = pipeline_modules.run(measurement, out)
    # One rim of A in photo 2: three targets, which tell no pose.
    assert solved == {"A": ["photo_0.png", "photo_1.png"], "B": ["photo_1.png", "photo_2.png"]}
    assert sorted(path.name for path in out.iterdir()) == ["A", "overview.csv", "overview.nc", "summary.json"]
    assert set(read_summary(out / "A").input_sha256) == {
        "measurement.toml",
        "targets.csv",
        "photo_0.png",
        "photo_1.png",
    }
    table = read_table_csv(out / "overview.csv")
    assert table["result"] == ["A", "B"]
    assert table["failed"] == ["", "reflection: only 0 edges"]
    # Where it stands is known without its photos: the map of the field shows it.
    assert table["place_x_m"] == ["0.0", "7.0"]
    summary = read_summary(out)
    assert summary.numbers == {"modules_count": 1, "failed_count": 1}
    assert summary.facets == {"A": {"rms_theta_r_rad": 3e-3}}
    assert list(summary.durations_s) == ["hash inputs", "A", "B: adjust", "overview"]
    assert [one.code for one in result.doubts] == ["module_not_measured", "module_doubtful"]
    assert [one.text for one in result.doubts] == ["B: not measured: reflection: only 0 edges", "A: a doubt"]


def test_all_modules_failing_is_an_error_with_each_reason(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    toml = TOML.replace("[7.0, 0.0, 0.0]", "[50.0, 0.0, 0.0]").replace('name = "A"', 'name = "A"\nplace_m = [0, 30, 0]')
    with pytest.raises(EstimationError, match=r"none of 2 modules(.|\n)*A: 0 targets of the list(.|\n)*B: 0 targets"):
        pipeline_modules.run(load_observer(flight(tmp_path, toml)), tmp_path)


def test_lists_of_their_own_are_in_the_modules_own_frames(tmp_path: Path) -> None:
    toml = TOML.replace('name = "A"', 'name = "A"\ntargets_file = "a.csv"')
    toml = toml.replace('name = "B"', 'name = "B"\ntargets_file = "b.csv"')
    folder = flight(tmp_path, toml)
    (folder / "targets.csv").rename(folder / "a.csv")
    (folder / "b.csv").write_bytes((folder / "a.csv").read_bytes())
    measurement = load_observer(folder)
    assert {path.name for path in measurement.input_files[:3]} == {"measurement.toml", "a.csv", "b.csv"}
    modules, failed = pipeline_modules._modules(measurement)
    assert not failed
    np.testing.assert_allclose(modules[1].inputs.finder.known.points_m[0], [-2.6, -1.5, 1.05])
    # What contradicts them by chance is counted over all of the flight.
    assert {one.inputs.n_modules for one in modules} == {len(measurement.model.module)}


def test_a_camera_that_is_not_stated_starts_from_the_module_that_shows_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    toml = TOML.replace("[camera]\nwidth_px = 480\nheight_px = 640\nfocal_px = 1000.0\n", "")
    modules, _ = pipeline_modules._modules(load_observer(flight(tmp_path, toml)))
    inputs = [one.inputs for one in modules]
    assert not any(one.finder.camera_of for one in inputs)
    seen = SimpleNamespace(targets=(shown("photo_0.png", ("7",)),))
    monkeypatch.setattr(unknown_camera, "measure_targets", lambda *_, **__: seen)
    focal = {"A": None, "B": SimpleNamespace(focal_px=900.0)}
    named = dict(zip(("A", "B"), inputs, strict=True))
    monkeypatch.setattr(
        unknown_camera,
        "focal_of_photos",
        lambda _, finder, __: next(focal[name] for name, one in named.items() if one.finder is finder),
    )
    started = unknown_camera.start_unknown_camera_of_each(inputs, None, SilentProgress())
    assert [one.survey.model.camera[0].focal_px for one in started] == [900.0, 900.0]
    assert {camera.focal_x_px for one in started for camera in one.finder.camera_of.values()} == {900.0}
    focal["B"] = None
    assert unknown_camera.start_unknown_camera_of_each(inputs, None, SilentProgress()) == inputs


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (('name = "B"', 'name = "a"'), "the name a occurs twice"),
        (('name = "B"', 'name = "../B"'), "letters, digits"),
        (('dictionary = "aicon-12"', 'uncoded_file = "u.csv"'), "coded targets"),
        (("[[scale_bar]]", '[absorber]\nsource = "file"\nfile = "a.csv"\n[[scale_bar]]'), "common photos"),
    ],
)
def test_flights_that_cannot_be_are_refused(tmp_path: Path, change: tuple[str, str], message: str) -> None:
    with pytest.raises(InputError, match=message):
        load_observer(flight(tmp_path, TOML.replace(*change)))


def test_a_flight_is_no_single_measurement(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="a flight over 2 collectors; `heliogauge observer measure"):
        pipeline.run(load_observer(flight(tmp_path)))


def test_a_photo_is_searched_once_for_all_modules_and_not_where_none_can_be(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Photos of row A, which codes place, of nothing that is listed, and of an end of row B that has three codes."""
    folder = flight(tmp_path, TOML.replace("[targets]", 'encoding = "linear"\n[targets]'))
    for k in range(3):
        cv2.imwrite(str(folder / f"photo_{k}.png"), np.full((640, 480), 100 + k, dtype=np.uint8))
    measurement = load_observer(folder)
    found, _ = pipeline_modules._modules(measurement)
    down = RigidTransform(np.diag([1.0, -1.0, -1.0]), np.array([0.0, 0.0, 12.0]))
    searched: list[str] = []

    def search(image: np.ndarray, name: str, *_: object) -> OnePhoto:
        searched.append(name)
        if name != "photo_0.png":
            return shown(name, ("77", "78") if name == "photo_1.png" else ("7", "8", "9"))
        finder = found[0].inputs.finder
        one = shown(name, finder.known.names)
        pixels = finder.camera_of[name].project(down.apply(finder.known.points_m))
        return replace(one, detections=replace(one.detections, pixels_px=pixels))

    monkeypatch.setattr(photos_module, "measure_photo", search)
    looked: list[str] = []
    placed = photos_module.Finder.placed

    def place(self: photos_module.Finder, image: np.ndarray, one: OnePhoto, camera: Camera | None) -> PlacedPhoto:
        looked.append(one.detections.photo)
        return placed(self, image, one, camera)

    monkeypatch.setattr(photos_module.Finder, "placed", place)
    looks = pipeline_modules._look_at_each(measurement, found, pipeline.Options(jobs=1), SilentProgress())
    # Three codes of B: their dots are searched again, without codes.
    assert sorted(searched) == ["photo_0.png", "photo_1.png", "photo_2.png", "photo_2.png"]
    # B is 7 m beside what a photo shows whose pose is known by A.
    assert sorted(looked) == ["photo_0.png", "photo_1.png", "photo_1.png", "photo_2.png", "photo_2.png"]
    assert [sorted(one.poses) for one in looks] == [["photo_0.png"], []]
    assert [[own.detections.photo for own in one.targets] for one in looks] == [["photo_0.png"], ["photo_2.png"]]
    assert [sorted(one.slices.shown) for one in looks] == [[0], []]


def test_a_module_is_beside_a_photo_by_its_place_in_the_list(tmp_path: Path) -> None:
    measurement = load_observer(flight(tmp_path))
    modules, _ = pipeline_modules._modules(measurement)
    row_b = replace(modules[1].inputs.finder, list_from_frame=pipeline_modules._list_from_frame(modules[1].section))
    camera = row_b.camera_of["photo_0.png"]
    # Its rims at 4.4 and 9.6 m look 0.38 m nearer to the camera above A for each metre down; 64 px are left beside.
    for x_m, beside in ((0.0, True), (0.9, True), (1.1, False), (12.9, False), (13.1, True)):
        pose = RigidTransform(np.diag([1.0, -1.0, -1.0]), np.array([-x_m, 0.0, 12.0]))
        assert row_b.is_beside(camera, pose) is beside
    alone = replace(row_b, list_from_frame=None)
    assert not alone.is_beside(camera, RigidTransform(np.diag([1.0, -1.0, -1.0]), np.array([0.0, 0.0, 12.0])))


@dataclass
class Reader:
    """What reading again needs of a finder."""

    expected: object = None
    encodings: object = None

    def read(self, file: Path) -> str:
        return file.name


def test_photos_that_are_read_again_have_the_targets_they_show(monkeypatch: pytest.MonkeyPatch) -> None:
    """A module has targets only of photos that show it: counted among all photos, they were those of others."""
    asked = {}

    def shot(image: str, number: int, view: View, targets: OnePhoto | None, expected: object) -> None:
        asked[image] = targets
        raise EstimationError("enough")

    monkeypatch.setattr(photos_module, "_shot", shot)
    files, own = (
        [Path(f"photo_{k}.png") for k in range(3)],
        (shown("photo_1.png", ("1",)), shown("photo_2.png", ("2",))),
    )
    first = FirstLook(
        tuple(file.name for file in files), own, {}, {}, {}, SimpleNamespace(of_photos=lambda _: None), object()
    )
    view = View(
        Camera(480, 640, 1000.0, 1000.0, 239.5, 319.5),
        RigidTransform(np.diag([1.0, -1.0, -1.0]), np.array([0.0, 0.0, 12.0])),
    )
    for file in files:
        with pytest.raises(EstimationError, match="enough"):
            photos_module.look_again([file], [view], Reader(), first, jobs=1, progress=SilentProgress())
    assert asked == {"photo_0.png": None, "photo_1.png": own[0], "photo_2.png": own[1]}
