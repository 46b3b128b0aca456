"""``heliogauge check``: all that is wrong with a measurement folder, before measuring, without writing anything."""

import re
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest

import heliogauge as hg
from heliogauge.running import cli
from heliogauge.running.check import check_folder
from heliogauge.running.progress import SilentProgress


def faults(folder: Path) -> list[str]:
    return check_folder(folder, SilentProgress(), jobs=1)[1].faults


@pytest.fixture(scope="module")
def drawn(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    root = tmp_path_factory.mktemp("check")
    return {
        "deflectometry": hg.synth("deflectometry", root / "deflectometry"),
        "heliostat": hg.synth("heliostat", root / "heliostat"),
    }


@pytest.fixture
def facet(drawn: dict[str, Path], tmp_path: Path) -> Path:
    return Path(shutil.copytree(drawn["deflectometry"], tmp_path / "facet"))


def change(folder: Path, pattern: str, new: str) -> None:
    file = folder / "measurement.toml"
    text, count = re.subn(pattern, new, file.read_text(encoding="utf-8"), flags=re.MULTILINE)
    assert count, pattern
    file.write_text(text, encoding="utf-8")


def fringes(folder: Path) -> list[Path]:
    return sorted(folder.glob("fringe*.png"))


@pytest.mark.parametrize("name", ["deflectometry", "heliostat"])
def test_a_good_folder_passes_and_stays_as_it_is(
    drawn: dict[str, Path], name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    before = {path: path.stat().st_mtime_ns for path in drawn[name].rglob("*")}
    with pytest.raises(SystemExit) as ended:
        cli.main(["check", str(drawn[name])])
    assert ended.value.code == 0
    said = capsys.readouterr()
    assert "nothing wrong was found" in said.out
    assert "error" not in said.err
    assert {path: path.stat().st_mtime_ns for path in drawn[name].rglob("*")} == before


def test_all_faults_are_said_at_once(facet: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A mistyped key, a damaged image and one of another size: none hides another."""
    one, two, *_ = fringes(facet)
    one.write_bytes(one.read_bytes()[:300])
    cv2.imwrite(str(two), np.zeros((20, 30), np.uint8))
    change(facet, r"^name = ", "nmae = ")
    change(facet, r"^(\[mirror\])", r"\1\nroll_degr = 3.0")
    with pytest.raises(SystemExit) as ended:
        cli.main(["check", str(facet)])
    assert ended.value.code == 2
    said = capsys.readouterr().err
    assert one.name in said
    assert "did you mean 'name'" in said
    assert "did you mean 'roll_deg'" in said
    assert "Traceback" not in said


def test_set_up_and_images_are_checked_together(facet: Path) -> None:
    one, two, three, *_ = fringes(facet)
    one.write_bytes(one.read_bytes()[:300])
    cv2.imwrite(str(two), np.zeros((20, 30), np.uint8))
    (fringes(facet)[5]).write_bytes(three.read_bytes())
    change(facet, r"^width_px = \d+", "width_px = 640")
    found = faults(facet)
    assert len(found) == 4, found
    assert one.name in found[0]
    assert two.name in found[1]
    assert f"{fringes(facet)[5].name} of {three.name}" in found[2]
    assert "640" in found[3]


def test_every_file_that_is_missing_is_named(facet: Path) -> None:
    change(facet, r"^dark = .*", 'dark = "night.png"')
    change(facet, r"^bright = .*", 'bright = "day.png"')
    (found,) = [text for text in faults(facet) if "measurement.toml: images" in text]
    assert "night.png" in found
    assert "day.png" in found


def test_missing_photos_do_not_hide_missing_tables(tmp_path: Path) -> None:
    """A fresh template names photos, a camera's file and a list of targets, of which none is there; each once."""
    with pytest.raises(SystemExit) as ended:
        cli.main(["observer", "init", str(tmp_path / "trough")])
    assert ended.value.code == 0
    photos, tables = faults(tmp_path / "trough")
    assert "images.photos" in photos
    assert "there is no file camera.json, targets.csv in" in tables
    (tmp_path / "trough" / "a.jpg").write_bytes(b"")
    told = "\n".join(faults(tmp_path / "trough"))
    assert (told.count("camera.json"), told.count("targets.csv")) == (1, 1)


def test_missing_files_are_named_wherever_they_would_be_and_however_short_their_names(tmp_path: Path) -> None:
    folder = tmp_path / "trough"
    with pytest.raises(SystemExit):
        cli.main(["observer", "init", str(folder)])
    change(folder, r'"camera\.json"', '"/nowhere/camera.json"')
    change(folder, r'"targets\.csv"', '"t"')
    _, tables = faults(folder)
    assert "there is no file /nowhere/camera.json, t in" in tables


@pytest.mark.slow
def test_frames_in_the_wrong_order_are_found(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The dry run looks at what the frames show, as the measurement would."""
    with pytest.raises(SystemExit):
        cli.main(["deflectometry", "synth", str(tmp_path / "m"), "--fault", "swapped:7", "-q"])
    with pytest.raises(SystemExit) as ended:
        cli.main(["check", str(tmp_path / "m")])
    assert ended.value.code == 0
    assert "frames 7, 8 show each other's fringes" in " ".join(capsys.readouterr().err.split())


def test_doubts_are_no_faults(drawn: dict[str, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = Path(shutil.copytree(drawn["deflectometry"], tmp_path / "jpeg"))
    for file in fringes(folder):
        cv2.imwrite(str(file.with_suffix(".jpg")), cv2.imread(str(file), cv2.IMREAD_UNCHANGED), [1, 100])
        file.unlink()
    change(folder, r"\.png", ".jpg")
    for name in ("dark", "bright"):
        cv2.imwrite(str(folder / f"{name}.jpg"), cv2.imread(str(folder / f"{name}.png"), cv2.IMREAD_UNCHANGED))
    with pytest.raises(SystemExit) as ended:
        cli.main(["check", str(folder)])
    assert ended.value.code == 0
    assert "warning: 32 of 32 fringe images are JPEG" in capsys.readouterr().err


def test_each_heliostat_is_looked_at(drawn: dict[str, Path], tmp_path: Path) -> None:
    folder = Path(shutil.copytree(drawn["heliostat"], tmp_path / "plant"))
    file = folder / "observations.csv"
    lines = file.read_text(encoding="utf-8").splitlines()
    header = lines[0].split(",")
    for row, name in ((5, "H01"), (70, "H02")):
        cells = lines[row].split(",")
        assert cells[header.index("heliostat")] == name
        cells[header.index("time_utc")] = "noon"
        lines[row] = ",".join(cells)
    file.write_text("\n".join(lines), encoding="utf-8")
    names = folder / "heliostats.csv"
    names.write_text(names.read_text(encoding="utf-8").replace("H03,", "H03,far"), encoding="utf-8")
    _, findings = check_folder(folder, SilentProgress(), jobs=1)
    (fault,) = findings.faults
    assert "H03" in fault
    assert [doubt.text.partition(":")[0] for doubt in findings.doubts] == ["H01", "H02"]


@pytest.mark.parametrize("text", ["", "kind = 'telescope'", "kind = "])
def test_what_is_no_measurement_is_one_fault(text: str, tmp_path: Path) -> None:
    (tmp_path / "measurement.toml").write_text(text, encoding="utf-8")
    assert len(faults(tmp_path)) == 1


@pytest.mark.slow
def test_too_few_photos(tmp_path: Path) -> None:
    with pytest.raises(SystemExit):
        cli.main(["camera", "synth", str(tmp_path / "m"), "--photos", "2", "--scale", "0.2", "-q"])
    assert faults(tmp_path / "m") == ["2 photos; a calibration needs 3 at least: take more"]
