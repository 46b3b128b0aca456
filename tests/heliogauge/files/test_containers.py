"""Containers of other programs: nothing is fetched, waited for or believed that the file does not hold."""

import os
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import nullcontext
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from heliogauge.errors import InputError
from heliogauge.files import memory
from heliogauge.files.e57 import read_e57_columns
from heliogauge.files.meshes import read_triangles
from heliogauge.files.parquet import parquet_rows
from heliogauge.files.ply import checked_ply, read_ply_columns
from heliogauge.files.videos import open_video
from tests.heliogauge.files.e57_files import change_xml, write_e57

NAMESPACE = "http://www.astm.org/COMMIT/E57/2010-e57-v1.0"
#: The library holds Python's lock while it fetches or waits: only another process can see that it hangs.
READ = """
import sys
from pathlib import Path
from heliogauge.errors import InputError
from heliogauge.files.e57 import read_e57_columns
try:
    print(len(read_e57_columns(Path(sys.argv[1]))["x"]))
except InputError as error:
    print(error)
"""


def points(count: int = 3927) -> np.ndarray:
    return np.random.default_rng(0).uniform(-1.0, 1.0, (count, 3))


def read_elsewhere(path: Path) -> str:
    found = subprocess.run(
        [sys.executable, "-c", READ, str(path)], capture_output=True, text=True, timeout=60, check=True
    )
    return found.stdout


def with_document_type(xml: str, place: str) -> str:
    return xml.replace("<e57Root", f'<!DOCTYPE e57Root SYSTEM "{place}">\n<e57Root', 1)


def in_utf_16(xml: str, place: str) -> bytes:
    text = with_document_type(xml.replace("UTF-8", "UTF-16"), place)
    return ("\ufeff" + text).encode("utf-16-le")


def in_ebcdic(xml: str, place: str) -> bytes:
    return with_document_type(xml.replace("UTF-8", "IBM037"), place).encode("cp037")


def with_entity(xml: str, place: str) -> bytes:
    declared = f'<!DOCTYPE e57Root [<!ENTITY x SYSTEM "{place}">]>\n<e57Root'
    return xml.replace("<e57Root", declared, 1).replace("Scan 0]]>", "Scan 0]]>&x;").encode()


def with_schema(xml: str, place: str) -> bytes:
    words = f'xmlns:i="http://www.w3.org/2001/XMLSchema-instance" i:schemaLocation="{NAMESPACE} {place}"'
    return xml.replace('<e57Root type="Structure"', f'<e57Root type="Structure" {words}', 1).encode()


@pytest.fixture
def asked() -> Iterator[tuple[str, list[str]]]:
    """A server of this machine: its address, and what it was asked for."""
    paths: list[str] = []

    class Listening(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            paths.append(self.path)
            self.send_response(200)
            self.end_headers()

        def log_message(self, *_: object) -> None:
            """Say nothing."""

    server = ThreadingHTTPServer(("127.0.0.1", 0), Listening)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    yield f"http://127.0.0.1:{server.server_port}/secret", paths
    server.shutdown()
    server.server_close()


class TestE57:
    def test_points(self, tmp_path: Path) -> None:
        write_e57(tmp_path / "a.e57", points())
        found = read_e57_columns(tmp_path / "a.e57")
        np.testing.assert_allclose(np.column_stack([found[axis] for axis in "xyz"]), points(), atol=1e-6)
        # The same file with its XML written anew: the changes below are what is refused, not that it was changed.
        change_xml(tmp_path / "a.e57", lambda xml: xml)
        assert len(read_e57_columns(tmp_path / "a.e57")["x"]) == 3927

    def test_invalid_points_are_left_out_and_the_pose_is_applied(self, tmp_path: Path) -> None:
        state = np.zeros(3927, np.int8)
        state[:27] = 1
        write_e57(tmp_path / "a.e57", points(), cartesianInvalidState=state)
        turned = b'<w type="Float">0.7071067811865476</w>\n<x type="Float">0.7071067811865476</x>'
        change_xml(
            tmp_path / "a.e57",
            lambda xml: xml.replace(b'<w type="Float">1</w>\n          <x type="Float"/>', turned).replace(
                b'<translation type="Structure">\n          <x type="Float"/>',
                b'<translation type="Structure">\n<x type="Float">5</x>',
            ),
        )
        found = read_e57_columns(tmp_path / "a.e57")
        x, y, z = points()[27:].T
        # A quarter turn about x takes y to z and z to -y.
        np.testing.assert_allclose(np.array([found[axis] for axis in "xyz"]), [x + 5.0, -z, y], atol=1e-6)

    def test_spherical_coordinates(self, tmp_path: Path) -> None:
        """Range, azimuth from x towards y, elevation from the plane of x and y (ASTM E2807)."""
        names = {
            b"cartesianX": b"sphericalRange",
            b"cartesianY": b"sphericalAzimuth",
            b"cartesianZ": b"sphericalElevation",
        }
        write_e57(tmp_path / "a.e57", np.array([[2.0, np.pi / 2, 0.0], [3.0, 0.0, np.pi / 2], [1.0, np.pi, 0.1]]))

        def renamed(xml: bytes) -> bytes:
            for name, other in names.items():
                xml = xml.replace(name, other)
            return xml

        change_xml(tmp_path / "a.e57", renamed)
        found = read_e57_columns(tmp_path / "a.e57")
        expected = [[0.0, 2.0, 0.0], [0.0, 0.0, 3.0], [-np.cos(0.1), 0.0, np.sin(0.1)]]
        np.testing.assert_allclose(np.column_stack([found[axis] for axis in "xyz"]), expected, atol=1e-6)

    def test_fields_that_are_no_place(self, tmp_path: Path) -> None:
        write_e57(tmp_path / "a.e57", points(10))
        change_xml(tmp_path / "a.e57", lambda xml: xml.replace(b"cartesianX", b"intensity"))
        with pytest.raises(InputError, match="fields intensity, cartesianY, cartesianZ; x, y and z are needed"):
            read_e57_columns(tmp_path / "a.e57")

    @pytest.mark.parametrize(
        ("change", "words"),
        [
            (lambda xml, place: with_document_type(xml, place).encode(), "its XML names other files"),
            (with_entity, "its XML names other files"),
            (with_schema, "its XML names other files"),
            (in_utf_16, "not UTF-8"),
            (in_ebcdic, "not UTF-8"),
        ],
    )
    def test_nothing_is_fetched(
        self, tmp_path: Path, asked: tuple[str, list[str]], change: Callable[[str, str], bytes], words: str
    ) -> None:
        place, paths = asked
        write_e57(tmp_path / "a.e57", points())
        change_xml(tmp_path / "a.e57", lambda xml: change(xml.decode(), place))
        assert words in read_elsewhere(tmp_path / "a.e57")
        assert paths == []

    @pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no pipes with names on this system")
    def test_a_pipe_as_document_type_is_not_waited_for(self, tmp_path: Path) -> None:
        os.mkfifo(tmp_path / "pipe")
        write_e57(tmp_path / "a.e57", points())
        change_xml(tmp_path / "a.e57", lambda xml: with_document_type(xml.decode(), str(tmp_path / "pipe")).encode())
        assert "its XML names other files (<!DOCTYPE)" in read_elsewhere(tmp_path / "a.e57")

    @pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no pipes with names on this system")
    def test_a_pipe_is_not_waited_for(self, tmp_path: Path) -> None:
        os.mkfifo(tmp_path / "a.e57")
        assert "is a pipe (FIFO)" in read_elsewhere(tmp_path / "a.e57")

    @pytest.mark.parametrize(
        ("claimed", "words"),
        [
            ("4000", "claims 4000 points, holds 3927"),
            ("3928", "claims 3928 points, holds 3927"),
            ("392700000", "claims 392700000 points, which need 4712400000 bytes"),
            ("9" * 5000, "cannot be read as E57"),
            ("1e30", "cannot be read as E57"),
            ("-1", "cannot be read as E57"),
        ],
    )
    def test_claimed_points(self, tmp_path: Path, claimed: str, words: str) -> None:
        write_e57(tmp_path / "a.e57", points())
        count = f'recordCount="{claimed}"'.encode()
        change_xml(tmp_path / "a.e57", lambda xml: xml.replace(b'recordCount="3927"', count))
        with pytest.raises(InputError, match=words):
            read_e57_columns(tmp_path / "a.e57")

    def test_points_beyond_the_memory(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        write_e57(tmp_path / "a.e57", points(200_000))
        monkeypatch.setattr(memory, "free_bytes", lambda: 20 * memory.MIB)
        with pytest.raises(InputError, match="200000 points need"):
            read_e57_columns(tmp_path / "a.e57")

    @pytest.mark.parametrize(
        ("change", "words"),
        [
            (lambda content: content[:-2048], "is it copied completely"),
            (lambda content: content[:20], "cannot be read as E57"),
            (lambda content: b"nothing of the kind" * 9, "cannot be read as E57"),
            (lambda content: content[:32] + b"\xff" * 8 + content[40:], "bytes of XML"),
            (lambda content: content[:24] + b"\xff" * 8 + content[32:], "of XML from byte"),
            (lambda content: content[:2000] + b"\1\2\3" + content[2003:], "cannot be read as E57"),
        ],
    )
    def test_damaged(self, tmp_path: Path, change: Callable[[bytes], bytes], words: str) -> None:
        write_e57(tmp_path / "a.e57", points())
        (tmp_path / "a.e57").write_bytes(change((tmp_path / "a.e57").read_bytes()))
        with pytest.raises(InputError, match=words):
            read_e57_columns(tmp_path / "a.e57")

    def test_xml_of_a_million_levels(self, tmp_path: Path) -> None:
        write_e57(tmp_path / "a.e57", points())
        deep = b"<a>" * 100_000 + b"</a>" * 100_000
        change_xml(tmp_path / "a.e57", lambda xml: xml.replace(b"</e57Root>", deep + b"</e57Root>"))
        with pytest.raises(InputError, match="deep"):
            read_e57_columns(tmp_path / "a.e57")


class TestPly:
    HEAD = "ply\nformat {}\nelement vertex {}\nproperty double x\nproperty double y\nproperty double z\nend_header\n"

    @pytest.mark.parametrize("form", ["ascii 1.0", "binary_little_endian 1.0", "binary_big_endian 1.0"])
    def test_points(self, tmp_path: Path, form: str) -> None:
        table = points(50_000)
        body = "\n".join(" ".join(map(repr, row)) for row in table.tolist()).encode()
        if form.startswith("binary"):
            body = table.astype("<f8" if "little" in form else ">f8").tobytes()
        (tmp_path / "a.ply").write_bytes(self.HEAD.format(form, len(table)).encode() + body)
        found = read_ply_columns(tmp_path / "a.ply")
        np.testing.assert_array_equal(np.column_stack([found[axis] for axis in "xyz"]), table)

    def test_windows_lines_and_blank_lines(self, tmp_path: Path) -> None:
        text = self.HEAD.format("ascii 1.0", 2) + "1 2 3\n\n4 5 6\n"
        (tmp_path / "a.ply").write_bytes(text.replace("\n", "\r\n").encode())
        assert read_ply_columns(tmp_path / "a.ply")["y"].tolist() == [2.0, 5.0]

    @pytest.mark.parametrize("reader", [read_ply_columns, lambda path: checked_ply(path, path.read_bytes())])
    @pytest.mark.parametrize(
        ("count", "words"),
        [
            ("9" * 5000, "a whole number"),
            ("0" * 5000 + "1", "a whole number"),
            ("1e30", "a whole number"),
            ("-3", "a whole number"),
            ("\N{SUPERSCRIPT TWO}", "a whole number"),
            ("9" * 19, "cannot hold"),
            ("4", "cannot hold"),
        ],
    )
    @pytest.mark.parametrize("form", ["ascii 1.0", "binary_little_endian 1.0"])
    def test_claims(self, tmp_path: Path, form: str, count: str, words: str, reader: Callable[[Path], object]) -> None:
        body = b"1 2 3\n4 5 6\n7 8 9" if form.startswith("ascii") else bytes(3 * 24)
        (tmp_path / "a.ply").write_bytes(self.HEAD.format(form, count).encode("latin-1") + body)
        with pytest.raises(InputError, match=words):
            reader(tmp_path / "a.ply")

    @pytest.mark.parametrize("line", ["property", "property x", "element vertex", "property list uchar int q"])
    def test_odd_headers(self, tmp_path: Path, line: str) -> None:
        text = self.HEAD.format("ascii 1.0", 1).replace("end_header", f"{line}\nend_header") + "1 2 3 4 5\n"
        (tmp_path / "a.ply").write_text(text)
        with pytest.raises(InputError, match=r"are? needed|cannot be read"):
            read_ply_columns(tmp_path / "a.ply")

    @pytest.mark.parametrize("body", ["1 2 3\n4 5 6", "1 2 x\n4 5 6\n7 8 9\n", "1 2\n4 5\n7 8 9\n1 1 1 1 1"])
    def test_rows_that_are_missing_or_no_numbers(self, tmp_path: Path, body: str) -> None:
        (tmp_path / "a.ply").write_text(self.HEAD.format("ascii 1.0", 3) + body + " " * 99)
        with pytest.raises(InputError, match="the vertices cannot be read"):
            read_ply_columns(tmp_path / "a.ply")

    @pytest.mark.parametrize("count", [3, 300_000_000])
    def test_text_of_nearly_two_gigabytes(self, tmp_path: Path, count: int) -> None:
        """A sparse file: it takes no room on the disk, and must take none in memory."""
        with (tmp_path / "a.ply").open("wb") as file:
            file.write(self.HEAD.format("ascii 1.0", count).encode())
            file.truncate(1_900_000_000)
        code = (
            "import sys; from pathlib import Path; from heliogauge.errors import InputError\n"
            "from heliogauge.files.ply import read_ply_columns\n"
            "try: read_ply_columns(Path(sys.argv[1]))\n"
            "except InputError as error: print(error)\n"
            # The peak of this program alone: ru_maxrss holds that of the process it was started from.
            "print(next(one.split()[1] for one in open('/proc/self/status') if one.startswith('VmHWM')))"
        )
        found = subprocess.run(
            [sys.executable, "-c", code, str(tmp_path / "a.ply")],
            capture_output=True,
            text=True,
            timeout=120,
            check=True,
        )
        said, used = found.stdout.strip().splitlines()
        assert "cannot be read (a line of more than" in said or "vertices need" in said
        assert int(used) < 400_000


class Library:
    """Stands for open3d: keeps the file that it is given, and has no room for what is in it."""

    def __init__(self) -> None:
        self.handed: list[bytes] = []
        self.io = self.utility = self

    VerbosityLevel = SimpleNamespace(Error=0)

    def VerbosityContextManager(self, _: int) -> nullcontext[None]:  # as open3d calls it
        return nullcontext()

    def read_triangle_mesh(self, name: str) -> None:
        self.handed.append(Path(name).read_bytes())
        raise MemoryError("std::bad_alloc")


@pytest.mark.parametrize(
    "line",
    [
        "property float a element vertex 50000000",
        "property list uchar int a element vertex 50000000",
        "property list uchar a",
        "property many a",
        "dummy element vertex 50000000",
        "element vertex 50000000\x0bcomment",
        "element vertex 50000000",
    ],
)
@pytest.mark.parametrize("form", ["ascii", "binary_little_endian"])
def test_ply_with_elements_that_are_hidden_from_the_check(tmp_path: Path, form: str, line: str) -> None:
    """A library that reads word by word finds elements within a line, and makes room for them."""
    library = Library()
    head = f"ply\nformat {form} 1.0\nelement dummy 0\n{line}\nend_header\n"
    (tmp_path / "a.ply").write_bytes(head.encode() + b"0 0 0\n")
    with pytest.raises(InputError, match=r"needed|nothing that a PLY file says|cannot hold"):
        read_triangles(tmp_path / "a.ply", lambda: library)
    assert library.handed == []


def test_the_library_is_given_the_header_that_was_checked(tmp_path: Path) -> None:
    """It would end a comment of one word a line later, and put the properties to another element."""
    library = Library()
    says = ["element vertex 1", "property float x", "element face 0", "property list uchar int vertex_indices"]
    head = ["ply", "comment", "format binary_little_endian 1.0", *says[:2], "comment", *says[2:], "end_header", ""]
    (tmp_path / "a.ply").write_bytes("\r\n".join(head).encode() + b"\0\n\r\n")
    with pytest.raises(InputError, match=r"a\.ply: there is not enough memory"):
        read_triangles(tmp_path / "a.ply", lambda: library)
    expected = "\n".join(["ply", "format binary_little_endian 1.0", *says, "end_header", ""])
    assert library.handed == [expected.encode() + b"\0\n\r\n"]


@pytest.mark.parametrize("count", [2, 2**32 - 1])
def test_stl_that_claims_more_than_it_holds(tmp_path: Path, count: int) -> None:
    (tmp_path / "a.stl").write_bytes(bytes(80) + count.to_bytes(4, "little") + bytes(50))
    with pytest.raises(InputError, match=f"claims {count} triangles"):
        read_triangles(tmp_path / "a.stl", lambda: None)


class TestVideo:
    @pytest.fixture
    def handed(self, monkeypatch: pytest.MonkeyPatch) -> list[str]:
        """Names that the decoder is given; it opens none."""
        names: list[str] = []

        def capture(name: str, *_: int) -> object:
            names.append(name)
            raise cv2.error("no")

        monkeypatch.setattr(cv2, "VideoCapture", capture)
        return names

    def test_a_text_is_not_handed_to_the_decoder(self, tmp_path: Path, handed: list[str]) -> None:
        """The decoder knows descriptions of streams by a line, wherever in a text it stands."""
        text = b"Gv=0\nc=IN IP4 127.0.0.1\nm=video 5004 RTP/AVP 96\n".ljust(188, b" ") + b"G" * 2
        (tmp_path / "a.ts").write_bytes(text + b" " * 4000)
        with pytest.raises(InputError, match="cannot be opened as a video"):
            open_video(tmp_path / "a.ts")
        assert handed == []

    @pytest.mark.parametrize("size", [1, 188, 189, 752])
    def test_a_short_text_that_begins_like_a_packet_is_not_either(
        self, tmp_path: Path, handed: list[str], size: int
    ) -> None:
        (tmp_path / "a.ts").write_bytes(b"G" * size)
        with pytest.raises(InputError, match="cannot be opened as a video"):
            open_video(tmp_path / "a.ts")
        assert handed == []

    def test_a_stream_of_packets_is(self, tmp_path: Path, handed: list[str]) -> None:
        (tmp_path / "a.ts").write_bytes((b"G" + bytes(187)) * 9)
        with pytest.raises(InputError, match="cannot be opened as a video"):
            open_video(tmp_path / "a.ts")
        assert handed == [str(tmp_path / "a.ts")]

    def test_a_name_is_no_address(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, handed: list[str]) -> None:
        """FFmpeg reads ``subfile:`` and the like as the way to another file."""
        (tmp_path / "concat:a.mp4").write_bytes(b"\0\0\0\x18ftypisom")
        monkeypatch.chdir(tmp_path)
        with pytest.raises(InputError, match="cannot be opened"):
            open_video(Path("concat:a.mp4"))
        assert handed == [str(tmp_path / "concat:a.mp4")]


class TestParquet:
    def store(self, folder: Path, name: str, value: float) -> Path:
        connection = pytest.importorskip("duckdb").connect()
        folder.mkdir(parents=True, exist_ok=True)
        plain = folder.parent / "plain.parquet"
        connection.execute(f"COPY (SELECT {value} AS value) TO '{plain}' (FORMAT parquet)")
        return plain.replace(folder / name)

    def test_names_of_folders_and_patterns_mean_nothing(self, tmp_path: Path) -> None:
        folder = tmp_path / "value=9"
        file = self.store(folder, "[ab]*'.parquet", 1.5)
        self.store(folder, "a.parquet", 2.5)
        rows = pytest.importorskip("duckdb").connect().execute(f"SELECT value FROM {parquet_rows([file])}").fetchall()
        assert [float(value) for (value,) in rows] == [1.5]

    def test_damaged(self, tmp_path: Path) -> None:
        file = self.store(tmp_path / "rows", "a.parquet", 1.0)
        content = file.read_bytes()
        for damaged in (b"", content[:-1], content[4:], content[:-8] + b"\xff\xff\xff\x7fPAR1", b"PAR1" * 2):
            file.write_bytes(damaged)
            with pytest.raises(InputError, match="no whole Parquet file"):
                parquet_rows([file])
        with pytest.raises(InputError, match="no Parquet file was given"):
            parquet_rows([])

    @pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no pipes with names on this system")
    def test_a_pipe_is_not_waited_for(self, tmp_path: Path) -> None:
        os.mkfifo(tmp_path / "a.parquet")
        with pytest.raises(InputError, match=r"is a pipe \(FIFO\)"):
            parquet_rows([tmp_path / "a.parquet"])
