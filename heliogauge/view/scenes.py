"""Scenes in three dimensions that the reader turns: points and lines with labels."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from heliogauge.errors import InputError
from heliogauge.reporting.canvas import INK, WIDTH_IN, add_title, axes_in_inches, new_figure, set_equal_limits
from heliogauge.reporting.html import Html, show
from heliogauge.validate import FloatArray, float_array
from heliogauge.view.arrays import PAGE, ArrayStore
from heliogauge.view.markup import view_frame
from heliogauge.view.stills import side_by_side

#: Coordinates are kept to this share of the scene's size: a thousandth of a pixel.
_STEP_SHARE = 1e-6
# The still picture looks from above at an angle, as the living one does at first.
_AZIMUTH, _ELEVATION = -0.9, 0.5


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
    InputError: Numbers of points, colours, labels and vertices do not fit.
    """

    name: str
    xyz_m: FloatArray
    colors: Sequence[str]
    lengths: Sequence[int] = ()
    labels: Sequence[str] = ()
    size_px: float = 5.0
    shown: bool = True

    def __post_init__(self) -> None:
        object.__setattr__(self, "xyz_m", float_array(f"scene: {self.name}", self.xyz_m, (None, 3)))
        count = len(self.xyz_m)
        fits = len(self.colors) in (1, count) and len(self.labels) in (0, count)
        if not fits or (len(self.lengths) > 0 and sum(self.lengths) != count):
            raise InputError(
                f"scene: {self.name}: {len(self.colors)} colours, {len(self.labels)} labels and lines of "
                f"{sum(self.lengths)} vertices for {count} points"
            )


@dataclass(frozen=True, eq=False)
class SceneView:
    """A scene that turns with the pointer or the arrow keys.

    name: What it shows.
    groups: Points and lines.
    note: A line under it.
    height_px: Height in the page.
    figures: Static figures for notebook and print; empty: the scene from one side, drawn here.
    stills: Still pictures that stand for it in notebook and print; empty: drawn here.
    InputError: There is nothing to show.
    """

    name: str
    groups: tuple[SceneGroup, ...]
    note: str = ""
    height_px: int = 560
    figures: Sequence[Figure] = field(default=())
    stills: Sequence[Html] = ()

    def __post_init__(self) -> None:
        if not any(len(group.xyz_m) for group in self.groups):
            raise InputError("scene: there is nothing to show")

    @cached_property
    def static(self) -> Html:
        """The figures, drawn once."""
        return side_by_side(self.stills) if self.stills else show(*(self.figures or [self.figure()]))

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

    def figure(self) -> Figure:
        """Draw the scene from one side."""
        figure = new_figure(4.2, 1.6 * WIDTH_IN)
        axes = axes_in_inches(figure, 0.1, 0.1, 1.6 * WIDTH_IN - 0.2, 3.5)
        axes.set_axis_off()
        ca, sa, ce, se = np.cos(_AZIMUTH), np.sin(_AZIMUTH), np.cos(_ELEVATION), np.sin(_ELEVATION)
        to_paper = np.array([[-sa, ca, 0.0], [-se * ca, -se * sa, ce]])
        shown = [group for group in self.groups if group.shown and len(group.xyz_m)] or list(self.groups)
        every = np.concatenate([group.xyz_m for group in shown]) @ to_paper.T
        set_equal_limits(axes, every[:, 0], every[:, 1], spare=0.04)
        for group in shown:
            flat = group.xyz_m @ to_paper.T
            if len(group.lengths):
                # One artist for all lines: a gap of NaN between them.
                pieces = np.split(flat, np.cumsum(group.lengths)[:-1])
                gap = np.full((1, 2), np.nan)
                joined = np.concatenate([part for piece in pieces for part in (piece, gap)])
                axes.plot(*joined.T, color=group.colors[0], linewidth=0.7 * group.size_px, alpha=0.75, zorder=2)
            else:
                # Round pictures of 90,000 marks take 3 s as vectors; as an image of points they take 0.2 s.
                size = group.size_px if len(flat) < 5000 else 1.0
                axes.scatter(flat[:, 0], flat[:, 1], s=0.5 * size**2, c=list(group.colors), linewidths=0, zorder=3)
        names = ", ".join(group.name for group in shown)
        add_title(figure, self.name, f"seen from azimuth {np.rad2deg(_AZIMUTH):.0f}\u00b0 and above: {names}")
        figure.patch.set_edgecolor(INK)
        return figure


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
