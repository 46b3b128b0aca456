"""Pictures of a run that failed: ``OUT-failed/`` beside the place of the results, with one page that shows why."""

import html
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np
import numpy.typing as npt

from heliogauge.errors import FailurePicture, InputError, MetrologyError
from heliogauge.results.whole_folder import FolderKind, WholeFolder

if TYPE_CHECKING:
    from heliogauge.view.photos import Photo

PAGE = "why.html"
FAILURE = FolderKind(content="pictures of a failed run", mark=PAGE, strangers=frozenset({"measurement.toml"}))

# Darkest and brightest pixels that are spread over all grey values, so that dark photographs show something.
_SPREAD_PERCENT = (0.5, 99.8)
_MOST_PIXELS = 1600
_QUALITY = 85


@contextmanager
def pictures_of_failure(out: Path) -> Iterator[None]:
    """Write the pictures that an error of the work within carries, and name their page in its message.

    out: Where the results would stand. Pictures of an earlier failure are replaced, and removed when the work is done.
    """
    folder = failure_folder(out)
    try:
        yield
    except MetrologyError as error:
        # Whatever goes wrong here must not hide what went wrong before.
        with suppress(OSError, InputError):
            if page := write_failure(folder, error):
                error.args = (f"{error}\nwhat was seen: {page}",)
        raise
    if (folder / PAGE).is_file():
        shutil.rmtree(folder, ignore_errors=True)


def failure_folder(out: Path) -> Path:
    """Return where the pictures of a failed run stand.

    >>> failure_folder(Path("results/facet")).as_posix()
    'results/facet-failed'
    """
    whole = out if out.name else out.absolute()
    return whole.with_name(f"{whole.name}-failed")


def write_failure(folder: Path, error: MetrologyError) -> Path | None:
    """Write the pictures of an error and a page with its message.

    Returns: The page; None where no error in the chain carries a picture.
    """
    pictures = _pictures(error)
    if not pictures:
        return None
    from heliogauge.reporting.html import in_page
    from heliogauge.reporting.notebook import ShownCell
    from heliogauge.reporting.page_frame import page_frame
    from heliogauge.view.arrays import PAGE as IN_PAGE
    from heliogauge.view.photos import PhotoView

    images = [grey_of(one.image) for one in pictures]
    with WholeFolder(folder, FAILURE, force=True) as working:
        for number, (one, image) in enumerate(zip(pictures, images, strict=True), start=1):
            _, data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])
            name = "".join(letter if letter.isalnum() or letter in "-_." else "-" for letter in Path(one.name).stem)
            (working / f"{number:02d}-{name[:60]}.jpg").write_bytes(data.tobytes())
        said = "".join(f"<p>{html.escape(line)}</p>" for line in str(error).splitlines())
        box = f'<div class="answer"><div class="verdict failed"><strong>Why</strong>{said}</div></div>'
        view = PhotoView(
            "What was seen", tuple(_photo(one, image) for one, image in zip(pictures, images, strict=True))
        )
        seen = f'<div class="picture">{in_page(view, IN_PAGE)}</div>'
        cell = ShownCell(f'<h1>No result</h1><div class="first">{box}{seen}</div>', printed=True)
        (working / PAGE).write_text(page_frame("No result", [cell]), encoding="utf-8")
    return folder / PAGE


def grey_of(image: npt.NDArray[np.generic] | bytes, most_px: int = _MOST_PIXELS) -> npt.NDArray[np.uint8]:
    """Return an image or a JPEG file as grey values from black to white, not larger than is looked at.

    most_px: Longer side of the largest picture; a JPEG file stays as it is [px].
    """
    if isinstance(image, bytes):
        return np.asarray(cv2.imdecode(np.frombuffer(image, np.uint8), cv2.IMREAD_GRAYSCALE), dtype=np.uint8)
    values = np.asarray(image, dtype=np.float32)
    share = min(most_px / max(values.shape), 1.0)
    if share < 1.0:
        values = np.asarray(cv2.resize(values, None, fx=share, fy=share, interpolation=cv2.INTER_AREA))
    known = values[np.isfinite(values)]
    low, high = np.percentile(known, _SPREAD_PERCENT) if known.size else (0.0, 1.0)
    scaled = (np.nan_to_num(values, nan=float(low)) - low) * (255 / max(float(high - low), 1e-6))
    return np.clip(scaled, 0, 255).astype(np.uint8)


def _photo(one: FailurePicture, image: npt.NDArray[np.uint8]) -> "Photo":
    from heliogauge.view.photos import Photo, PhotoLines, PhotoMarks

    if one.size_px is not None:
        width, height = one.size_px
    else:
        height, width = image.shape if isinstance(one.image, bytes) else one.image.shape
    points = np.asarray(one.points_px, dtype=np.float64).reshape(-1, 2)
    marks = (PhotoMarks("found", points, "#d94f30", one.labels),) if len(points) else ()
    lines = (PhotoLines("expected", list(one.lines_px), "#1b6ca8"),) if one.lines_px else ()
    return Photo(one.name, width, height, image, marks, lines, one.note)


def _pictures(error: BaseException) -> tuple[FailurePicture, ...]:
    """Return the pictures of an error, or of the one that it was raised from."""
    while isinstance(error, MetrologyError):
        if error.pictures:
            return error.pictures
        if error.__cause__ is None:
            break
        error = error.__cause__
    return ()
