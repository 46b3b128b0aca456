"""Ways to damage a file, each drawn from a generator of random numbers."""

import csv
import io
import json
import os
import random
import re
import shutil
import struct
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

Damage = Callable[[Path, random.Random], None]

#: Values that no file should have where they land; texts end in names, paths, figures and pages.
ODD_VALUES: tuple[Any, ...] = (
    *(
        None,
        True,
        "",
        "x",
        "a$\\bad{$b",
        "<script>alert(1)</script>",
        "../../../../etc/passwd",
        "/dev/zero",
        "é\U0001f600",
    ),
    *(0, -1, 1, 3.5, -0.0, 1e-320, 1e308, -1e308, 10**18, 2**63 - 1, 10**400, float("nan"), float("inf")),
    *([], {}, [[]], [1, 2, 3], ["a", 1, None], {"a": 1}, "9" * 300, "n" * 300, "\x00", "\ud800", "1e999", "true"),
)
_ODD_CELLS = (
    *("", " ", "x", "nan", "inf", "-inf", "1e999", "-1", "0", "1e308", "1e-320", "9" * 400, "0x10", "1,5", '"', '""'),
    *("a$\\bad{$b", "<b>", "\x00", "é", "../../x", "2026-13-45T99:00:00Z", "9999-12-31T23:59:59-23:00", "1_000", "٣"),
)
_ODD_TOML = (
    *("true", '""', '"x"', "0", "-1", "1e308", "-1e-320", "nan", "inf", "9223372036854775807", "[]", "{}", "[[]]"),
    *(
        "[1, 2]",
        '["a"]',
        "1979-05-27",
        "12:00:00",
        "{ a = 1 }",
        '"*"',
        '"../*"',
        '"**"',
        '"/etc/passwd"',
        '"a$\\\\bad{$b"',
    ),
    *('"/dev/zero"', "9" * 60, '"' + "n" * 300 + '"', '"\\u0000"', "[" * 500 + "]" * 500, "[0.0, 0.0, 0.0]", "1e400"),
)


# --- any file ---------------------------------------------------------------------------------------------------------


def flip_bits(path: Path, rng: random.Random) -> None:
    content = bytearray(path.read_bytes())
    for _ in range(rng.choice((1, 3, 30))):
        if content:
            content[_place(len(content), rng)] ^= 1 << rng.randrange(8)
    path.write_bytes(content)


def cut_off(path: Path, rng: random.Random) -> None:
    content = path.read_bytes()
    path.write_bytes(content[: rng.choice((0, 1, 8, rng.randrange(len(content) + 1)))])


def put_in(path: Path, rng: random.Random) -> None:
    content = path.read_bytes()
    place = _place(len(content) + 1, rng)
    part = rng.choice((rng.randbytes(rng.randrange(1, 400)), b"\0" * 100, b"\xff" * 8, content[place : place + 500]))
    path.write_bytes(content[:place] + part + content[place:])


def take_out(path: Path, rng: random.Random) -> None:
    content = path.read_bytes()
    place = _place(len(content) + 1, rng)
    path.write_bytes(content[:place] + content[place + rng.choice((1, 4, 100, 5000)) :])


def other_encoding(path: Path, rng: random.Random) -> None:
    text = path.read_bytes().decode("utf-8", "replace")
    path.write_bytes(text.encode(rng.choice(("utf-16", "utf-32-le", "cp1252", "utf-8-sig")), "replace"))


def other_kind(path: Path, rng: random.Random) -> None:
    others = [one for one in path.parent.iterdir() if one.is_file() and one != path]
    content = rng.choice(others).read_bytes() if others else b"x"
    path.write_bytes(content)


def no_file(path: Path, rng: random.Random) -> None:
    path.unlink()
    kind = rng.choice(("absent", "pipe", "folder", "link out", "loop", "nowhere", "device", "hole", "unreadable"))
    if kind == "pipe":
        os.mkfifo(path)
    elif kind == "folder":
        path.mkdir()
    elif kind == "hole":
        with path.open("wb") as file:
            file.truncate(rng.choice((2**20, 2**32, 2**42)))
    elif kind == "unreadable":
        path.write_bytes(b"")
        path.chmod(0)
    elif kind != "absent":
        target = {"link out": "/etc/passwd", "loop": path.name, "nowhere": "nothing", "device": "/dev/zero"}[kind]
        path.symlink_to(target)


def only_numbers(path: Path, rng: random.Random) -> None:
    content = path.read_bytes().decode("utf-8", "replace")
    numbers = list(re.finditer(r"-?\d+(\.\d+)?(e-?\d+)?", content))
    for found in sorted(rng.sample(numbers, min(len(numbers), rng.choice((1, 2, 5)))), key=lambda one: -one.start()):
        odd = rng.choice(("0", "-1", "1e308", "1e-300", "99999999999", "-0.0", "1e999", "12345678901234567890123"))
        content = content[: found.start()] + odd + content[found.end() :]
    path.write_bytes(content.encode())


def other_digit(path: Path, rng: random.Random) -> None:
    """Mistype one digit of a number: what still looks right."""
    content = path.read_bytes().decode("utf-8", "replace")
    numbers = list(re.finditer(r"(?<![\w.])-?\d+(\.\d+)?", content))
    if not numbers:
        raise ValueError("no number in it")
    found = rng.choice(numbers)
    places = [at for at in range(*found.span()) if content[at].isdigit()]
    # The first digits matter most.
    at = places[min(rng.randrange(len(places)), rng.randrange(len(places)))]
    other = rng.choice([digit for digit in "0123456789" if digit != content[at]])
    path.write_bytes((content[:at] + other + content[at + 1 :]).encode())


ANY = (flip_bits, cut_off, put_in, take_out, other_kind, no_file)
ANY_TEXT = (other_encoding, only_numbers, other_digit, other_digit)


# --- JSON, TOML, CSV --------------------------------------------------------------------------------------------------


def odd_json(path: Path, rng: random.Random) -> None:
    content = json.loads(path.read_text(encoding="utf-8"))
    for _ in range(rng.choice((1, 1, 2))):
        places: list[tuple[Any, Any]] = []
        _walk(content, places, rng)
        if not places:
            break
        owner, key = rng.choice(places)
        what = rng.choice(("replace", "replace", "replace", "remove", "nest", "rename", "repeat"))
        if what == "remove":
            del owner[key]
        elif what == "rename" and isinstance(owner, dict):
            owner[str(rng.choice(ODD_VALUES))[:400]] = owner.pop(key)
        elif what == "repeat" and isinstance(owner, list):
            owner.insert(key, owner[key])
        elif what == "nest":
            deep: Any = owner[key]
            for _ in range(rng.choice((1, 150, 800))):
                deep = [deep]
            owner[key] = deep
        else:
            owner[key] = rng.choice(ODD_VALUES)
    path.write_text(json.dumps(content), encoding="utf-8", errors="surrogatepass")


def _walk(value: Any, places: list[tuple[Any, Any]], rng: random.Random) -> None:
    # Some of long lists: otherwise nearly all damage would land in the one covariance of a file.
    if isinstance(value, dict):
        for key, one in value.items():
            places.append((value, key))
            _walk(one, places, rng)
    elif isinstance(value, list):
        for index in rng.sample(range(len(value)), min(len(value), 3)):
            places.append((value, index))
            _walk(value[index], places, rng)


def odd_toml(path: Path, rng: random.Random) -> None:
    lines = path.read_text(encoding="utf-8").splitlines()
    keys = [k for k, line in enumerate(lines) if re.match(r"\s*[\w.-]+\s*=", line)]
    for _ in range(rng.choice((1, 1, 2, 4))):
        if not keys:
            break
        at = rng.choice(keys)
        key = lines[at].partition("=")[0]
        what = rng.choice(("value", "value", "value", "value", "remove", "twice", "table", "rename"))
        if what == "value":
            lines[at] = f"{key}= {rng.choice(_ODD_TOML)}"
        elif what == "remove":
            lines[at] = ""
        elif what == "twice":
            lines[at] += "\n" + lines[at]
        elif what == "table":
            lines[at] = rng.choice(("[x]", "[[camera]]", "[a.b.c]", "[" * 300)) + "\n" + lines[at]
        else:
            lines[at] = lines[at].replace(key, key.strip() + "s ", 1)
    path.write_text("\n".join(lines), encoding="utf-8")


def odd_csv(path: Path, rng: random.Random) -> None:
    rows = list(csv.reader(io.StringIO(path.read_text(encoding="utf-8"))))
    what = rng.choice(("cell", "cell", "cell", "column", "header", "ragged", "sign", "long", "twice", "none", "rows"))
    row = rng.randrange(len(rows)) if rows else 0
    if not rows or not rows[row]:
        what = "none"
    if what == "cell":
        for _ in range(rng.choice((1, 1, 5))):
            one = rows[rng.randrange(len(rows))]
            if one:
                one[rng.randrange(len(one))] = rng.choice(_ODD_CELLS)
    elif what == "column":
        at, odd = rng.randrange(len(rows[0])), rng.choice(_ODD_CELLS)
        rows = [rows[0], *([*one[:at], odd, *one[at + 1 :]] for one in rows[1:])]
    elif what == "header":
        at = rng.randrange(len(rows[0]))
        rows[0][at] = rng.choice(("", "x", rows[0][0], rows[0][at].upper()))
    elif what == "ragged":
        rows[row] = rng.choice((rows[row][:-1], [*rows[row], "1"], []))
    elif what == "long":
        rows[row][0] = "1" * 200_000
    elif what == "twice":
        rows.append(rows[row])
    elif what == "none":
        rows = rows[:1]
    elif what == "rows":
        rows = [rows[0], *rng.sample(rows[1:], rng.randrange(len(rows)))]
    text = io.StringIO()
    csv.writer(text, delimiter=";" if what == "sign" else ",").writerows(rows)
    path.write_text(text.getvalue(), encoding="utf-8")


# --- HDF5 -------------------------------------------------------------------------------------------------------------


def odd_hdf5(path: Path, rng: random.Random) -> None:
    import h5py
    import numpy as np

    with h5py.File(path, "r+") as file:
        names: list[str] = []
        file.visit(names.append)
        name = rng.choice(names)
        item = file[name]
        what = rng.choice(
            ("remove", "type", "shape", "huge", "link", "group", "attribute", "values", "virtual", "text")
        )
        if what == "attribute":
            owner = rng.choice((file, item))
            attributes = [one for one in owner.attrs if one.isidentifier()]
            if attributes:
                one = rng.choice(attributes)
                odd = rng.choice((1e308, -1, "x", b"\xff\xfe", np.arange(5), "[[[", "a$\\bad{$b", np.nan, None))
                del owner.attrs[one]
                if odd is not None:
                    owner.attrs[one] = odd
            return
        if what == "values" and isinstance(item, h5py.Dataset) and item.size and item.dtype.kind in "iuf":
            odd = rng.choice((0, 255, 1e30, np.nan)) if item.dtype.kind == "f" else rng.choice((0, 1, 127))
            item[...] = odd
            return
        old = item[()] if isinstance(item, h5py.Dataset) and item.dtype.kind in "iuf" else np.zeros(3)
        del file[name]
        if what == "type":
            file[name] = rng.choice(
                (np.array(old).astype("S8"), np.array(old).astype("i1"), np.zeros(3, "c16"), "text")
            )
        elif what == "shape":
            file[name] = rng.choice(
                (np.zeros(()), np.zeros(0), np.ravel(old)[:-1], np.array(old)[None], np.zeros((3, 3)))
            )
        elif what == "huge":
            file.create_dataset(name, rng.choice(((10**7, 10**7), (2**31,), (40_000, 40_000))), "f8", chunks=True)
        elif what == "link":
            file[name] = rng.choice(
                (h5py.ExternalLink("/etc/passwd", "/x"), h5py.SoftLink("/nowhere"), h5py.SoftLink("/"))
            )
        elif what == "group":
            file.create_group(name)
        elif what == "text":
            file.create_dataset(name, data=["é", "b"], dtype=h5py.string_dtype())
        elif what == "virtual":
            layout = h5py.VirtualLayout(np.shape(old) or (1,), "f8")
            layout[...] = h5py.VirtualSource("other.h5", "x", np.shape(old) or (1,))
            file.create_virtual_dataset(name, layout)


# --- images -----------------------------------------------------------------------------------------------------------


def odd_image(path: Path, rng: random.Random) -> None:
    import cv2
    import numpy as np

    image = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    if image is None:
        raise ValueError("no image")
    what = rng.choice(
        ("header", "giant", "size", "colour", "depth", "black", "white", "tiny", "noise", "turned", "thin")
    )
    if what in {"header", "giant"} and path.suffix == ".png":
        content = bytearray(path.read_bytes())
        big = rng.choice((0, 1, 30_000, 2**31 - 1)) if what == "header" else 16_000
        content[16:24] = struct.pack(">II", big, rng.choice((big, image.shape[0])))
        content[29:33] = struct.pack(">I", zlib.crc32(content[12:29]))
        path.write_bytes(content)
        return
    if what == "giant":
        content = bytearray(path.read_bytes())
        frame = re.search(rb"\xff[\xc0\xc2]", bytes(content))
        if frame is not None:
            content[frame.start() + 5 : frame.start() + 9] = struct.pack(">HH", 65_000, rng.choice((65_000, 10)))
        path.write_bytes(content)
        return
    shape = image.shape
    changed = {
        "header": image,
        "size": lambda: image[: shape[0] // 2],
        "colour": lambda: np.dstack([image] * 3) if image.ndim == 2 else image[..., 0],
        "depth": lambda: image.astype(np.uint16) * 257,
        "black": lambda: image * 0,
        "white": lambda: image * 0 + 255,
        "tiny": lambda: image[:1, :1],
        "noise": lambda: np.random.default_rng(rng.randrange(99)).integers(0, 255, shape).astype(np.uint8),
        "turned": lambda: np.ascontiguousarray(np.rot90(image)),
        "thin": lambda: image[:, :2],
    }[what]
    coded = cv2.imencode(path.suffix if what != "depth" else ".png", changed() if callable(changed) else changed)[1]
    path.write_bytes(coded.tobytes())


BY_SUFFIX: dict[str, tuple[Damage, ...]] = {
    ".json": (odd_json,),
    ".toml": (odd_toml,),
    ".csv": (odd_csv,),
    ".nc": (odd_hdf5,),
    ".h5": (odd_hdf5,),
    ".png": (odd_image,),
    ".jpg": (odd_image,),
    ".tif": (odd_image,),
}
# What nothing reads back: truths, and results in the form of other programs.
_UNREAD = ("truth", "image_points_true", "camera_opencv", "cameras_colmap")
_TEXTS = frozenset({".json", ".toml", ".csv", ".txt"})


def spoil(folder: Path, rng: random.Random) -> str:
    """Damage one file of a folder.

    Returns: What was done to which, for the list of failures.
    """
    every = sorted(one for one in folder.rglob("*") if one.is_file() and not one.name.startswith(_UNREAD))
    suffix = rng.choice(sorted({one.suffix for one in every}))
    path = rng.choice([one for one in every if one.suffix == suffix])
    own = BY_SUFFIX.get(suffix, ())
    general = ANY + (ANY_TEXT if suffix in _TEXTS else ())
    damage = rng.choice(own) if own and rng.random() < 0.65 else rng.choice(general)
    state = rng.getstate()
    try:
        damage(path, rng)
    except (OSError, ValueError, KeyError, TypeError, RecursionError, OverflowError, UnicodeError, RuntimeError):
        # What an odder file is cannot be made with a library that refuses to write it.
        rng.setstate(state)
        if not path.exists():
            path.write_bytes(b"")
        put_in(path, rng)
    return f"{damage.__name__} {path.relative_to(folder)}"


def copy_of(folder: Path, to: Path) -> Path:
    """Copy a folder to spoil."""
    return Path(shutil.copytree(folder, to))


def _place(size: int, rng: random.Random) -> int:
    """Draw a place in a file, every second time near its beginning: that is where headers are."""
    return rng.randrange(max(min(size, 200) if rng.random() < 0.5 else size, 1))
