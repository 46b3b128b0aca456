"""Draw the rooms of the house from the code: which there are, in the order of the data, and who uses whom.

``python docs/draw_rooms.py`` writes docs/images/rooms.svg; a test of tests/architecture compares it with the code.
"""

import ast
import html
from collections import Counter
from pathlib import Path

REPOSITORY = Path(__file__).resolve().parents[1]
PICTURE = REPOSITORY / "docs" / "images" / "rooms.svg"

#: Rooms of each package in the order in which data pass through them, then the service rooms.
METHOD = {
    "calibration.camera": ("corners", "start_values", "adjustment", "judgement"),
    "calibration.screen": (),
    "photogrammetry": (
        "targets",
        "centers",
        "detection",
        "matching",
        "start_values",
        "bundle",
        "networks",
        "surface",
    ),
    "deflectometry": (
        "setup",
        "screen_geometry",
        "sources",
        "frames",
        "fringes",
        "dots",
        "laser",
        "field",
        "gazing",
        "stars",
        "overlay",
        "scans",
        "pose",
        "shape",
        "poses",
        "comparison",
    ),
    "observer": (
        "trough",
        "targets",
        "corners",
        "turning",
        "shutter",
        "photo_edges",
        "absorber",
        "slopes",
        "selection",
        "doubts",
        "product",
        "light",
        "studies",
    ),
    "calibration.beam": ("images", "target", "light", "mirror"),
    "calibration.survey": (),
    "calibration.heliostat": ("kinematic_model", "observations", "fitting", "diagnosis", "exports", "performance"),
    "data_synth": (
        "optics",
        "fringes",
        "dots",
        "targets",
        "troughs",
        "heliostats",
        "acceptance",
        "lasers",
        "sky",
        "stars",
        "reflections",
        "screens",
    ),
    "heliogauge": (
        "geometry",
        "camera",
        "adjust",
        "slopes",
        "sunlight",
        "files",
        "images",
        "measurement",
        "results",
        "reporting",
        "view",
        "running",
        "batch",
    ),
}
SERVICE = ("keys", "exchange", "pipeline", "planning", "files", "report")
INSTRUMENTS = (
    "calibration.camera",
    "photogrammetry",
    "deflectometry",
    "observer",
    "calibration.beam",
    "calibration.survey",
    "calibration.heliostat",
    "calibration.screen",
)

WIDTH, COLUMN, ROOM, GAP, TOP = 1200, 186, 34, 8, 150
INK, FAINT, METHOD_FILL, SERVICE_FILL, KERNEL_FILL = "#1f2933", "#8a97a5", "#dbe9f6", "#eef1f4", "#f6ead2"


def owner(module: str) -> str:
    """Return the instrument or package of a dotted name."""
    parts = module.split(".")
    return ".".join(parts[:2]) if parts[0] == "calibration" and len(parts) > 1 else parts[0]


def modules_of(package: str) -> list[tuple[str, Path]]:
    """List dotted names and files of a package."""
    place = REPOSITORY.joinpath(*package.split("."))
    return [
        (".".join(file.relative_to(REPOSITORY).with_suffix("").parts), file) for file in sorted(place.rglob("*.py"))
    ]


def rooms_of(package: str) -> dict[str, int]:
    """Return the rooms of a package with how many modules each holds, in the order of the data.

    ValueError: a folder that `METHOD` does not place.
    """
    depth = len(package.split("."))
    sizes = Counter(
        name.split(".")[depth]
        for name, file in modules_of(package)
        if file.name != "__init__.py" and len(name.split(".")) > depth + 1
    )
    singles = {name.split(".")[depth] for name, _ in modules_of(package) if len(name.split(".")) == depth + 1}
    order = (*METHOD[package], *SERVICE)
    if missing := set(sizes) - set(order):
        raise ValueError(f"{package}: say in docs/draw_rooms.py where the data pass through {sorted(missing)}")
    return {room: sizes[room] or 1 for room in order if room in sizes or (room in SERVICE and room in singles)}


def uses() -> set[tuple[str, str]]:
    """Return which package imports from which other one, without the kernel."""
    found = set()
    for package in (*INSTRUMENTS, "data_synth"):
        for name, file in modules_of(package):
            for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
                if isinstance(node, ast.ImportFrom) and node.module:
                    other = owner(node.module)
                    if other in METHOD and other not in {owner(name), "heliogauge"}:
                        found.add((owner(name), other))
    return found


def _box(x: float, y: float, width: float, text: str, fill: str, note: str = "", height: float = ROOM) -> str:
    middle = y + height / 2
    parts = [
        f'<rect x="{x}" y="{y}" width="{width}" height="{height}" rx="5" fill="{fill}" stroke="{FAINT}"/>',
        f'<text x="{x + 10}" y="{middle + 4.5}">{html.escape(text)}</text>',
    ]
    if note:
        parts.append(f'<text x="{x + width - 10}" y="{middle + 4.5}" text-anchor="end" fill="{FAINT}">{note}</text>')
    return "".join(parts)


def _path(places: dict[str, float], pair: tuple[str, str], level: int, top: float) -> str:
    """Draw an arrow over the columns from the user to what it uses."""
    start, end = places[pair[0]] + COLUMN * 0.62, places[pair[1]] + COLUMN * 0.38
    height = top - 16 - 13 * level
    return (
        f'<path d="M{start:.0f} {top} V{height} H{end:.0f} V{top - 3}" fill="none" stroke="{INK}" '
        f'marker-end="url(#arrow)"><title>{pair[0]} uses {pair[1]}</title></path>'
    )


def draw() -> str:
    """Return the picture as SVG text."""
    step = (WIDTH - 20) / len(INSTRUMENTS)
    places = {package: 10 + k * step for k, package in enumerate(INSTRUMENTS)}
    parts = []
    synth = rooms_of("data_synth")
    parts.append(_box(10, 10, 150, "data_synth", "#fff", height=ROOM))
    for k, (room, size) in enumerate(synth.items()):
        parts.append(_box(175 + k * 150, 10, 140, room, METHOD_FILL, str(size)))
    parts.append(f'<text x="{175 + len(synth) * 150}" y="32" fill="{FAINT}">draws; knows descriptions only</text>')
    between = sorted(pair for pair in uses() if "data_synth" not in pair)
    parts += [_path(places, pair, level, TOP) for level, pair in enumerate(between)]
    lowest = 0.0
    for package, x in places.items():
        y = float(TOP)
        parts.append(f'<text x="{x + 2}" y="{y + 22}" font-weight="bold">{package}</text>')
        y += ROOM
        for room, size in rooms_of(package).items():
            fill = SERVICE_FILL if room in SERVICE else METHOD_FILL
            parts.append(_box(x, y, COLUMN, room, fill, str(size)))
            y += ROOM + GAP
        lowest = max(lowest, y)
    y = lowest + 14
    parts.append(f'<text x="10" y="{y + 22}" font-weight="bold">heliogauge, the kernel: used by all, knows none</text>')
    y += ROOM
    kernel = rooms_of("heliogauge")
    per_row = 5
    width = (WIDTH - 20 - (per_row - 1) * GAP) / per_row
    for k, (room, size) in enumerate(kernel.items()):
        row, column = divmod(k, per_row)
        parts.append(_box(10 + column * (width + GAP), y + row * (ROOM + GAP), width, room, KERNEL_FILL, str(size)))
    bottom = y + (1 + (len(kernel) - 1) // per_row) * (ROOM + GAP) + 24
    parts.append(
        f'<text x="10" y="{bottom - 8}" fill="{FAINT}">blue: rooms of the method, in the order of the data; '
        "grey: service rooms, the same names everywhere; numbers: modules; arrows: uses the public face of</text>"
    )
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {bottom:.0f}" font-family="sans-serif" '
        f'font-size="14" fill="{INK}"><defs><marker id="arrow" markerWidth="8" markerHeight="8" refX="6" refY="3" '
        f'orient="auto"><path d="M0 0 L7 3 L0 6 z" fill="{INK}"/></marker></defs>'
        f'<rect width="100%" height="100%" fill="#fff"/>{"".join(parts)}</svg>\n'
    )


if __name__ == "__main__":
    PICTURE.write_text(draw(), encoding="utf-8")
    print(PICTURE)
