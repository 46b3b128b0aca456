"""How photos are encoded, decided by odds from all that it takes, for each kind of file."""

import shutil
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from data_synth.troughs import TroughChoice, TroughOptions, trough_scene, write_trough_dataset
from heliogauge.measurement.load import load
from heliogauge.running.progress import SilentProgress
from observer.photo_edges.tone import Tone, ToneEvidence, tone_evidence
from observer.pipeline.inputs import Inputs, read_inputs
from observer.pipeline.reading.photos import look_first
from observer.pipeline.reading.tone import Encoding, Encodings, find_encodings

NO_EDGES = np.zeros((0, 13))
LINEAR, SRGB, NOTHING = (1.0, 1.08), (0.93, 1.0), None
Change = Callable[[np.ndarray, np.random.Generator], np.ndarray]


def evidence(sizes: tuple[float, float] | None, seed: int) -> ToneEvidence:
    rng = np.random.default_rng(seed)
    ratios = np.zeros((2, 0)) if sizes is None else np.add.outer(sizes, rng.normal(0, 0.004, 12))
    return tone_evidence(NO_EDGES, NO_EDGES, ratios)


def found(photos: dict[str, tuple[float, float] | None]) -> tuple[Encodings, list[str]]:
    """Decide, and return what was looked at."""
    looked: list[str] = []

    def look(file: Path) -> ToneEvidence:
        looked.append(file.name)
        return evidence(photos[file.name], len(looked))

    return find_encodings([Path(name) for name in photos], look), looked


def codes(encodings: Encodings) -> list[str]:
    return [one.code for one in encodings.doubts]


def test_three_clear_photos_are_enough() -> None:
    encodings, looked = found({f"{k:03d}.png": LINEAR for k in range(60)})
    assert len(looked) == 3
    assert encodings.tone_of("007.png") is Tone.LINEAR
    assert not codes(encodings)
    assert encodings.text().startswith(".png files are linear (")
    assert encodings.text().endswith("from 36 sizes of targets and 0 edges of the reflection in 3 photos)")


def test_photos_that_stay_unclear_are_not_all_looked_at() -> None:
    # As unlikely under one encoding as under the other: a wrong diameter, say.
    encodings, looked = found({f"{k:03d}.png": (0.96, 1.04) for k in range(400)})
    assert 6 <= len(looked) <= 24
    assert codes(encodings) == ["encoding_unclear"]


def test_all_photos_are_looked_at_where_the_first_say_nothing() -> None:
    photos = {f"{k:03d}.png": NOTHING for k in range(60)} | {"057.png": SRGB}
    encodings, looked = found(photos)
    assert "057.png" in looked
    assert encodings.tone_of("000.png") is Tone.SRGB


def test_what_nothing_shows_is_said_and_jpeg_are_made_for_the_eye() -> None:
    encodings, looked = found(dict.fromkeys(["1.png", "2.png"], NOTHING))
    assert sorted(looked) == ["1.png", "2.png"]
    assert codes(encodings) == ["encoding_unclear"]
    encodings, _ = found(dict.fromkeys(["1.JPG", "2.jpeg"], NOTHING))
    assert encodings.tone_of("1.JPG") is encodings.tone_of("2.jpeg") is Tone.SRGB
    assert not codes(encodings)
    # Photos overrule the kind of file.
    encodings, _ = found({f"{k}.jpg": LINEAR for k in range(9)})
    assert encodings.tone_of("0.jpg") is Tone.LINEAR


def test_the_other_encoding_has_what_the_odds_leave_it() -> None:
    unclear = Encodings((Encoding(".png", Tone.SRGB, float(np.log(3.0))), Encoding(".jpg", Tone.SRGB, 4.0)))
    assert unclear.other_probability("1.PNG") == pytest.approx(0.25)
    # Clear, stated, or each photo judged by itself.
    mixed = Encoding("", Tone.LINEAR, 0.1, own={"2.tif": Tone.SRGB})
    for one in (unclear, Encodings((Encoding("", Tone.LINEAR),)), Encodings((mixed,))):
        assert one.other_probability("1.jpg") == 0


def test_kinds_of_files_in_one_folder_are_judged_apart() -> None:
    encodings, _ = found({f"{k}.png": LINEAR for k in range(6)} | {f"{k}.jpg": SRGB for k in range(6)})
    assert encodings.tone_of("3.png") is Tone.LINEAR
    assert encodings.tone_of("3.jpg") is Tone.SRGB
    assert not codes(encodings)


def test_photos_of_one_kind_that_contradict_each_other_are_each_judged_and_named() -> None:
    encodings, looked = found({f"{k:02d}.png": SRGB if k in (6, 7) else LINEAR for k in range(12)})
    assert sorted(looked) == [f"{k:02d}.png" for k in range(12)]
    assert [encodings.tone_of(f"{k:02d}.png") for k in (5, 6, 7, 8)] == [Tone.LINEAR, Tone.SRGB, Tone.SRGB, Tone.LINEAR]
    assert codes(encodings) == ["encodings_differ"]
    assert "06.png, 07.png" in str(encodings.doubts[0])


@pytest.fixture(scope="module")
def drawn(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("encoding") / "flight"
    write_trough_dataset(folder, trough_scene("small", TroughChoice(3, n_photos=6)), TroughOptions(3))
    return folder


def for_the_eye(light: np.ndarray, _: np.random.Generator) -> np.ndarray:
    return np.where(light <= 0.0031308, 12.92 * light, 1.055 * np.maximum(light, 0.0) ** (1 / 2.4) - 0.055)


def noisy(light: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    return light + rng.normal(0, 6 / 255, light.shape)


def changed(drawn: Path, folder: Path, *changes: Change, encoding: str = "auto") -> Inputs:
    """Write the flight with all photos changed, and read it as the command does."""
    shutil.copytree(drawn, folder)
    rng = np.random.default_rng(0)
    for file in sorted(folder.glob("photo_*.png")):
        stored = cv2.imread(str(file), cv2.IMREAD_UNCHANGED)
        light = (stored + rng.uniform(-0.5, 0.5, stored.shape)) / 255
        for change in changes:
            light = change(light, rng)
        cv2.imwrite(str(file), np.rint(255 * light).clip(0, 255).astype(np.uint8))
    toml = folder / "measurement.toml"
    toml.write_text(toml.read_text().replace("[images]", f'[images]\nencoding = "{encoding}"'))
    return read_inputs(load(folder), SilentProgress())


@pytest.mark.slow
@pytest.mark.parametrize(
    ("changes", "tone"),
    [((), Tone.LINEAR), ((for_the_eye,), Tone.SRGB), ((noisy,), Tone.LINEAR), ((noisy, for_the_eye), Tone.SRGB)],
)
def test_drawn_files(drawn: Path, tmp_path: Path, changes: tuple[Change, ...], tone: Tone) -> None:
    inputs = changed(drawn, tmp_path / "flight", *changes)
    files = inputs.survey.photo_files
    first = look_first(files, inputs.finder, jobs=1, progress=SilentProgress())
    assert first.encodings is not None
    assert {first.encodings.tone_of(file.name) for file in files} == {tone}
    assert not codes(first.encodings)
    assert len(first.poses) == len(files)


@pytest.mark.slow
def test_no_photo_is_lost_by_a_wrong_encoding(drawn: Path, tmp_path: Path) -> None:
    # Linear and dark: decoded once more no code is found in them, only in the numbers as they are stored.
    inputs = changed(drawn, tmp_path / "flight", lambda light, _: 0.2 * light, encoding="srgb")
    first = look_first(inputs.survey.photo_files, inputs.finder, jobs=1, progress=SilentProgress())
    assert len(first.poses) == len(inputs.survey.photo_files)
