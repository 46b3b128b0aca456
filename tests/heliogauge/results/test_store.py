"""Files on disk: what goes in comes out, other programs read it, and nothing is ever half-written."""

import csv
import hashlib
import json
import math
import os
import shutil
from pathlib import Path

import h5py
import numpy as np
import pytest
import xarray
from hypothesis import given
from hypothesis import strategies as st

from heliogauge import __version__
from heliogauge.camera.distortion import BrownDistortion, DistortionDirection
from heliogauge.camera.model import PARAMETER_NAMES, Camera
from heliogauge.doubts import Doubt, Severity
from heliogauge.errors import InputError, UnexplainedNumberWarning
from heliogauge.flags import SampleFlag
from heliogauge.geometry.rigid import RigidTransform
from heliogauge.results.folder import (
    UNEXPLAINED,
    CutOut,
    PhotoPose,
    PointTable,
    ResultFolder,
    Summary,
    facet_names,
    hash_files,
    read_camera_json,
    read_cameras_json,
    read_columns_csv,
    read_pixels,
    read_points_csv,
    read_slope_map,
    read_slope_map_attributes,
    read_summary,
    read_table_csv,
    unit_of,
    write_camera_json,
    write_cameras_json,
    write_pixels,
    write_points_csv,
    write_slope_map,
    write_summary,
    write_table_csv,
)
from heliogauge.slopes.map import CommonModes, SlopeMap, no_common_modes

ARRAYS = (
    "x_m",
    "y_m",
    "slope_x",
    "slope_y",
    "design_slope_x",
    "design_slope_y",
    "sigma_random_x",
    "sigma_random_y",
    "height_m",
    "flags",
    "aperture",
)


def make_map(common: CommonModes | None = None, rows: int = 7, columns: int = 9, seed: int = 3) -> SlopeMap:
    """A map with noise in every bit, gaps, flags and two common modes."""
    rng = np.random.default_rng(seed)
    x_m, y_m = np.linspace(-0.6, 0.6, columns), np.linspace(-0.4, 0.4, rows)
    x, y = np.meshgrid(x_m, y_m)
    slopes = rng.normal(0, 1e-3, (2, rows, columns))
    flags = np.zeros((rows, columns), np.uint32)
    flags[2, 3] = int(SampleFlag.SATURATED | SampleFlag.OUTLIER)
    slopes[:, 2, 3] = np.nan
    if common is None:
        common = CommonModes(("mirror pose", "screen; a/b"), rng.normal(0, 1e-5, (2, 2, 6)), np.array([0.1, -0.2]), 0.7)
    return SlopeMap(
        x_m,
        y_m,
        slopes[0] + x / 20,
        slopes[1] + y / 20,
        x / 20,
        y / 20,
        rng.uniform(1e-6, 1e-5, x.shape),
        rng.uniform(1e-6, 1e-5, x.shape),
        2.1,
        common,
        rng.normal(0, 1e-5, x.shape),
        flags,
        np.hypot(x, y) < 0.65,
        "paraboloid, f = 10 m",
        "facet",
        "nothing",
    )


def assert_same_map(first: SlopeMap, second: SlopeMap) -> None:
    for name in ARRAYS:
        one, other = getattr(first, name), getattr(second, name)
        if one.ndim == 2 and one.dtype == np.float64:
            # Fields are stored as float32, axes and bits as they are.
            one, other = one.astype(np.float32), other.astype(np.float32)
        np.testing.assert_array_equal(one, other, err_msg=name)
    for name in ("design", "frame", "removed"):
        assert getattr(first, name) == getattr(second, name)
    assert first.noise_correlation == second.noise_correlation
    assert first.common.sources == second.common.sources
    np.testing.assert_array_equal(first.common.coefficients, second.common.coefficients)
    np.testing.assert_array_equal(first.common.center_m, second.common.center_m)
    assert first.common.scale_m == second.common.scale_m


@pytest.mark.parametrize("common", [None, no_common_modes()], ids=["two modes", "no modes"])
def test_a_slope_map_comes_back_as_float32(tmp_path: Path, common: CommonModes | None) -> None:
    slope_map = make_map(common)
    write_slope_map(tmp_path / "slope_map.nc", {"facet": slope_map})
    assert_same_map(read_slope_map(tmp_path / "slope_map.nc"), slope_map)
    assert facet_names(tmp_path / "slope_map.nc") == ()


def test_a_slope_map_that_xarray_wrote_again_is_the_same(tmp_path: Path) -> None:
    """Through h5netcdf each attribute that is a number becomes an array of one."""
    slope_map, path = make_map(), tmp_path / "slope_map.nc"
    write_slope_map(path, {"": slope_map, "left": make_map(seed=4)}, {"name": "facet", "exposure_s": 0.5})
    xarray.open_datatree(path, engine="h5netcdf").to_netcdf(tmp_path / "again.nc", engine="h5netcdf")
    with h5py.File(tmp_path / "again.nc") as file:
        assert np.shape(file.attrs["noise_correlation"]) == (1,)
    assert_same_map(read_slope_map(tmp_path / "again.nc"), slope_map)
    assert_same_map(read_slope_map(tmp_path / "again.nc", "left"), make_map(seed=4))
    attributes = read_slope_map_attributes(tmp_path / "again.nc")
    assert (attributes["name"], attributes["exposure_s"]) == ("facet", 0.5)


def test_a_slope_map_that_xarray_packed_is_unpacked(tmp_path: Path) -> None:
    """Whole numbers with a scale are a usual way to save space; read as they stand a slope of 1e-3 would be 1000."""
    slope_map, path = make_map(), tmp_path / "slope_map.nc"
    write_slope_map(path, {"": slope_map})
    packed = {"dtype": "int32", "scale_factor": 1e-9, "add_offset": 1e-3, "_FillValue": -(2**31)}
    encoding = dict.fromkeys(("slope_x", "slope_y"), packed) | {"height": {"zlib": True}}
    xarray.open_dataset(path, engine="h5netcdf").to_netcdf(tmp_path / "again.nc", engine="h5netcdf", encoding=encoding)
    again = read_slope_map(tmp_path / "again.nc")
    np.testing.assert_allclose(again.slope_x, slope_map.slope_x, atol=1e-9, rtol=1e-6)
    np.testing.assert_array_equal(again.valid, slope_map.valid)


def test_xarray_reads_a_slope_map_as_the_contract_says(tmp_path: Path) -> None:
    slope_map = make_map()
    hashes = {"fringe_00.png": "ab" * 32}
    write_slope_map(tmp_path / "slope_map.nc", {"": slope_map}, {"input_sha256": hashes})
    with xarray.open_dataset(tmp_path / "slope_map.nc", engine="h5netcdf") as data:
        for name in ("slope", "design_slope", "slope_error", "sigma_slope", "sigma_random_slope"):
            for axis in "xy":
                assert data[f"{name}_{axis}"].dims == ("y", "x")
                assert data[f"{name}_{axis}"].attrs["units"] == "rad"
        assert data["height"].attrs["units"] == "m"
        np.testing.assert_array_equal(data.coords["x"], slope_map.x_m)
        assert data.coords["y"].attrs["units"] == "m"
        difference = data["slope_x"] - data["design_slope_x"]
        np.testing.assert_allclose(data["slope_error_x"], difference, rtol=0, atol=4e-9)
        np.testing.assert_allclose(data["sigma_slope_y"], slope_map.sigma_slope()[1], rtol=1e-6)
        assert int(np.isnan(data["slope_x"]).sum()) == 1
        masks = dict(zip(data["flag"].attrs["flag_meanings"].split(), data["flag"].attrs["flag_masks"], strict=True))
        assert data["flag"].values[2, 3] == masks["saturated"] | masks["outlier"]
        assert data["flag"].dtype == data["flag"].attrs["flag_masks"].dtype == np.uint32
        assert data.attrs["design"] == slope_map.design
        assert data.attrs["removed"] == "nothing"
        assert data.attrs["software_version"] == __version__
        assert data.attrs["measured_share"] == slope_map.measured_share
        assert "seen from the front" in data.attrs["orientation"]
        assert json.loads(data.attrs["input_sha256"]) == hashes
    assert read_slope_map_attributes(tmp_path / "slope_map.nc")["input_sha256"] == hashes


def test_each_facet_is_a_group_beside_the_assembled_map(tmp_path: Path) -> None:
    maps = {"": make_map(seed=1), "upper left": make_map(seed=2, rows=5), "B/2": make_map(no_common_modes(), seed=4)}
    path = tmp_path / "slope_map.nc"
    write_slope_map(path, maps)
    assert facet_names(path) == ("upper left", "B_2")
    for name, slope_map in maps.items():
        assert_same_map(read_slope_map(path, name or None), slope_map)
    with xarray.open_dataset(path, engine="h5netcdf", group="upper left") as data:
        assert data.sizes["y"] == 5
    with pytest.raises(InputError, match=r"no facet 'C3' .*upper left, B_2"):
        read_slope_map(path, "C3")


def test_several_maps_need_the_assembled_one(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="assembled"):
        write_slope_map(tmp_path / "slope_map.nc", {"a": make_map(), "b": make_map()})


def test_more_hashes_than_an_attribute_holds_become_one(tmp_path: Path) -> None:
    hashes = {f"image_{number:05d}.png": "0" * 64 for number in range(900)}
    write_slope_map(tmp_path / "slope_map.nc", {"": make_map()}, {"input_sha256": hashes})
    digest = hashlib.sha256(json.dumps(hashes).encode()).hexdigest()
    assert digest in read_slope_map_attributes(tmp_path / "slope_map.nc")["input_sha256"]


@pytest.mark.parametrize("name", ["design", "name"])
@pytest.mark.parametrize("value", [b"\xff\xfe", '["\\ud800"]'])
def test_texts_that_no_file_could_hold_are_refused(tmp_path: Path, name: str, value: bytes | str) -> None:
    """They would come out again in summary.json, which is UTF-8."""
    path = tmp_path / "slope_map.nc"
    write_slope_map(path, {"facet": make_map()})
    with h5py.File(path, "r+") as file:
        file.attrs[name] = value
    with pytest.raises(InputError, match="a text in it is not UTF-8"):
        read_slope_map_attributes(path)


def test_files_that_are_no_slope_maps_are_refused(tmp_path: Path) -> None:
    (tmp_path / "text.nc").write_text("x")
    for path in (tmp_path / "text.nc", tmp_path / "absent.nc"):
        with pytest.raises(InputError, match=path.name):
            read_slope_map(path)
    xarray.Dataset({"slope_x": ("x", [1.0])}).to_netcdf(tmp_path / "other.nc", engine="h5netcdf")
    with pytest.raises(InputError, match="heliogauge_schema 0"):
        read_slope_map(tmp_path / "other.nc")
    write_pixels(tmp_path / "pixels.nc", {"x": np.zeros((2, 3))})
    with pytest.raises(InputError, match="slope_x"):
        read_slope_map(tmp_path / "pixels.nc")
    with pytest.raises(InputError, match="cannot be written"):
        write_slope_map(tmp_path / "absent" / "slope_map.nc", {"": make_map()})


def test_pixels_come_back_as_float32_and_open_in_xarray(tmp_path: Path) -> None:
    arrays = {"u": np.linspace(0, 1, 12).reshape(3, 4), "flag": np.arange(12, dtype=np.uint32).reshape(3, 4)}
    arrays["facet"] = np.ones((3, 4), np.int16)
    write_pixels(tmp_path / "pixels.nc", arrays, {"first_row": 100})
    back = read_pixels(tmp_path / "pixels.nc")
    assert list(back) == list(arrays)
    np.testing.assert_array_equal(back["u"], arrays["u"].astype(np.float32))
    np.testing.assert_array_equal(back["flag"], arrays["flag"])
    with xarray.open_dataset(tmp_path / "pixels.nc", engine="h5netcdf") as data:
        assert data["u"].dims == ("row", "column")
        assert data.attrs["first_row"] == 100
    with pytest.raises(InputError, match="phase"):
        write_pixels(tmp_path / "pixels.nc", {"phase": np.zeros((2, 2))})
    with pytest.raises(InputError, match="shape"):
        write_pixels(tmp_path / "pixels.nc", {"x": np.zeros((2, 2)), "y": np.zeros((2, 3))})


def test_cut_out_reads_as_the_whole_image_and_takes_its_own_space(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    part = {"u": rng.random((40, 50)).astype(np.float32), "facet": np.ones((40, 50), np.int16)}
    part["flag"] = np.arange(2000, dtype=np.uint32).reshape(40, 50)
    whole = {"u": np.full((700, 900), np.nan, np.float32), "facet": np.zeros((700, 900), np.int16)}
    whole["flag"] = np.full((700, 900), 7, np.uint32)
    for name, values in part.items():
        whole[name][600:640, 850:] = values
    write_pixels(tmp_path / "part.nc", part, cut_out=CutOut((700, 900), 600, 850, {"flag": 7}))
    back = read_pixels(tmp_path / "part.nc")
    with xarray.open_dataset(tmp_path / "part.nc", engine="h5netcdf") as data:
        for name, values in whole.items():
            np.testing.assert_array_equal(back[name], values, strict=True)
            np.testing.assert_array_equal(data[name], values)
    # 4 squares of 128 px a side and 10 bytes a pixel are 0.66 MB, the whole is 6.3 MB.
    assert (tmp_path / "part.nc").stat().st_size < 1e6


def make_summary(**changes: object) -> Summary:
    fields: dict[str, object] = {
        "kind": "deflectometry",
        "name": "facet 7",
        "numbers": {"sdx_rad": 1.25e-3, "sigma_sdx_rad": 2e-6, "facets_count": 1, "focal_x_m": None},
        "texts": {"design": "paraboloid, f = 10 m", "frame": "\u00b5"},
        "doubts": (Doubt("frames_saturated", "3 frames saturated", {"frames_count": 3.0}, Severity.NOTE),),
        "durations_s": {"read images": 0.123456},
        "input_sha256": {"a.png": "00"},
        "not_determined": {"focal_x_m": "the facet is flat"},
    }
    return Summary(**{**fields, **changes})  # type: ignore[arg-type]


def test_the_summary_comes_back(tmp_path: Path) -> None:
    write_summary(tmp_path / "summary.json", make_summary())
    for path in (tmp_path, tmp_path / "summary.json"):
        back = read_summary(path)
        for name in ("kind", "name", "numbers", "texts", "doubts", "input_sha256", "not_determined", "version"):
            assert getattr(back, name) == getattr(make_summary(), name)
        assert back.durations_s == {"read images": 0.1235}
    assert json.loads((tmp_path / "summary.json").read_text())["numbers"]["focal_x_m"] is None


@pytest.mark.parametrize("value", [math.nan, math.inf, None, np.float64("nan")])
def test_a_number_that_is_none_needs_a_reason(tmp_path: Path, value: float | None) -> None:
    """Without one the result is kept, a warning says so to the user, and stops a test that does not await it."""
    file = tmp_path / "summary.json"
    for more in ({"numbers": {"sdx_rad": value}}, {"numbers": {}, "facets": {"A1": {"sdx_rad": value}}}):
        with pytest.warns(UnexplainedNumberWarning, match=r"sdx_rad is not determined"):
            write_summary(file, make_summary(**more))
        assert read_summary(file).not_determined["sdx_rad"] == UNEXPLAINED
    reason = {"sdx_rad": "nothing measured"}
    numbers = {"sdx_rad": value, "sigma_sdx_rad": value}
    write_summary(file, make_summary(numbers=numbers, not_determined=reason))
    assert read_summary(tmp_path).numbers == dict.fromkeys(numbers)
    # A sigma is not determined for the reason of its number.
    assert read_summary(tmp_path).not_determined == dict.fromkeys(numbers, "nothing measured")


def test_numbers_name_their_unit(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"sdx: .*unit"):
        write_summary(tmp_path / "summary.json", make_summary(numbers={"sdx": 1.0}))
    assert unit_of("curl_rms_per_m") == ("curl_rms", "1/m")
    assert unit_of("measured_share") == ("measured_share", "")
    assert unit_of("area_m2") == ("area", "m\u00b2")


def test_a_summary_of_a_newer_version_is_refused(tmp_path: Path) -> None:
    (tmp_path / "summary.json").write_text('{"software": "heliogauge", "schema_version": 99}')
    with pytest.raises(InputError, match="schema_version 99"):
        read_summary(tmp_path)
    (tmp_path / "summary.json").write_text("{")
    with pytest.raises(InputError, match="not valid JSON"):
        read_summary(tmp_path)


def make_camera() -> Camera:
    rng = np.random.default_rng(5)
    root = rng.normal(size=(10, 10)) * np.array([1, 1, 1, 1, 0.1, 1e-3, 1e-3, 1e-4, 1e-4, 1e-3])[:, None]
    lens = BrownDistortion(k1=-0.1, k2=0.02, p1=1e-4, p2=-2e-4, direction=DistortionDirection.MEASURED_TO_IDEAL)
    return Camera(1624, 1232, 2000.1, 2001.2, 811.5, 615.5, 0.3, lens, root @ root.T)


def assert_same_camera(first: Camera, second: Camera) -> None:
    np.testing.assert_array_equal(first.parameters, second.parameters)
    np.testing.assert_array_equal(first.covariance, second.covariance)
    assert first.distortion.direction == second.distortion.direction
    assert (first.width_px, first.height_px) == (second.width_px, second.height_px)


def test_cameras_and_poses_come_back(tmp_path: Path) -> None:
    camera = make_camera()
    pose = PhotoPose("left", RigidTransform.from_rotation_vector([0.1, 2, -0.3], [1, 2, 3]), np.diag([1e-6] * 6), 0.12)
    write_cameras_json(tmp_path / "cameras.json", {"left": camera}, {"IMG_1.jpg": pose})
    cameras, poses = read_cameras_json(tmp_path / "cameras.json")
    assert_same_camera(cameras["left"], camera)
    back = poses["IMG_1.jpg"]
    np.testing.assert_allclose(back.cam_from_world.rotation, pose.cam_from_world.rotation, atol=1e-15)
    np.testing.assert_array_equal(back.cam_from_world.translation_m, [1, 2, 3])
    np.testing.assert_array_equal(back.covariance, pose.covariance)
    assert (back.camera, back.residual_rms_px) == ("left", 0.12)
    stored = json.loads((tmp_path / "cameras.json").read_text())["poses"]["IMG_1.jpg"]
    assert stored["sigma_translation_m"] == pytest.approx([1e-3] * 3)
    assert_same_camera(read_camera_json(tmp_path / "cameras.json"), camera)
    content = (tmp_path / "cameras.json").read_text().replace('"camera": "left"', '"camera": "right"')
    (tmp_path / "other.json").write_text(content)
    with pytest.raises(InputError, match=r"the camera 'right' of photo IMG_1\.jpg is not among the cameras"):
        read_cameras_json(tmp_path / "other.json")


def test_a_camera_file_comes_back_and_names_its_faults(tmp_path: Path) -> None:
    path = tmp_path / "camera.json"
    write_camera_json(path, make_camera())
    assert_same_camera(read_camera_json(path), make_camera())
    content = json.loads(path.read_text())
    assert content["parameter_order"] == list(PARAMETER_NAMES)
    for change, message in (
        ({"focal": 3}, "focal.* unknown"),
        ({"k1": "x"}, "numbers"),
        ({"distortion_direction": "up"}, "distortion_direction 'up'"),
        ({"parameter_order": ["k1"]}, "parameter_order"),
        ({"focal_x_px": -1}, "focal_x_px"),
    ):
        path.write_text(json.dumps(content | change))
        with pytest.raises(InputError, match=message):
            read_camera_json(path)
    path.write_text("{}")
    with pytest.raises(InputError, match=r"width_px.* missing"):
        read_camera_json(path)


def test_a_minimal_camera_file_is_enough(tmp_path: Path) -> None:
    size_and_pinhole = {"width_px": 8, "height_px": 6, "focal_x_px": 9, "focal_y_px": 9, "center_x_px": 3.5}
    (tmp_path / "camera.json").write_text(json.dumps(size_and_pinhole | {"center_y_px": 2.5}))
    np.testing.assert_array_equal(read_camera_json(tmp_path / "camera.json").covariance, 0)


@given(st.lists(st.floats(allow_nan=True, allow_infinity=False, width=64), min_size=1, max_size=5))
def test_points_come_back_bit_for_bit(tmp_path_factory: pytest.TempPathFactory, values: list[float]) -> None:
    path = tmp_path_factory.mktemp("points") / "points.csv"
    count = len(values)
    xyz_m = np.column_stack([values, np.arange(count), np.zeros(count)])
    points = PointTable(tuple(f"p,{i}" for i in range(count)), xyz_m, xyz_m * 1e-6, np.arange(count), np.ones(count))
    write_points_csv(path, points)
    back = read_points_csv(path)
    np.testing.assert_array_equal(back.xyz_m, points.xyz_m)
    np.testing.assert_array_equal(back.sigma_m, points.sigma_m)
    assert back.ids == points.ids
    assert path.read_text().splitlines()[0] == "id,x_m,y_m,z_m,sigma_x_m,sigma_y_m,sigma_z_m,n_rays,flag"


def test_tables_name_their_faults(tmp_path: Path) -> None:
    path = tmp_path / "table.csv"
    with pytest.raises(InputError, match="one length"):
        write_table_csv(path, {"a": [1], "b": [1, 2]})
    path.write_text("a,b\n1,2\n3\n")
    with pytest.raises(InputError, match="line 3"):
        read_table_csv(path)
    with pytest.raises(InputError, match="x_px"):
        read_table_csv(path, ("x_px",))
    path.write_text("id,x_m,y_m,z_m,sigma_x_m,sigma_y_m,sigma_z_m,n_rays,flag\na,1,2,three,1,1,1,2,0\n")
    with pytest.raises(InputError, match="z_m must hold numbers"):
        read_points_csv(path)


_STRANGE = ["=cmd|' /C calc'!A0", "+1+1", "-A7", "@SUM(A1)", "\tx", "\rx", "'=1", "''@x", "-", '=HYPERLINK("x","y")']
_HARMLESS = ["-12", "+5", "-1.5e-3", "-.5", "-inf", "nan", "'quoted'", "a=b", "A-7", "'"]


def test_no_cell_is_a_formula_and_every_text_comes_back(tmp_path: Path) -> None:
    texts = _STRANGE + _HARMLESS
    columns = {
        "=head()": texts,
        "-x": list(range(len(texts))),
        "mixed": [*texts[:-1], -2.5],
        "number": [-1.5] * len(texts),
    }
    path = tmp_path / "points.csv"
    write_table_csv(path, columns)
    with path.open(encoding="utf-8", newline="") as file:
        header, *rows = list(csv.reader(file))
    assert header == ["'=head()", "'-x", "mixed", "number"]
    assert [row[0] for row in rows] == [f"'{text}" for text in _STRANGE] + _HARMLESS
    assert {row[3] for row in rows} == {"-1.5"}
    back = read_table_csv(path)
    assert list(back) == list(columns)
    assert back["=head()"] == texts
    assert back["mixed"] == [*texts[:-1], "-2.5"]
    found, _ = read_columns_csv(path, ("=head()",), ("-x",))
    assert found["=head()"] == texts


@given(st.lists(st.text(alphabet="'=+-@\t1.eaé,\"", min_size=1).filter(lambda text: text == text.strip()), min_size=1))
def test_any_text_comes_back(tmp_path_factory: pytest.TempPathFactory, texts: list[str]) -> None:
    path = tmp_path_factory.mktemp("texts") / "t.csv"
    write_table_csv(path, {"id": texts, "x_m": [1.0] * len(texts)})
    assert read_columns_csv(path, ("id",), ("x_m",))[0]["id"] == texts


def test_hashes_are_those_of_sha256(tmp_path: Path) -> None:
    (tmp_path / "sub").mkdir()
    paths = [tmp_path / "b.bin", tmp_path / "sub" / "a.bin"]
    for number, path in enumerate(paths):
        path.write_bytes(bytes([number]) * 100_000)
    hashes = hash_files(paths, tmp_path)
    assert list(hashes) == ["b.bin", "sub/a.bin"]
    assert hashes["sub/a.bin"] == hashlib.sha256(bytes([1]) * 100_000).hexdigest()
    assert list(hash_files(paths)) == ["b.bin", "a.bin"]
    with pytest.raises(InputError, match=r"absent\.png"):
        hash_files([tmp_path / "absent.png"])


def put_result(folder: Path, text: str) -> None:
    (folder / "summary.json").write_text(text)


def fail_half_way(target: Path, error: type[BaseException], *, force: bool = False) -> None:
    with ResultFolder(target, force=force) as folder:
        put_result(folder, "half")
        raise error


def be_overtaken(target: Path) -> None:
    with ResultFolder(target) as folder:
        put_result(folder, "second")
        target.mkdir()
        put_result(target, "first")


def test_a_result_appears_whole(tmp_path: Path) -> None:
    target = tmp_path / "deep" / "result"
    with ResultFolder(target) as folder:
        put_result(folder, "new")
        assert not target.exists()
        assert folder.parent == target.parent
    assert (target / "summary.json").read_text() == "new"
    assert [path.name for path in target.parent.iterdir()] == ["result"]


@pytest.mark.parametrize("error", [ValueError, KeyboardInterrupt, SystemExit])
def test_a_failed_run_leaves_nothing_and_keeps_the_earlier_result(tmp_path: Path, error: type[BaseException]) -> None:
    target = tmp_path / "result"
    with pytest.raises(error):
        fail_half_way(target, error)
    assert list(tmp_path.iterdir()) == []
    with ResultFolder(target) as folder:
        put_result(folder, "good")
    with pytest.raises(error):
        fail_half_way(target, error, force=True)
    assert (target / "summary.json").read_text() == "good"
    assert [path.name for path in tmp_path.iterdir()] == ["result"]


def test_force_replaces_the_whole_earlier_result(tmp_path: Path) -> None:
    target = tmp_path / "result"
    with ResultFolder(target) as folder:
        put_result(folder, "old")
        (folder / "left_over.txt").write_text("x")
    with pytest.raises(InputError, match="force=True"), ResultFolder(target):
        pytest.fail("an existing result must be refused before any work")
    with ResultFolder(target, force=True) as folder:
        put_result(folder, "new")
    assert [path.name for path in target.iterdir()] == ["summary.json"]
    assert [path.name for path in tmp_path.iterdir()] == ["result"]


def test_an_earlier_result_goes_when_the_disk_has_the_new_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    out, waited_for, removed = tmp_path / "result", list[int](), list[Path]()
    with ResultFolder(out) as folder:
        (folder / "summary.json").write_text("{}")
    wait, remove = os.fsync, shutil.rmtree

    def recorded(number: int) -> None:
        waited_for.append(os.fstat(number).st_ino)
        wait(number)

    def removing(path: Path, **how: bool) -> None:
        if path.exists():
            places = [tmp_path, out, *out.rglob("*")]
            assert {place.stat().st_ino for place in places} <= set(waited_for)
            removed.append(path)
        remove(path, **how)

    monkeypatch.setattr(os, "fsync", recorded)
    monkeypatch.setattr(shutil, "rmtree", removing)
    with ResultFolder(out, force=True) as folder:
        (folder / "facet").mkdir()
        for name in ("summary.json", "facet/slope_map.nc"):
            (folder / name).write_text("new")
    assert len(removed) == 1
    assert (out / "summary.json").read_text() == "new"


@pytest.mark.parametrize("names", [["photo.jpg"], ["measurement.toml", "summary.json"]])
def test_force_never_removes_what_is_no_result(tmp_path: Path, names: list[str]) -> None:
    for name in names:
        (tmp_path / name).write_text("precious")
    with pytest.raises(InputError, match="something else"), ResultFolder(tmp_path, force=True):
        pytest.fail("must be refused before any work")
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(names)


def test_an_empty_folder_is_a_fine_target(tmp_path: Path) -> None:
    (tmp_path / "result").mkdir()
    with ResultFolder(tmp_path / "result") as folder:
        put_result(folder, "new")
    assert (tmp_path / "result" / "summary.json").exists()


def test_places_that_cannot_hold_a_result_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "file").write_text("x")
    for target in (tmp_path / "file", tmp_path / "file" / "result", Path("/proc/heliogauge-result")):
        with pytest.raises(InputError, match="choose another folder"), ResultFolder(target):
            pytest.fail("must be refused before any work")

    def refuse(*_: object, **__: object) -> None:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(Path, "mkdir", refuse)
    with pytest.raises(InputError, match="Permission denied"), ResultFolder(tmp_path / "result"):
        pytest.fail("must be refused before any work")


def test_results_that_appeared_meanwhile_are_not_overwritten(tmp_path: Path) -> None:
    target = tmp_path / "result"
    with pytest.raises(InputError, match="force=True"):
        be_overtaken(target)
    assert (target / "summary.json").read_text() == "first"
    assert [path.name for path in tmp_path.iterdir()] == ["result"]


def test_doubts_that_are_none_are_refused(tmp_path: Path) -> None:
    write_summary(tmp_path / "summary.json", make_summary())
    content = json.loads((tmp_path / "summary.json").read_text())
    assert content["doubts"][0]["code"] == "frames_saturated"
    assert content["doubts"][0]["severity"] == "note"
    del content["doubts"][0]["code"]
    (tmp_path / "summary.json").write_text(json.dumps(content))
    with pytest.raises(InputError, match="code"):
        read_summary(tmp_path)


@pytest.mark.parametrize(
    "text",
    [
        "name,x_m,y_m\na,1.5,2\nb,-3e-7,4\n",
        "name,x_m,y_m\r\na,1.5,2\r\nb,-3e-7,4\r\n",
        '"name",x_m,y_m\n"a",1.5,2\nb,-3e-7,4\n',
        "\ufeffy_m,name,x_m\n2,a,1.5\n\n4, b ,-3e-7",
    ],
)
def test_columns_are_read_the_same_in_every_form(tmp_path: Path, text: str) -> None:
    path = tmp_path / "table.csv"
    path.write_text(text, encoding="utf-8", newline="")
    texts, numbers = read_columns_csv(path, ("name",), ("x_m", "y_m"))
    assert texts == {"name": ["a", "b"]}
    np.testing.assert_array_equal(numbers["x_m"], [1.5, -3e-7])
    np.testing.assert_array_equal(numbers["y_m"], [2.0, 4.0])


def test_gaps_in_columns_of_numbers_are_nan(tmp_path: Path) -> None:
    write_table_csv(tmp_path / "table.csv", {"name": ["a", "b"], "x_m": [1.0, np.nan]})
    _, numbers = read_columns_csv(tmp_path / "table.csv", ("name",), ("x_m",))
    np.testing.assert_array_equal(numbers["x_m"], [1.0, np.nan])


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("name,x_m\na,much\n", "column x_m must hold numbers"),
        ("name,x_m\na,1,2\n", "line 2: 2 cells are needed"),
        ("name\na\n", "columns x_m are missing"),
    ],
)
def test_bad_columns_are_named(tmp_path: Path, text: str, words: str) -> None:
    (tmp_path / "table.csv").write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=words):
        read_columns_csv(tmp_path / "table.csv", ("name",), ("x_m",))


def test_zero_keeps_its_sign_in_a_column_of_few_numbers(tmp_path):
    column = [0.0] * 20 + [-0.0]
    write_table_csv(tmp_path / "table.csv", {"a": column, "sigma": [0.05] * 20 + [0.1]})
    read = read_table_csv(tmp_path / "table.csv")
    assert read["a"] == ["0.0"] * 20 + ["-0.0"]
    assert read["sigma"] == ["0.05"] * 20 + ["0.1"]


def test_a_row_of_other_length_is_found_in_a_plain_table(tmp_path):
    # As many cells in all as the rows should have: only the place of the lines tells.
    path = tmp_path / "table.csv"
    path.write_text("name,x_m\na,1,2\nb\n", encoding="utf-8")
    with pytest.raises(InputError, match="line 2"):
        read_columns_csv(path, ("name",), ("x_m",))
