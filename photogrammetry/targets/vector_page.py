"""Pages of areas and text in millimetres, as SVG and as PDF: true scale is all that is asked of them."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from math import ceil, cos, pi, sin, tan

from heliogauge.validate import positive

#: One Bezier curve per so much of a turn; the radius is then wrong by 1e-6 of itself.
_ARC_STEP = pi / 6
_POINTS_PER_MM = 72 / 25.4


@dataclass(frozen=True, slots=True)
class Path:
    """A closed outline: a start and pieces, each a line (2 numbers) or a Bezier curve (6 numbers).

    start: First point (x, y) [mm].
    pieces: End point of a line, or two control points and the end point of a curve [mm].
    """

    start: tuple[float, float]
    pieces: tuple[tuple[float, ...], ...]


@dataclass(frozen=True, slots=True)
class Area:
    """Outlines filled together with one grey.

    paths: The outlines; they do not overlap.
    grey: 0 black to 1 white.
    """

    paths: tuple[Path, ...]
    grey: float = 0.0


@dataclass(frozen=True, slots=True)
class Label:
    """A line of text.

    x_mm, y_mm: Left end of its base line [mm].
    text: Printable ASCII.
    size_mm: Size of the type [mm].
    """

    x_mm: float
    y_mm: float
    text: str
    size_mm: float = 3.0


@dataclass(frozen=True, slots=True)
class Page:
    """A page: x to the right and y down from its top left corner.

    width_mm, height_mm: Size of the paper [mm].
    areas: What is filled, in this order.
    labels: Text.
    """

    width_mm: float
    height_mm: float
    areas: tuple[Area, ...]
    labels: tuple[Label, ...] = field(default=())

    def __post_init__(self) -> None:
        positive("page width_mm", self.width_mm, "mm")
        positive("page height_mm", self.height_mm, "mm")


def rectangle(x_mm: float, y_mm: float, width_mm: float, height_mm: float) -> Path:
    """Return a rectangle from its top left corner and size [mm]."""
    right, bottom = x_mm + width_mm, y_mm + height_mm
    return Path((x_mm, y_mm), ((right, y_mm), (right, bottom), (x_mm, bottom)))


def disc(x_mm: float, y_mm: float, radius_mm: float) -> Path:
    """Return a circle from its centre and radius [mm]."""
    return Path((x_mm + radius_mm, y_mm), _arc(x_mm, y_mm, radius_mm, 0.0, 2 * pi))


def ring_sector(center_mm: tuple[float, float], radii_mm: tuple[float, float], arc_rad: tuple[float, float]) -> Path:
    """Return a piece of a ring.

    radii_mm: Inner and outer radius [mm].
    arc_rad: Start and end, clockwise from 3 o'clock [rad].
    """
    x, y = center_mm
    (inner, outer), (start, end) = radii_mm, arc_rad
    inner_end = (x + inner * cos(end), y + inner * sin(end))
    pieces = (*_arc(x, y, outer, start, end), inner_end, *_arc(x, y, inner, end, start))
    return Path((x + outer * cos(start), y + outer * sin(start)), pieces)


def to_svg(page: Page) -> str:
    """Format a page as SVG in true scale.

    Returns: The file's content.
    """
    size = (
        f'width="{page.width_mm:g}mm" height="{page.height_mm:g}mm" viewBox="0 0 {page.width_mm:g} {page.height_mm:g}"'
    )
    lines = ['<?xml version="1.0" encoding="UTF-8"?>', f'<svg xmlns="http://www.w3.org/2000/svg" version="1.1" {size}>']
    lines.append(f'<rect width="{page.width_mm:g}" height="{page.height_mm:g}" fill="#ffffff"/>')
    for area in page.areas:
        level = f"{round(255 * area.grey):02x}"
        lines.append(f'<path fill="#{level * 3}" d="{" ".join(map(_svg_path, area.paths))}"/>')
    for label in page.labels:
        place = f'x="{label.x_mm:.4f}" y="{label.y_mm:.4f}" font-size="{label.size_mm:g}"'
        text = label.text.replace("&", "&amp;").replace("<", "&lt;")
        lines.append(f'<text {place} font-family="Helvetica, Arial, sans-serif">{text}</text>')
    return "\n".join([*lines, "</svg>", ""])


def to_pdf(pages: Sequence[Page]) -> bytes:
    """Format pages as a PDF in true scale (PDF 1.4, Helvetica, nothing embedded).

    Returns: The file's content.
    """
    objects = [b"", b"", b"<< /Type /Font /Subtype /Type1 /BaseFont /Helvetica >>"]
    kids = []
    for page in pages:
        content = _pdf_content(page).encode("ascii")
        stream = len(objects) + 1
        objects.append(b"<< /Length %d >>\nstream\n" % len(content) + content + b"\nendstream")
        box = f"[0 0 {page.width_mm * _POINTS_PER_MM:.5f} {page.height_mm * _POINTS_PER_MM:.5f}]"
        leaf = f"<< /Type /Page /Parent 2 0 R /MediaBox {box} /Contents {stream} 0 R "
        objects.append((leaf + "/Resources << /Font << /F1 3 0 R >> >> >>").encode("ascii"))
        kids.append(f"{stream + 1} 0 R")
    # Viewers that honour the hint offer "actual size" first.
    objects[0] = b"<< /Type /Catalog /Pages 2 0 R /ViewerPreferences << /PrintScaling /None >> >>"
    objects[1] = f"<< /Type /Pages /Kids [{' '.join(kids)}] /Count {len(kids)} >>".encode("ascii")
    return _pdf_file(objects)


def _arc(x: float, y: float, radius: float, start: float, end: float) -> tuple[tuple[float, ...], ...]:
    """Return the Bezier curves of an arc, in its own sense."""
    count = max(ceil(abs(end - start) / _ARC_STEP - 1e-9), 1)
    step = (end - start) / count
    reach = 4 / 3 * tan(step / 4) * radius
    curves = []
    for k in range(count):
        a, b = start + k * step, start + (k + 1) * step
        first = (x + radius * cos(a) - reach * sin(a), y + radius * sin(a) + reach * cos(a))
        second = (x + radius * cos(b) + reach * sin(b), y + radius * sin(b) - reach * cos(b))
        curves.append((*first, *second, x + radius * cos(b), y + radius * sin(b)))
    return tuple(curves)


def _numbers(values: Sequence[float]) -> str:
    return " ".join(f"{value:.5f}" for value in values)


def _svg_path(path: Path) -> str:
    pieces = (("L " if len(piece) == 2 else "C ") + _numbers(piece) for piece in path.pieces)
    return f"M {_numbers(path.start)} {' '.join(pieces)} Z"


def _pdf_content(page: Page) -> str:
    scale = _POINTS_PER_MM
    lines = [f"{scale:.9f} 0 0 {-scale:.9f} 0 {page.height_mm * scale:.6f} cm"]
    for area in page.areas:
        lines.append(f"{area.grey:.4f} g")
        for path in area.paths:
            lines.append(f"{_numbers(path.start)} m")
            lines += [f"{_numbers(piece)} {'l' if len(piece) == 2 else 'c'}" for piece in path.pieces]
            lines.append("h")
        lines.append("f")
    lines.append("0 g")
    for label in page.labels:
        text = label.text.replace("\\", r"\\").replace("(", r"\(").replace(")", r"\)")
        place = f"1 0 0 -1 {label.x_mm:.5f} {label.y_mm:.5f} Tm"
        lines.append(f"BT /F1 {label.size_mm:g} Tf {place} ({text}) Tj ET")
    return "\n".join(lines)


def _pdf_file(objects: Sequence[bytes]) -> bytes:
    content = b"%PDF-1.4\n"
    offsets = []
    for number, body in enumerate(objects, start=1):
        offsets.append(len(content))
        content += b"%d 0 obj\n" % number + body + b"\nendobj\n"
    table = b"xref\n0 %d\n0000000000 65535 f \n" % (len(objects) + 1)
    table += b"".join(b"%010d 00000 n \n" % offset for offset in offsets)
    trailer = b"trailer\n<< /Size %d /Root 1 0 R >>\nstartxref\n%d\n%%%%EOF\n" % (len(objects) + 1, len(content))
    return content + table + trailer
