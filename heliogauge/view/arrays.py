"""Arrays on their way into a page: packed into its text, or kept aside for a server to hand out."""

import base64
import gzip
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from heliogauge.validate import FloatArray

#: Nodes along one side of a map within a page, as in static figures; the viewer's server hands out all.
MOST_NODES_IN_PAGE = 400
# Level 6 saves 2 % more of the size and takes twice the time.
_GZIP_LEVEL = 4

Packed = dict[str, Any]


class ArrayStore(Protocol):
    """Takes arrays and texts and says in JSON where the page finds them."""

    @property
    def most_nodes(self) -> int:
        """Most nodes along one side of a map."""

    def numbers(self, values: npt.ArrayLike, step: float) -> Packed:
        """Keep numbers, NaN where there is none, at least to multiples of a step."""

    def codes(self, values: npt.ArrayLike) -> Packed:
        """Keep whole numbers from 0 to 255."""

    def content(self, data: bytes, media_type: str) -> Packed:
        """Keep a text or an image."""


class PageStore:
    """Packs everything into the page: gzip of differences of whole multiples of the step, as base64."""

    most_nodes = MOST_NODES_IN_PAGE

    def numbers(self, values: npt.ArrayLike, step: float) -> Packed:
        """Pack numbers: multiples of the step, differences along the last axis, bytes of equal weight together."""
        array = np.atleast_1d(np.asarray(values, dtype=np.float64))
        known = np.isfinite(array)
        largest = float(np.abs(array[known]).max(initial=0.0))
        # 32 bits hold multiples up to 2e9, whatever the step asked for.
        step = max(step, largest / 1e9, np.finfo(np.float64).tiny)
        whole = np.rint(np.where(known, array, 0.0) / step).astype(np.int32)
        # A missing value repeats its neighbour: no jump to code.
        place = np.maximum.accumulate(np.where(known, np.arange(array.shape[-1]), 0), axis=-1)
        whole = np.take_along_axis(whole, place, axis=-1)
        differences = np.diff(whole, axis=-1, prepend=np.int32(0)).ravel()
        # Small numbers of both signs become small numbers: the upper bytes are then all zero.
        folded = ((differences << 1) ^ (differences >> 31)).astype("<u4")
        planes = np.ascontiguousarray(folded.view(np.uint8).reshape(-1, 4).T)
        packed = {"form": "steps", "shape": list(array.shape), "step": step, "data": _packed(planes.tobytes())}
        if not known.all():
            packed["known"] = _packed(np.packbits(known).tobytes())
        return packed

    def codes(self, values: npt.ArrayLike) -> Packed:
        """Pack small whole numbers, one byte each."""
        array = np.asarray(values, dtype=np.uint8)
        return {"form": "bytes", "shape": list(array.shape), "data": _packed(array.tobytes())}

    def content(self, data: bytes, media_type: str) -> Packed:
        """Pack a text or an image; images are compressed already."""
        if media_type.startswith("image/"):
            return {"form": "image", "url": f"data:{media_type};base64,{base64.b64encode(data).decode('ascii')}"}
        return {"form": "text", "data": _packed(data)}


@dataclass(frozen=True, slots=True, eq=False)
class ServedStore:
    """Keeps everything at full resolution beside the page, for a server that gives it out by number.

    address: What stands before the number in the page.
    contents: Bytes and media type, by number.
    """

    address: str
    contents: list[tuple[bytes, str]] = field(default_factory=list)
    most_nodes: int = 1 << 30

    def numbers(self, values: npt.ArrayLike, step: float) -> Packed:
        """Keep numbers as 32-bit floats."""
        array = np.atleast_1d(np.asarray(values, dtype="<f4"))
        return {"form": "floats", "shape": list(array.shape), "url": self._keep(array.tobytes())}

    def codes(self, values: npt.ArrayLike) -> Packed:
        """Keep small whole numbers, one byte each."""
        array = np.asarray(values, dtype=np.uint8)
        return {"form": "bytes", "shape": list(array.shape), "url": self._keep(array.tobytes())}

    def content(self, data: bytes, media_type: str) -> Packed:
        """Keep a text or an image."""
        form = "image" if media_type.startswith("image/") else "text"
        return {"form": form, "url": self._keep(data, media_type)}

    def _keep(self, data: bytes, media_type: str = "application/octet-stream") -> str:
        self.contents.append((data, media_type))
        return f"{self.address}{len(self.contents) - 1}"


PAGE = PageStore()


def reading_step(values: FloatArray) -> float:
    """Return a power of ten that is at most a 5000th of what 99 % of the values reach: enough for eye and readout."""
    sizes = np.abs(values[np.isfinite(values)])
    reach = float(np.percentile(sizes, 99.0)) if sizes.size else 0.0
    if reach == 0.0:
        reach = float(sizes.max(initial=0.0)) or 1.0
    return float(10.0 ** np.floor(np.log10(reach / 5000)))


def _packed(data: bytes) -> str:
    return base64.b64encode(gzip.compress(data, _GZIP_LEVEL, mtime=0)).decode("ascii")
