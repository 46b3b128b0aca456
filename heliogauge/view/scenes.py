"""Scenes in three dimensions that the reader turns: points and lines with labels."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from heliogauge.errors import InputError
from heliogauge.files.extras import of_extra
from heliogauge.reporting.html import Html
from heliogauge.validate import FloatArray, float_array
from heliogauge.view.arrays import PAGE, ArrayStore
from heliogauge.view.markup import view_frame
from heliogauge.view.stills import LegendEntry, Sheet, colors_of, fitted_sheet, side_by_side

if TYPE_CHECKING:
    from matplotlib.figure import Figure

#: Coordinates are kept to this share of the scene's size: a thousandth of a pixel.
_STEP_SHARE = 1e-6
# A figure looks from above at an angle, as the living view does at first.
_AZIMUTH, _ELEVATION = -0.9, 0.5
#: From this number on points are as small as can be.
_MANY_POINTS = 5000


class ColorScale(NamedTuple):
    """What colours stand for.

    low, high: Values where the colours end.
    unit: Their unit; empty: none.
    diverging: From blue over white to red; otherwise from dark to yellow.
    """

    low: float
    high: float
    unit: str
    diverging: bool = False

    def colors(self, values: FloatArray) -> list[str]:
        """Return the colours of values, shape (n,); those without a value are grey."""
        return colors_of(values, self.low, self.high, diverging=self.diverging)


@dataclass(frozen=True, slots=True, eq=False)
class SceneGroup:
    """Points or lines of one kind, which the reader can switch off.

    name: What they are; the legend shows it.
    xyz_m (n, 3): Points; for lines the vertices of one line after the other [m].
    colors: One colour for all, or one for each point, as ``#rrggbb``.
    lengths: Number of vertices of each line; none for points.
    labels: What is shown when the pointer is at a point.
    size_px: Diameter of the points, width of the lines.
    shown: Whether it is switched on at first.
    scale: What the colours stand for; None: nothing.
    InputError: Numbers of points, colours, labels and vertices do not fit.
    """

    name: str
    xyz_m: FloatArray
    colors: Sequence[str]
    lengths: Sequence[int] = ()
    labels: Sequence[str] = ()
    size_px: float = 5.0
    shown: bool = True
    scale: ColorScale | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "xyz_m", float_array(f"scene: {self.name}", self.xyz_m, (None, 3)))
        count = len(self.xyz_m)
        fits = len(self.colors) in (1, count) and len(self.labels) in (0, count)
        if not fits or (len(self.lengths) > 0 and sum(self.lengths) != count):
            raise InputError(
                f"scene: {self.name}: {len(self.colors)} colours, {len(self.labels)} labels and lines of "
                f"{sum(self.lengths)} vertices for {count} points"
            )

    def broken(self, vertices: FloatArray) -> FloatArray:
        """Return vertices of the lines, shape (n, k), with a row of NaN after each line."""
        return np.insert(vertices, np.cumsum(self.lengths), np.nan, axis=0)


@dataclass(frozen=True, eq=False)
class SceneView:
    """A scene that turns with the pointer or the arrow keys.

    name: What it shows.
    groups: Points and lines.
    note: A line under it.
    height_px: Height in the page.
    stills: Still pictures that stand for it in notebook and print; empty: drawn here.
    InputError: There is nothing to show.
    """

    name: str
    groups: tuple[SceneGroup, ...]
    note: str = ""
    height_px: int = 560
    stills: Sequence[Html] = ()

    def __post_init__(self) -> None:
        if not any(len(group.xyz_m) for group in self.groups):
            raise InputError("scene: there is nothing to show")

    @cached_property
    def static(self) -> Html:
        """The still pictures, drawn once."""
        return side_by_side(self.stills) if self.stills else side_by_side(self._stills(), caption=self.note)

    def _repr_html_(self) -> str:
        return self.static.text

    def page_html(self, store: ArrayStore = PAGE) -> str:
        """Return the view for a page."""
        everything = np.concatenate([group.xyz_m for group in self.groups])
        low, high = everything.min(axis=0), everything.max(axis=0)
        size = max(float(np.linalg.norm(high - low)), 1e-12)
        spec = {
            "name": self.name,
            "note": self.note,
            "height": self.height_px,
            "middle": (0.5 * (low + high)).tolist(),
            "size": size,
            "groups": [_group_spec(group, store, size * _STEP_SHARE) for group in self.groups],
        }
        return view_frame("scene", self.name, spec, self.static)

    def figure(self) -> "Figure":
        """Draw the scene from one side.

        InputError: matplotlib is not installed.
        """
        of_extra("matplotlib")
        from heliogauge.reporting.canvas import WIDTH_IN, add_title, axes_in_inches, new_figure, set_equal_limits

        figure = new_figure(4.2, 1.6 * WIDTH_IN)
        axes = axes_in_inches(figure, 0.1, 0.1, 1.6 * WIDTH_IN - 0.2, 3.5)
        axes.set_axis_off()
        ca, sa, ce, se = np.cos(_AZIMUTH), np.sin(_AZIMUTH), np.cos(_ELEVATION), np.sin(_ELEVATION)
        to_paper = np.array([[-sa, ca, 0.0], [-se * ca, -se * sa, ce]])
        shown = self._shown()
        every = np.concatenate([group.xyz_m for group in shown]) @ to_paper.T
        set_equal_limits(axes, every[:, 0], every[:, 1], spare=0.04)
        for group in shown:
            flat = group.xyz_m @ to_paper.T
            if len(group.lengths):
                # One artist for all lines.
                axes.plot(*group.broken(flat).T, color=group.colors[0], linewidth=0.7 * group.size_px, alpha=0.75)
            else:
                # Round pictures of 90,000 marks take 3 s as vectors; as an image of points they take 0.2 s.
                size = group.size_px if len(flat) < 5000 else 1.0
                axes.scatter(flat[:, 0], flat[:, 1], s=0.5 * size**2, c=list(group.colors), linewidths=0, zorder=3)
        names = ", ".join(group.name for group in shown)
        add_title(figure, self.name, f"seen from azimuth {np.rad2deg(_AZIMUTH):.0f}\u00b0 and above: {names}")
        return figure

    def _shown(self) -> list[SceneGroup]:
        return [group for group in self.groups if group.shown and len(group.xyz_m)] or list(self.groups)

    def _stills(self) -> list[Html]:
        """Draw the scene seen from above and from the side, each with axes."""
        shown = self._shown()
        every = np.concatenate([group.xyz_m for group in shown])
        low, high = every.min(axis=0), every.max(axis=0)
        # What is flat has some room above and below.
        least = max(0.15 * float((high - low).max()), 1e-9)
        room = np.maximum(0.04 * (high - low).max(), 0.5 * (least - (high - low)))
        low, high = low - room, high + room
        scales = [group.scale for group in shown if group.scale is not None]
        pictures = []
        # Seen from +z, and from -y.
        for up, depth in ((1, every[:, 2]), (2, -every[:, 1])):
            limits = [(float(low[axis]), float(high[axis])) for axis in (0, up)]
            sheet = fitted_sheet(limits[0], limits[1], tallest_px=380, bar=bool(scales))
            title = f"{self.name}: x and {'xyz'[up]}"
            sheet.title(title, "seen from above" if up == 1 else "seen from the side of \u2212y")
            sheet.axes("x [m]", f"{'xyz'[up]} [m]", grid=True)
            start = 0
            for group in shown:
                _draw(group, sheet, up, depth[start : start + len(group.xyz_m)])
                start += len(group.xyz_m)
            for scale in scales[:1]:
                sheet.color_bar(scale.low, scale.high, scale.unit, diverging=scale.diverging)
            sheet.legend([_entry(group) for group in shown])
            pictures.append(sheet.html(f"{title}: {', '.join(group.name for group in shown)}"))
        return pictures


def _draw(group: SceneGroup, sheet: Sheet, up: int, depth: FloatArray) -> None:
    """Draw points or lines; near points cover far ones."""
    flat = group.xyz_m[:, [0, up]]
    if not len(group.lengths):
        order = np.argsort(depth, kind="stable")
        colors = [group.colors[place] for place in order.tolist()] if len(group.colors) > 1 else group.colors
        size = group.size_px if len(flat) < _MANY_POINTS else 1.0
        sheet.dots(flat[order, 0], flat[order, 1], colors, size_px=size)
        return
    first = np.concatenate([[0], np.cumsum(group.lengths)[:-1]]).tolist()
    own = [group.colors[place if len(group.colors) > 1 else 0] for place in first]
    ends = np.repeat(own, np.asarray(group.lengths) + 1)
    broken = group.broken(flat)
    for color in dict.fromkeys(own):
        x, y = broken[ends == color].T
        sheet.line(x, y, color, width=0.8 * group.size_px, opacity=0.8)


def _entry(group: SceneGroup) -> LegendEntry:
    # Of several colours the one in the middle.
    kinds = sorted(set(group.colors), key=list(group.colors).index)
    return LegendEntry(group.name, kinds[len(kinds) // 2], "line" if len(group.lengths) else "dot")


def _group_spec(group: SceneGroup, store: ArrayStore, step: float) -> dict[str, Any]:
    colors = list(dict.fromkeys(group.colors))
    place = {color: index for index, color in enumerate(colors)}
    many = len(group.colors) > 1
    return {
        "name": group.name,
        # One axis after the other: differences of neighbours are small.
        "xyz": store.numbers(group.xyz_m.T, step),
        "colors": colors,
        "color_of": store.numbers([place[color] for color in group.colors], 1.0) if many else None,
        "lengths": list(group.lengths),
        "labels": store.content("\n".join(_one_line(group.labels)).encode(), "text/plain") if group.labels else None,
        "size": group.size_px,
        "shown": group.shown,
    }


def _one_line(texts: Sequence[str]) -> list[str]:
    return [" ".join(text.split()) for text in texts]
