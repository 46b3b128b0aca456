"""What a measurement needs of its source of known points; each source is a room of its own."""

from collections.abc import Iterator
from typing import NamedTuple, Protocol

from deflectometry.sources.display_edge import DisplayEdge
from deflectometry.sources.screen_map import ScreenMap
from heliogauge.validate import BoolArray, Float32Array


class Remedies(NamedTuple):
    """What the user of a source can do about slopes that contradict themselves.

    points: Against noise of single points.
    pattern: What to check of the pattern and its images.
    """

    points: str
    pattern: str


class Exchange(NamedTuple):
    """Something that programs and people exchange in images or pattern.

    words: What was exchanged.
    source: The source with that put right.
    moves_outline: Whether the mirror then stands elsewhere in the images.
    """

    words: str
    source: "Source"
    moves_outline: bool


class Source(Protocol):
    """Images in which a mirror shows known points."""

    @property
    def size_px(self) -> tuple[int, int]:
        """Width and height of the images [px]."""

    @property
    def mixes_edges(self) -> bool:
        """Whether a sample near an edge of the mirror shows what is beside it, too."""

    @property
    def remedies(self) -> Remedies:
        """What to do about slopes that contradict themselves."""

    def mirror_image(self) -> Float32Array:
        """Return an image in which the mirror is bright, shape (h, w) [DN]."""

    def clutter(self) -> BoolArray | None:
        """Return the pixels (h, w) where what the mirror shows may be taken for its edge or hides it, if any."""

    def screen_map(self, region: BoolArray) -> ScreenMap:
        """Measure which point of the screen each sample sees.

        region (h, w): Pixels of the image that see the mirror.
        """

    def display_edge(self, screen_map: ScreenMap, region: BoolArray, margin_px: float) -> DisplayEdge:
        """Say where the mirror looks past the screen, and flag what mixes both.

        region: Samples on the mirror, in the rows and columns of the map.
        margin_px: Half a pixel's diagonal and the blur of an edge [px].
        """

    def exchanges(self, seen: ScreenMap) -> Iterator[Exchange]:
        """Yield what programs and people exchange in images or pattern.

        seen: What the images show as they are: what they show with an exchange put right follows from it.
        """
