"""Photos with what was found in them: detections, residual vectors, and what was refused and why."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
import numpy.typing as npt

from heliogauge.errors import InputError
from heliogauge.files.extras import of_extra
from heliogauge.reporting.html import Html
from heliogauge.reporting.look import FAINT, INK, LINE_Y
from heliogauge.validate import FloatArray
from heliogauge.view.arrays import PAGE, ArrayStore
from heliogauge.view.markup import view_frame
from heliogauge.view.stills import WIDE_PX, LegendEntry, Sheet, fitted_sheet, side_by_side

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# 1000 px fill the page's width; 30 photos of that size at this quality take 2 MB.
MOST_PIXELS_IN_PAGE = 1000
_JPEG_QUALITY = 70
# A hundredth of a pixel in places, a thousandth in residuals: below what a photo's centres are worth.
_PLACE_STEP_PX = 0.01
_RESIDUAL_STEP_PX = 0.001
#: Marks of one kind that are drawn as circles and arrows in a still picture; more are dots, and some have arrows.
_MOST_RINGS = 1000


@dataclass(frozen=True, slots=True, eq=False)
class PhotoMarks:
    """Points of one kind in a photo.

    name: What they are ("used", "refused"); the legend shows it.
    xy_px (n, 2): Places in the full photo, (0, 0) the centre of the first pixel [px].
    color: As ``#rrggbb``.
    labels: Name of each, and the reason where it was refused; empty: none.
    residual_px (n, 2): Measured minus predicted place [px]; None where there is none.
    refused: Drawn as crosses instead of circles.
    """

    name: str
    xy_px: FloatArray
    color: str
    labels: Sequence[str] = ()
    residual_px: FloatArray | None = None
    refused: bool = False


def refused_marks(name: str, table: Mapping[str, Sequence[str]], color: str) -> dict[str, PhotoMarks]:
    """Return the marks of refused points by photo, each with its reason.

    name: What they are; the legend shows it.
    table: Columns ``name``, ``reason``, ``image``, ``x_px``, ``y_px`` as texts; rows without photo or place are left
        out.
    """
    rows: dict[str, list[int]] = {}
    for row, (image, x, y) in enumerate(zip(*(table.get(key, ()) for key in ("image", "x_px", "y_px")), strict=True)):
        if image and x and y and np.isfinite([float(x), float(y)]).all():
            rows.setdefault(image, []).append(row)
    return {
        image: PhotoMarks(
            name,
            np.array([[float(table[f"{axis}_px"][row]) for axis in "xy"] for row in own]),
            color,
            [f"{table['name'][row]}: {table['reason'][row]}" for row in own],
            refused=True,
        )
        for image, own in rows.items()
    }


@dataclass(frozen=True, slots=True, eq=False)
class PhotoLines:
    """Lines in a photo: outlines, edges, predicted contours.

    name: What they are; the legend shows it.
    lines: Vertices of each, shape (n, 2) [px].
    color: As ``#rrggbb``.
    """

    name: str
    lines: Sequence[FloatArray]
    color: str


@dataclass(frozen=True, slots=True, eq=False)
class Photo:
    """One photo with its marks.

    name: Name of the photo.
    width_px, height_px: Size of the full photo [px].
    image (rows, columns) or (rows, columns, 3): Grey or RGB values of 8 bits, reduced as the caller likes; None where
        the photo is not at hand: the marks stand on an empty sheet.
    marks, lines: What was found.
    note: A line under it.
    mark: Name of the photo's place in the page, where links such as "#photo-DSC_0041" lead; empty: none.
    InputError: Labels or residuals do not fit the points.
    """

    name: str
    width_px: float
    height_px: float
    image: npt.NDArray[np.uint8] | None
    marks: tuple[PhotoMarks, ...] = ()
    lines: tuple[PhotoLines, ...] = ()
    note: str = ""
    mark: str = ""

    def __post_init__(self) -> None:
        for one in self.marks:
            count = len(one.xy_px)
            if len(one.labels) not in (0, count) or (one.residual_px is not None and len(one.residual_px) != count):
                raise InputError(f"photo {self.name}: {one.name}: labels or residuals do not fit {count} points")


@dataclass(frozen=True, eq=False)
class PhotoView:
    """Photos of one measurement, one shown at a time.

    name: What they show.
    photos: At least one.
    stills: Still pictures that stand for it in notebook and print; empty: drawn here.
    InputError: No photo.
    """

    name: str
    photos: tuple[Photo, ...]
    stills: Sequence[Html] = ()

    def __post_init__(self) -> None:
        if not self.photos:
            raise InputError(f"photos {self.name}: there is no photo to show")

    @cached_property
    def static(self) -> Html:
        """The still pictures, drawn once."""
        return side_by_side(self.stills or [self.photo_still(0)])

    def _repr_html_(self) -> str:
        return self.static.text

    def page_html(self, store: ArrayStore = PAGE) -> str:
        """Return the view for a page."""
        spec = {"name": self.name, "photos": [_photo_spec(photo, store) for photo in self.photos]}
        return view_frame("photo", self.name, spec, self.static)

    def figure(self) -> "Figure":
        """Draw the first photo with its marks.

        InputError: matplotlib is not installed.
        """
        of_extra("matplotlib")
        from heliogauge.reporting.canvas import WIDTH_IN, add_title, axes_in_inches, new_figure

        photo = self.photos[0]
        width = 1.6 * WIDTH_IN - 0.8
        height = min(width * photo.height_px / photo.width_px, 5.0)
        figure = new_figure(height + 1.1, 1.6 * WIDTH_IN)
        axes = axes_in_inches(figure, 0.65, 0.5, width, height)
        extent = (-0.5, photo.width_px - 0.5, photo.height_px - 0.5, -0.5)
        if photo.image is not None:
            axes.imshow(_reduced(photo.image, MOST_PIXELS_IN_PAGE), cmap="gray", vmin=0, vmax=255, extent=extent)
        axes.set_xlim(extent[:2])
        axes.set_ylim(extent[2:])
        axes.set_aspect("equal")
        for lines in photo.lines:
            for line in lines.lines:
                axes.plot(*np.asarray(line).T, color=lines.color, linewidth=0.8)
        for marks in photo.marks:
            kind = "x" if marks.refused else "o"
            x, y = np.asarray(marks.xy_px, dtype=np.float64).reshape(-1, 2).T
            axes.plot(x, y, kind, color=marks.color, markersize=3, markerfacecolor="none", markeredgewidth=0.6)
            if marks.residual_px is not None and len(marks.residual_px):
                scale = arrow_scale(photo)
                u, v = np.asarray(marks.residual_px).T * scale
                axes.quiver(x, y, u, v, color=LINE_Y, angles="xy", scale_units="xy", scale=1, width=0.002)
        counts = ", ".join(f"{len(one.xy_px)} {one.name}" for one in photo.marks)
        add_title(figure, f"{self.name}: {photo.name}", "; ".join(filter(None, (counts, photo.note))))
        axes.set_xlabel("column [px]", fontsize=8, color=INK, labelpad=2)
        axes.set_ylabel("row [px]", fontsize=8, color=FAINT, labelpad=2)
        return figure

    def photo_still(self, number: int) -> Html:
        """Draw the still picture of one photo with its marks."""
        photo = self.photos[number]
        counts = ", ".join(f"{len(one.xy_px)} {one.name}" for one in photo.marks)
        title, note = f"{self.name}: {photo.name}", "; ".join(filter(None, (counts, photo.note)))
        sheet = photo_sheet(photo)
        sheet.title(title, note)
        return sheet.html(f"{title}. {note}")


def photo_sheet(photo: Photo) -> Sheet:
    """Draw a photo with its marks as a still picture without a title."""
    sheet = fitted_sheet(
        (-0.5, photo.width_px - 0.5), (photo.height_px - 0.5, -0.5), width=WIDE_PX, tallest_px=640, bar=False
    )
    if photo.image is not None:
        sheet.photo(_reduced(photo.image, MOST_PIXELS_IN_PAGE), (*sheet.x_limits, *sheet.y_limits))
    legend = []
    for lines in photo.lines:
        for line in lines.lines:
            x, y = np.asarray(line, dtype=np.float64).T
            sheet.line(x, y, lines.color, width=1.2)
        legend.append(LegendEntry(lines.name, lines.color))
    scale = arrow_scale(photo)
    for marks in photo.marks:
        x, y = np.asarray(marks.xy_px, dtype=np.float64).reshape(-1, 2).T
        if marks.refused:
            sheet.crosses(x, y, marks.color)
        elif x.size < _MOST_RINGS:
            sheet.rings(x, y, marks.color)
        else:
            sheet.dots(x, y, [marks.color], size_px=2.0)
        legend.append(LegendEntry(marks.name, marks.color, "cross" if marks.refused else "ring"))
    arrows = [one for one in photo.marks if one.residual_px is not None and len(one.residual_px)]
    for marks in arrows:
        few = np.s_[:: -(-len(marks.xy_px) // _MOST_RINGS)]
        (x, y), (dx, dy) = np.asarray(marks.xy_px)[few].T, scale * np.asarray(marks.residual_px)[few].T
        sheet.arrows(x, y, dx, dy, LINE_Y)
    if arrows:
        legend.append(LegendEntry(f"residuals, {scale:g} times", LINE_Y))
    sheet.axes("column [px]", "row [px]", grid=False)
    sheet.legend(legend)
    return sheet


def arrow_scale(photo: Photo) -> float:
    """Return how much residuals are enlarged: three times their RMS becomes a 20th of the photo, rounded down."""
    residuals = [np.asarray(one.residual_px) for one in photo.marks if one.residual_px is not None]
    every = np.concatenate([np.zeros((0, 2)), *residuals])
    every = every[np.isfinite(every).all(axis=1)]
    rms = float(np.sqrt(np.mean(np.sum(every**2, axis=1)))) if every.size else 0.0
    if rms == 0.0:
        return 1.0
    scale = 0.05 * max(photo.width_px, photo.height_px) / (3 * rms)
    power = 10.0 ** np.floor(np.log10(scale))
    return float(power * max(step for step in (1, 2, 5) if step * power <= scale * (1 + 1e-9)))


def _photo_spec(photo: Photo, store: ArrayStore) -> dict[str, Any]:
    image = None
    if photo.image is not None:
        most = MOST_PIXELS_IN_PAGE if store.most_nodes < 1 << 20 else 1 << 20
        image = store.content(_jpeg(_reduced(photo.image, most)), "image/jpeg")
    marks = [
        {
            "name": one.name,
            "color": one.color,
            "refused": one.refused,
            "xy": store.numbers(np.asarray(one.xy_px, dtype=np.float64).reshape(-1, 2).T, _PLACE_STEP_PX),
            "residual": None
            if one.residual_px is None
            else store.numbers(np.asarray(one.residual_px).reshape(-1, 2).T, _RESIDUAL_STEP_PX),
            "labels": store.content("\n".join(" ".join(text.split()) for text in one.labels).encode(), "text/plain")
            if one.labels
            else None,
        }
        for one in photo.marks
        if len(one.xy_px)
    ]
    lines = [
        {
            "name": one.name,
            "color": one.color,
            "lengths": [len(line) for line in one.lines],
            "xy": store.numbers(np.concatenate([np.asarray(line) for line in one.lines]).T, _PLACE_STEP_PX),
        }
        for one in photo.lines
        if len(one.lines)
    ]
    words = {"name": photo.name, "note": photo.note, "mark": photo.mark, "scale": arrow_scale(photo)}
    return {**words, "size": [photo.width_px, photo.height_px], "image": image, "marks": marks, "lines": lines}


def _reduced(image: npt.NDArray[np.uint8], most: int) -> npt.NDArray[np.uint8]:
    share = most / max(image.shape[:2])
    if share >= 1:
        return image
    reduced = cv2.resize(image, None, fx=share, fy=share, interpolation=cv2.INTER_AREA)
    return np.asarray(reduced, dtype=np.uint8)


def _jpeg(image: npt.NDArray[np.uint8]) -> bytes:
    # OpenCV writes blue, green, red.
    ordered = image if image.ndim == 2 else np.ascontiguousarray(image[:, :, ::-1])
    _, data = cv2.imencode(".jpg", ordered, [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])
    return bytes(data)
