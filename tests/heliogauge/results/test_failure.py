"""A failed run leaves the pictures that show why, and nothing else."""

import pickle
from pathlib import Path

import cv2
import numpy as np
import pytest

from heliogauge.errors import MOST_PICTURES, EstimationError, FailurePicture, InputError, MetrologyError, showing
from heliogauge.images.thumbnails import make_thumbnail
from heliogauge.results.failure import failure_folder, pictures_of_failure
from heliogauge.results.whole_folder import FolderKind, WholeFolder

DARK = np.zeros((30, 40), dtype=np.uint16)
DARK[10:20, 10:30] = 300


def picture(name: str = "IMG 1.jpg") -> FailurePicture:
    return FailurePicture(name, DARK, "no outline <found>", None, [[10.0, 10.0]], ["edge"], [[[0, 0], [39, 29]]])


def fail(out: Path, *pictures: FailurePicture) -> EstimationError:
    with pytest.raises(EstimationError) as caught, pictures_of_failure(out), showing(lambda: pictures):
        raise EstimationError("no <mirror> found")
    return caught.value


def test_the_message_names_the_page_and_the_page_shows_the_picture(tmp_path: Path) -> None:
    error = fail(tmp_path / "facet", picture())
    page = tmp_path / "facet-failed" / "why.html"
    assert str(error) == f"no <mirror> found\nwhat was seen: {page}"
    text = page.read_text(encoding="utf-8")
    assert "no &lt;mirror&gt; found" in text
    assert 'data-view="photo"' in text
    assert "<found>" not in text
    images = sorted(page.parent.glob("*.jpg"))
    assert [image.name for image in images] == ["01-IMG-1.jpg"]
    shown = cv2.imread(str(images[0]), cv2.IMREAD_GRAYSCALE)
    # Dark photographs are spread from black to white.
    assert shown.shape == DARK.shape
    assert shown.max() > 240


def test_without_pictures_nothing_is_left(tmp_path: Path) -> None:
    assert str(fail(tmp_path / "facet")) == "no <mirror> found"
    assert not list(tmp_path.iterdir())


def test_the_next_failure_replaces_it_and_success_removes_it(tmp_path: Path) -> None:
    out = tmp_path / "facet"
    fail(out, picture("a.png"), picture("b.png"))
    fail(out, picture("c.png"))
    assert [image.name for image in failure_folder(out).glob("*.jpg")] == ["01-c.jpg"]
    with pictures_of_failure(out):
        pass
    assert not list(tmp_path.iterdir())


def test_a_folder_of_the_users_is_never_touched(tmp_path: Path) -> None:
    own = tmp_path / "facet-failed"
    own.mkdir()
    (own / "photo.jpg").write_bytes(b"mine")
    assert str(fail(tmp_path / "facet", picture())) == "no <mirror> found"
    with pictures_of_failure(tmp_path / "facet"):
        pass
    assert (own / "photo.jpg").read_bytes() == b"mine"


def test_pictures_survive_another_wording_and_the_way_between_processes(tmp_path: Path) -> None:
    with pytest.raises(InputError) as caught, pictures_of_failure(tmp_path / "out"):
        try:
            with showing(lambda: [picture()]):
                raise EstimationError("first")
        except MetrologyError as error:
            raise InputError("second") from error
    assert "why.html" in str(caught.value)
    error = fail(tmp_path / "x", picture())
    assert pickle.loads(pickle.dumps(error)).pictures[0].note == picture().note


def test_the_first_pictures_stay_and_their_number_is_bounded() -> None:
    many = (picture(str(number)) for number in range(100))
    with pytest.raises(EstimationError) as caught, showing(lambda: [picture("outer")]), showing(lambda: many):
        raise EstimationError("no")
    assert [one.name for one in caught.value.pictures] == [str(number) for number in range(MOST_PICTURES)]


def test_thumbnails_keep_the_places_of_the_photo(tmp_path: Path) -> None:
    photo = np.tile(np.arange(2000, dtype=np.uint16), (1000, 1))
    small = FailurePicture("p", make_thumbnail(photo), "none", (2000, 1000), [[1999.0, 999.0]])
    fail(tmp_path / "o", small)
    text = (tmp_path / "o-failed" / "why.html").read_text(encoding="utf-8")
    assert '"size":[2000,1000]' in text


def test_work_that_succeeds_calls_for_no_pictures(tmp_path: Path) -> None:
    with pictures_of_failure(tmp_path / "o"), showing(lambda: pytest.fail("asked for pictures")):
        pass


def test_a_folder_that_is_not_whole_is_left_with_its_pictures(tmp_path: Path) -> None:
    """As in `into_folder`: the folder of results goes, the pictures stay."""
    out = tmp_path / "out"
    kind = FolderKind("results", "summary.json")
    with pytest.raises(EstimationError), pictures_of_failure(out), WholeFolder(out, kind) as working:
        (working / "half.csv").write_text("x")
        with showing(lambda: [picture()]):
            raise EstimationError("no")
    assert [one.name for one in tmp_path.iterdir()] == ["out-failed"]


def test_the_folder_one_is_in_has_its_pictures_beside_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert failure_folder(Path(".")) == tmp_path.with_name(f"{tmp_path.name}-failed")
