"""Targets of photos through measurement.toml's section: codes of one's own, the sense of counting, unknown codes."""

from pathlib import Path

import numpy as np
import pytest

from data_synth.isolated_target import IsolatedTarget, draw_isolated
from heliogauge.errors import EstimationError, InputError
from heliogauge.images import write_image
from heliogauge.measurement_targets import TargetsSection
from heliogauge.progress import SilentProgress
from photogrammetry.coded_targets import RingRadii, Sense, aicon_dictionary, mirrored_word
from photogrammetry.pipeline_inputs import build_search
from photogrammetry.pipeline_photos import MeasuredPhotos, gathered, measure_each

#: Words that are not their own mirror image and whose mirror image is not among them.
CHIRAL = [word for word in aicon_dictionary(12).words if word < mirrored_word(word, 12)][:6]


def photo(folder: Path, sense: Sense, radii: RingRadii) -> Path:
    """Six targets side by side."""
    codes = aicon_dictionary(12).as_printed(sense, radii).codes
    chosen = [code for code in codes if code.word in CHIRAL]
    drawn = [
        draw_isolated(IsolatedTarget(18.0, code=code), np.random.default_rng(k)).image_dn
        for k, code in enumerate(chosen)
    ]
    path = folder / "photo.png"
    write_image(path, np.rint(np.vstack([np.hstack(drawn[:3]), np.hstack(drawn[3:])])).clip(0, 255).astype(np.uint8))
    return path


def measured(path: Path, **keys: object) -> MeasuredPhotos:
    section = TargetsSection.model_validate(keys)
    search = build_search(section, path.parent)
    return gathered(measure_each([path], section, search, jobs=1, progress=SilentProgress()))


def own_list(folder: Path, *lines: str) -> None:
    (folder / "own.csv").write_text("\n".join(["# bits = 12", *lines, "word", *map(str, CHIRAL)]), encoding="utf-8")


def test_codes_of_one_s_own_are_read_by_name(tmp_path: Path) -> None:
    path = photo(tmp_path, Sense.COUNTERCLOCKWISE, RingRadii(1.8, 2.6))
    own_list(tmp_path, "# sense = counterclockwise", "# inner_radius = 1.8", "# outer_radius = 2.6")
    found = measured(path, dictionary="own.csv")
    assert sorted(found.points.targets, key=int) == [str(word) for word in CHIRAL]


def test_keys_of_the_measurement_win_over_the_list(tmp_path: Path) -> None:
    path = photo(tmp_path, Sense.COUNTERCLOCKWISE, RingRadii(1.8, 2.6))
    own_list(tmp_path)
    keys = {"sense": "counterclockwise", "ring_inner_radius": 1.8, "ring_outer_radius": 2.6}
    assert len(measured(path, dictionary="own.csv", **keys).points.targets) == 6


def test_the_wrong_sense_ends_with_the_key_to_set(tmp_path: Path) -> None:
    path = photo(tmp_path, Sense.COUNTERCLOCKWISE, RingRadii())
    own_list(tmp_path)
    with pytest.raises(EstimationError, match=r'6 of 6 code rings.*mirror images.*sense = "counterclockwise"'):
        measured(path, dictionary="own.csv")


def test_codes_of_another_list_are_told_by_their_bits(tmp_path: Path) -> None:
    path = photo(tmp_path, Sense.CLOCKWISE, RingRadii())
    (tmp_path / "own.csv").write_text("# bits = 12\nword\n1\n3\n", encoding="utf-8")
    with pytest.raises(EstimationError, match="6 code rings are not in the dictionary, bits clockwise"):
        measured(path, dictionary="own.csv")


def test_a_list_that_is_not_there_is_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"own\.csv: there is no such file"):
        build_search(TargetsSection(dictionary="own.csv"), tmp_path)
