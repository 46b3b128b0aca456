"""measurement.toml: what is accepted, and what a mistake is answered with."""

import copy
import datetime
import subprocess
import sys
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from deflectometry import load_deflectometry
from deflectometry.keys import PatternSection
from heliogauge.errors import InputError
from heliogauge.measurement.load import parse_measurement
from heliogauge.measurement.templates import write_template
from heliogauge.measurement.writer import dump_toml, write_measurement

Content = dict[str, Any]
FILE = Path("measurement.toml")


@pytest.fixture(scope="module")
def template(tmp_path_factory: pytest.TempPathFactory) -> Content:
    file = write_template("deflectometry", tmp_path_factory.mktemp("template") / "new folder")
    return tomllib.loads(file.read_text(encoding="utf-8"))


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder that loads: the template and sixteen (empty) images, counted without leading zeros."""
    write_template("deflectometry", tmp_path)
    for k in range(16):
        (tmp_path / f"fringe_{k}.png").touch()
    return tmp_path


def test_template_loads_with_its_frames_in_natural_order(folder: Path) -> None:
    measurement = load_deflectometry(folder)
    assert [path.name for path in measurement.fringe_files] == [f"fringe_{k}.png" for k in range(16)]
    assert measurement.model.mirror.focal_length_m == 10.0
    assert measurement.model.screen.sigma_rotation_mrad == (1.0, 1.0, 1.0)
    assert measurement.input_files[0] == folder / "measurement.toml"
    assert len(measurement.input_files) == 17


def test_every_optional_key_of_the_template_is_a_real_key(template: Content, tmp_path: Path) -> None:
    text = write_template("deflectometry", tmp_path).read_text(encoding="utf-8").replace("#: ", "")
    # Three places offer an alternative instead of an addition: keep one side of each.
    before, code = text.split("[pattern.gray_code]\n")
    text = before + code.split("\n\n", 1)[1]
    assert PatternSection.model_validate({"gray_code": tomllib.loads(code.split("\n\n", 1)[0])}).n_frames == 44
    text = text.replace('file = "camera.json" ', "# ").replace('file = "screen_points.csv" ', "# ")
    text = text.replace("outline_m = [[-0.6, -0.6], [0.6, -0.6], [0.6, 0.6], [-0.6, 0.6]]\n", "", 1)
    facet_outline = "outline_m = [[-0.6, -0.6]"
    assert text.count(facet_outline) == 1
    model = parse_measurement(tomllib.loads(text), FILE)
    assert model.mirror.pose is not None
    assert model.mirror.known_point[0].image_px == (1200.5, 300.25)
    assert model.mirror.facet[0].name == "A1"
    assert model.images.dark == "dark.png"
    assert model.date == datetime.date(2026, 1, 31)


Change = Callable[[Content], object]


@pytest.mark.parametrize(
    ("change", "wanted"),
    [
        (lambda c: c["camera"].update(focal_px=3), r"camera\.focal_px is not a key here; did you mean 'focal_[xy]_px'"),
        (lambda c: c["mirror"].update(focal_lenght_m=1), r"did you mean 'focal_length_m'"),
        (lambda c: c["mirror"].update(saturation_dn=1), r"mirror\.saturation_dn .* belongs to \[images\]"),
        (lambda c: c.update(camra={}), r"camra is not a key here; did you mean 'camera'"),
        (lambda c: c["camera"].update(focal_x_px=float("nan")), r"camera\.focal_x_px = nan: a finite number"),
        (lambda c: c["mirror"].update(focal_length_m=float("inf")), r"mirror\.focal_length_m = inf: a finite number"),
        (lambda c: c["camera"].update(focal_x_px="3"), r"camera\.focal_x_px = '3': a number is needed, without quotes"),
        (lambda c: c["camera"].update(width_px=True), r"camera\.width_px = True: a whole number"),
        (lambda c: c["camera"].update(width_px=0), r"camera\.width_px = 0: a value above 0"),
        (lambda c: c["camera"].update(file="a.json"), r"camera: keys of two forms are mixed, 'camera file'"),
        (lambda c: c["camera"].pop("width_px"), r"camera\.width_px is missing"),
        (
            lambda c: c["screen"].update(shape="round"),
            r"screen\.shape = 'round' is not known; say 'rectangle', 'table'",
        ),
        (lambda c: c["screen"].pop("shape"), r"screen\.shape is missing"),
        (
            lambda c: c["screen"].update(sigma_rotation_mrad=-1),
            r"screen\.sigma_rotation_mrad\[1\] = -1: .* not below 0",
        ),
        (lambda c: c["screen"].update(translation_m=[0, 0]), r"screen\.translation_m\[3\] is missing"),
        (lambda c: c["mirror"].update(design="dish"), r"mirror\.design = 'dish': say 'plane'"),
        (lambda c: c["mirror"].update(design="quadric"), r'mirror: design = "quadric" needs coefficients'),
        (lambda c: c["mirror"].update(radius_m=3), r'mirror: radius_m does not belong to design = "paraboloid"'),
        (lambda c: c["mirror"].update(outline_m=[[0, 0], [1, 1]]), r"at least 3 entries are needed, there are 2"),
        (lambda c: c["mirror"].update(facet={"name": "a"}), r"mirror\.facet = .*double brackets"),
        (lambda c: c["mirror"].update(facet=[{"name": "a"}]), r"mirror\.facet\[1\]\.outline_m is missing"),
        (lambda c: c["mirror"].pop("design"), r"mirror: "),
        (lambda c: c["pattern"]["set"][1].update(steps_deg=[1, 2]), r"pattern\.set\[2\]\.steps_deg .* at least 3"),
        (lambda c: c["pattern"]["set"][1].update(axis="z"), r"pattern\.set\[2\]\.axis = 'z': say 'x' or 'y'"),
        (lambda c: c["images"].update(fringes=3), r"images\.fringes = 3: a list is needed"),
        (lambda c: c.update(mirror=3), r"mirror = 3: a table is needed"),
        (lambda c: c.update(kind="deflectometri"), r'kind = \'deflectometri\'.*did you mean "deflectometry"'),
        (lambda c: c.update(kind="dish"), r'available are: "beam", "camera", "deflectometry"'),
        (lambda c: c.pop("kind"), r"kind is missing"),
    ],
)
def test_mistakes_name_key_value_and_remedy(template: Content, change: Change, wanted: str) -> None:
    content = copy.deepcopy(template)
    change(content)
    with pytest.raises(InputError, match=wanted) as caught:
        parse_measurement(content, FILE)
    assert str(caught.value).startswith("measurement.toml:")
    assert "pydantic" not in str(caught.value)


def test_mirror_must_be_found_somehow(template: Content) -> None:
    content = copy.deepcopy(template)
    del content["mirror"]["outline_m"], content["mirror"]["distance"]
    with pytest.raises(InputError, match="the mirror's place is not determined"):
        parse_measurement(content, FILE)
    content["mirror"]["known_point"] = [{"point_m": [k, 0, 0], "image_px": [k, 1]} for k in range(3)]
    assert len(parse_measurement(content, FILE).mirror.known_point) == 3


def test_facets_have_names_of_their_own(template: Content) -> None:
    content = copy.deepcopy(template)
    outline = content["mirror"].pop("outline_m")
    content["mirror"]["facet"] = [{"name": "A", "outline_m": outline, "position_m": [k, 0, 0]} for k in range(2)]
    with pytest.raises(InputError, match='two facets are called "A"'):
        parse_measurement(content, FILE)


def test_many_faults_are_cut_short(template: Content) -> None:
    content = copy.deepcopy(template)
    content["camera"] |= {f"unknown_{k}": 1 for k in range(9)}
    with pytest.raises(InputError, match=r"\.\.\. and 4 more"):
        parse_measurement(content, FILE)


class TestFolder:
    def test_no_folder(self, tmp_path: Path) -> None:
        with pytest.raises(InputError, match="no such folder"):
            load_deflectometry(tmp_path / "absent")

    def test_no_file(self, tmp_path: Path) -> None:
        with pytest.raises(InputError, match="heliogauge deflectometry init"):
            load_deflectometry(tmp_path)

    def test_not_toml(self, tmp_path: Path) -> None:
        (tmp_path / "measurement.toml").write_text("kind = \nname", encoding="utf-8")
        with pytest.raises(InputError, match="line 1"):
            load_deflectometry(tmp_path)

    def test_not_utf8(self, tmp_path: Path) -> None:
        (tmp_path / "measurement.toml").write_bytes('kind = "\xe4"'.encode("latin-1"))
        with pytest.raises(InputError, match="not UTF-8"):
            load_deflectometry(tmp_path)

    def test_byte_order_mark_is_no_fault(self, folder: Path) -> None:
        file = folder / "measurement.toml"
        file.write_bytes(b"\xef\xbb\xbf" + file.read_bytes())
        assert load_deflectometry(folder).model.kind == "deflectometry"

    def test_wrong_number_of_frames(self, folder: Path) -> None:
        (folder / "fringe_7.png").unlink()
        with pytest.raises(InputError, match=r"gives 15 files, but the pattern has 16 frames \(4 sets\)"):
            load_deflectometry(folder)

    def test_no_frames(self, tmp_path: Path) -> None:
        write_template("deflectometry", tmp_path)
        with pytest.raises(InputError, match=r"no file in .* matches"):
            load_deflectometry(tmp_path)

    def test_listed_frame_missing(self, folder: Path, template: Content) -> None:
        names = [f"fringe_{k}.png" for k in range(15)] + ["absent.png"]
        content = template | {"images": {"fringes": names}}
        write_measurement(folder, content)
        with pytest.raises(InputError, match=r"there is no file 'absent\.png'"):
            load_deflectometry(folder)

    def test_named_file_missing(self, folder: Path, template: Content) -> None:
        write_measurement(folder, template | {"camera": {"file": "camera.json"}})
        with pytest.raises(InputError, match=r"camera\.file = 'camera\.json': there is no such file"):
            load_deflectometry(folder)
        (folder / "camera.json").touch()
        assert folder / "camera.json" in load_deflectometry(folder).input_files


SCALARS = st.one_of(
    st.text(st.characters(exclude_categories=["Cs"])),
    st.integers(-(2**63), 2**63 - 1),
    st.floats(allow_nan=False, allow_infinity=False),
    st.booleans(),
    st.dates(),
)
KEYS = st.one_of(
    st.from_regex(r"[a-z][a-z0-9_]{0,8}", fullmatch=True),
    st.text(st.characters(exclude_categories=["Cs"]), min_size=1, max_size=4),
)
TABLES = st.recursive(
    st.dictionaries(KEYS, st.one_of(SCALARS, st.lists(SCALARS, max_size=3)), max_size=3),
    lambda inner: st.dictionaries(KEYS, st.one_of(SCALARS, inner, st.lists(inner, min_size=1, max_size=3))),
    max_leaves=12,
)


class TestWriting:
    def test_round_trip_of_a_model(self, template: Content, tmp_path: Path) -> None:
        model = parse_measurement(template, FILE)
        file = write_measurement(tmp_path / "ä b", model, comment="made by a test\nsecond line")
        text = file.read_text(encoding="utf-8")
        assert text.startswith("# made by a test\n# second line\n\nkind")
        assert parse_measurement(tomllib.loads(text), file) == model
        assert [path.name for path in file.parent.iterdir()] == ["measurement.toml"]

    def test_numpy_paths_and_none(self, template: Content, tmp_path: Path) -> None:
        content = copy.deepcopy(template)
        content["mirror"]["outline_m"] = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0 / 3.0]])
        content["camera"] = {"file": Path("cameras") / "camera.json"}
        content["images"]["dark"] = None
        content["images"]["pixel_noise_dn"] = np.float64(0.1)
        model = parse_measurement(tomllib.loads(write_measurement(tmp_path, content).read_text("utf-8")), FILE)
        assert model.mirror.outline_m == ((0.0, 0.0), (1.0, 0.0), (0.0, 1.0 / 3.0))
        assert dict(model.named_files()) == {"camera.file": "cameras/camera.json"}

    def test_nonsense_is_not_written(self, template: Content, tmp_path: Path) -> None:
        with pytest.raises(InputError, match=r"focal_length_m"):
            write_measurement(tmp_path / "new", template | {"mirror": {"design": "paraboloid"}})
        assert not (tmp_path / "new").exists()

    @pytest.mark.slow
    @given(TABLES)
    def test_any_tables_come_back(self, content: Content) -> None:
        assert tomllib.loads(dump_toml(content)) == content

    def test_not_finite_is_refused(self) -> None:
        with pytest.raises(InputError, match="nan"):
            dump_toml({"a": float("nan")})

    def test_what_toml_does_not_know_is_refused(self) -> None:
        with pytest.raises(InputError, match="type bytes"):
            dump_toml({"a": {"b": [b"1"]}})

    def test_names_that_are_no_bare_keys_come_back(self) -> None:
        content = {"camera 2.1": {"": 1, "a.b": [[{"c": 2}]]}}
        assert tomllib.loads(dump_toml(content)) == content

    def test_rows_of_numbers_stay_on_a_line(self) -> None:
        assert dump_toml({"a": [[1.0, 2.0], [3.0, 4.0]]}) == "a = [[1.0, 2.0], [3.0, 4.0]]\n"


class TestTemplate:
    def test_other_kinds_are_refused_clearly(self, tmp_path: Path) -> None:
        with pytest.raises(InputError, match="'dish' is not known; available are"):
            write_template("dish", tmp_path)

    def test_typing_error_is_recognised(self, tmp_path: Path) -> None:
        with pytest.raises(InputError, match=r"did you mean deflectometry\?"):
            write_template("deflectomtry", tmp_path)

    def test_existing_file_is_kept_unless_forced(self, tmp_path: Path) -> None:
        file = tmp_path / "measurement.toml"
        file.write_text("mine", encoding="utf-8")
        with pytest.raises(InputError, match="force=True"):
            write_template("deflectometry", tmp_path)
        assert file.read_text(encoding="utf-8") == "mine"
        write_template("deflectometry", tmp_path, force=True)
        assert "kind" in file.read_text(encoding="utf-8")

    def test_folder_that_is_a_file(self, tmp_path: Path) -> None:
        (tmp_path / "file").touch()
        with pytest.raises(InputError, match="cannot be made a folder"):
            write_template("deflectometry", tmp_path / "file")


def test_reading_is_cheap() -> None:
    """Nothing is imported for a measurement file that takes longer than pydantic, which nobody can avoid."""
    program = """
import sys, tomllib
from pathlib import Path
from heliogauge.measurement.load import parse_measurement
from heliogauge.instruments import read_resource
parse_measurement(tomllib.loads(read_resource("deflectometry:template.toml")), Path("measurement.toml"))
heavy = {"cv2", "scipy", "h5py", "xarray", "matplotlib", "pvlib", "pandas", "skimage"} & sys.modules.keys()
sys.exit(f"imported: {sorted(heavy)}" if heavy else 0)
"""
    answer = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert answer.returncode == 0, answer.stderr


@pytest.mark.parametrize("key", ["row_step_mm", "column_step_mm"])
def test_nodes_of_a_trough_that_are_metres_apart_are_refused_by_their_key(key: str, tmp_path: Path) -> None:
    # 3 m between rows ended in a doubt about the absorber's diameter.
    content = tomllib.loads(write_template("observer", tmp_path / "new folder").read_text(encoding="utf-8"))
    content["evaluation"] = {key: 3000.0}
    with pytest.raises(InputError, match=rf"{key}.*3000 mm between nodes .* too coarse: at most 500 mm"):
        parse_measurement(content, FILE)
