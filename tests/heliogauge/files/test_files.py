"""The guarded way to files: kinds, sizes, and what damaged ones end in."""

import os
import signal
import struct
import subprocess
import sys
import threading
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pytest

from heliogauge.errors import InputError
from heliogauge.files import memory, regular
from heliogauge.files.arrays import read_arrays
from heliogauge.files.hdf5 import open_hdf5, read_netcdf
from heliogauge.files.image_headers import image_header
from heliogauge.files.own_folder import refuse_leading_out, refuse_links_out
from heliogauge.files.texts import read_csv, read_json, read_text, read_toml
from heliogauge.images.photos import read_image
from heliogauge.reporting.build import build_report
from heliogauge.results.opened import Result
from tests.heliogauge.view.served_results import slope_map, write_result


class TestRegular:
    @pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no pipes with names on this system")
    def test_pipe_is_not_waited_for(self, tmp_path: Path) -> None:
        os.mkfifo(tmp_path / "photo.png")
        with pytest.raises(InputError, match=r"photo.png: is a pipe \(FIFO\).* an image is needed"):
            read_image(tmp_path / "photo.png")

    @pytest.mark.skipif(not Path("/dev/zero").exists(), reason="no such device on this system")
    def test_device(self) -> None:
        with pytest.raises(InputError, match="is a device"):
            read_json(Path("/dev/zero"))

    def test_folder(self, tmp_path: Path) -> None:
        with pytest.raises(InputError, match="is a folder and cannot be read; a TOML file is needed"):
            read_toml(tmp_path)

    @pytest.mark.parametrize("name", ["absent", "x" * 300, "nul\0"])
    def test_absent(self, tmp_path: Path, name: str) -> None:
        with pytest.raises(InputError):
            read_text(tmp_path / name)

    def test_too_large(self, tmp_path: Path) -> None:
        (tmp_path / "m.toml").write_bytes(b"#" * 5 * 2**20)
        with pytest.raises(InputError, match=r"5.0 MiB; a TOML file of at most 1 MiB is read"):
            read_toml(tmp_path / "m.toml")

    def test_hole_of_a_terabyte(self, tmp_path: Path) -> None:
        with (tmp_path / "a.json").open("wb") as file:
            file.truncate(2**40)
        with pytest.raises(InputError, match="at most 256 MiB"):
            read_json(tmp_path / "a.json")

    def test_drive_that_does_not_answer(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        released = threading.Event()

        def hang(*_: object) -> int:
            released.wait(20)
            raise OSError  # a number would be taken for an open file, and closed

        monkeypatch.setattr(regular, "ANSWER_S", 0.05)
        monkeypatch.setattr(regular.os, "open", hang)
        try:
            with pytest.raises(InputError, match=r"the drive has not answered for 0 s; is it connected"):
                read_text(tmp_path / "a.txt")
        finally:
            released.set()

    def test_termination_while_a_drive_does_not_answer(self, repository: Path) -> None:
        program = (
            "import os, signal, sys, threading\n"
            "from pathlib import Path\n"
            "from heliogauge.files import regular\n"
            "from heliogauge.running.cli import _terminate\n"
            "signal.signal(signal.SIGTERM, _terminate)\n"
            "wait = threading.Event().wait\n"
            "def hang(*_):\n"
            "    print('waiting', flush=True)\n"
            "    wait()\n"
            "regular.os.open = hang\n"
            "regular.read_regular(Path('x'))\n"
        )
        environment = {**os.environ, "PYTHONPATH": str(repository)}
        command = [sys.executable, "-c", program]
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=environment) as process:
            assert process.stdout is not None
            assert process.stdout.readline() == "waiting\n"
            process.send_signal(signal.SIGTERM)
            assert process.wait(20) == 143


class TestMemory:
    def test_refuses_what_does_not_fit(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(memory, "_of_machine", lambda: 2**30)
        memory.refuse_large("a.json", 800 * 2**20, "its values")
        with pytest.raises(InputError, match=r"a.json: its values need 0.9 GiB of memory, 1.0 GiB are free"):
            memory.refuse_large("a.json", 900 * 2**20, "its values")

    def test_limit_of_the_process_counts(self) -> None:
        assert 0 < memory.free_bytes() <= memory._of_machine()


class TestTexts:
    @pytest.mark.parametrize(
        ("content", "says"),
        [
            (b"[" * 100_000, "nested"),
            (b'{"a":' * 500 + b"1" + b"}" * 500, "nested more than 200 deep"),
            (b'{"a": NaN}', "NaN is no number of JSON"),
            (b'{"a": -Infinity}', "Infinity is no number"),
            (b'{"a": ' + b"9" * 5000 + b"}", "beyond 64 bit"),
            (b'{"a": 99999999999999999999}', "beyond 64 bit"),
            (b'{"a": "\\ud800"}', "half a character"),
            (b'{"\\u0000": 1}', "holds NUL"),
            (b'{"a": 1', "not valid JSON"),
            (b"\xff\xfe{\0}\0", "byte 0 is not UTF-8"),
            (b"{}\0", "byte 2 is NUL"),
            (b"", "not valid JSON"),
        ],
    )
    def test_json(self, tmp_path: Path, content: bytes, says: str) -> None:
        (tmp_path / "a.json").write_bytes(content)
        with pytest.raises(InputError, match=rf"a\.json.*{says}"):
            read_json(tmp_path / "a.json")

    @pytest.mark.parametrize("digits", ["1e999", "-1e400"])
    def test_json_numbers_that_are_infinite_are_refused(self, tmp_path: Path, digits: str) -> None:
        (tmp_path / "a.json").write_text(f'{{"focal_px": {digits}}}')
        with pytest.raises(InputError, match=f"{digits} is beyond"):
            read_json(tmp_path / "a.json")

    def test_json_as_it_should_be(self, tmp_path: Path) -> None:
        (tmp_path / "a.json").write_text('\ufeff{"a": [1, 2.5, {"b": null}], "é": "\\ud83d\\ude00"}', encoding="utf-8")
        assert read_json(tmp_path / "a.json") == {"a": [1, 2.5, {"b": None}], "é": "\U0001f600"}
        (tmp_path / "a.json").write_text("[NaN, -Infinity]")
        values = read_json(tmp_path / "a.json", nan=True)
        assert np.isnan(values[0])
        assert values[1] == -np.inf

    @pytest.mark.parametrize(
        ("content", "says"),
        [
            (b"a = " + b"[" * 500 + b"]" * 500, "nested"),
            (b"a = " + b"[" * 50_000, "nested"),
            (b"a = " + b"9" * 30, "beyond 64 bit"),
            (b"a = " + b"9" * 5000, "not valid TOML"),
            (b'a = "\\u0000"', "holds NUL"),
            (b"a = \xff", "byte 4 is not UTF-8"),
            (b"a = = 1", "not valid TOML"),
            (b".".join([b"a"] * 3000) + b" = 1", "nested"),
        ],
    )
    def test_toml(self, tmp_path: Path, content: bytes, says: str) -> None:
        (tmp_path / "m.toml").write_bytes(content)
        with pytest.raises(InputError, match=rf"m\.toml.*{says}"):
            read_toml(tmp_path / "m.toml")

    @pytest.mark.parametrize(
        "key",
        [".".join("a" * 20), " . ".join(["'a'"] * 20), ".".join(['"a,\\"="'] * 20), "[" + ".".join("a" * 20) + "]"],
        ids=["bare", "spaced", "quoted", "table"],
    )
    def test_long_dotted_keys_are_refused_unread(self, tmp_path: Path, key: str) -> None:
        (tmp_path / "m.toml").write_text(f"x = 1.5\n{key}{'' if key.startswith('[') else ' = 1'}\n", encoding="utf-8")
        with pytest.raises(InputError, match=r"line 2: nested too deeply, more than 16 names"):
            read_toml(tmp_path / "m.toml")

    def test_points_in_texts_comments_and_numbers_are_no_keys(self, tmp_path: Path) -> None:
        points = "." * 40
        text = (
            f'# {points}\na = \'{points}\' # it\'s\nb = "\\"{points}"\nc = """\n""{points}"""\n'
            f"d = '''{points}'''\ne = [{', '.join(['1.5'] * 40)}]\nf.g.h = 1\n"
        )
        (tmp_path / "m.toml").write_text(text, encoding="utf-8")
        found = read_toml(tmp_path / "m.toml")
        assert found["a"] == found["d"] == points
        assert found["b"] == f'"{points}'
        assert len(found["e"]) == 40
        assert found["f"] == {"g": {"h": 1}}

    @pytest.mark.parametrize(
        ("content", "says"),
        [
            (b"a,b\n" + b"1" * 140_000 + b",2\n", "line 2: cannot be read as CSV"),
            (b'a,b\n"1,2\n3,4\n5,6\n', "is a quotation mark missing"),
            (b"a\n\xff\n", "byte 2 is not UTF-8"),
            ("a,b\n1,2\n".encode("utf-16-le"), "NUL"),
        ],
    )
    def test_csv(self, tmp_path: Path, content: bytes, says: str) -> None:
        (tmp_path / "t.csv").write_bytes(content)
        with pytest.raises(InputError, match=rf"t\.csv.*{says}"):
            read_csv(tmp_path / "t.csv")

    def test_csv_as_it_should_be(self, tmp_path: Path) -> None:
        (tmp_path / "t.csv").write_bytes(b'\xef\xbb\xbfa,b\r\n\r\n"x\ny",2\r\n3,4')
        assert read_csv(tmp_path / "t.csv") == [(1, ["a", "b"]), (4, ["x\ny", "2"]), (5, ["3", "4"])]

    def test_csv_signs_that_end_no_line(self, tmp_path: Path) -> None:
        text = "name,x\r\na\u2028b,1\rc\x85d,2\ne\x0cf,3\n"
        (tmp_path / "t.csv").write_text(text, encoding="utf-8", newline="")
        rows = [row for _, row in read_csv(tmp_path / "t.csv")]
        assert rows == [["name", "x"], ["a\u2028b", "1"], ["c\x85d", "2"], ["e\x0cf", "3"]]


class TestHdf5:
    @pytest.fixture
    def path(self, tmp_path: Path) -> Path:
        return tmp_path / "a.h5"

    def refused(self, path: Path, says: str) -> None:
        with pytest.raises(InputError, match=says), open_hdf5(path) as file:
            file["a"][...]

    def test_external_link(self, path: Path) -> None:
        with h5py.File(path.with_name("secret.h5"), "w") as file:
            file["a"] = 1
        with h5py.File(path, "w") as file:
            file["g/a"] = h5py.ExternalLink("secret.h5", "/a")
        self.refused(path, r"/g/a leads elsewhere \(link to '/a' in 'secret.h5'\)")

    def test_soft_link(self, path: Path) -> None:
        with h5py.File(path, "w") as file:
            file["a"] = h5py.SoftLink("/a")
        self.refused(path, "leads elsewhere")

    def test_external_storage(self, path: Path) -> None:
        with h5py.File(path, "w") as file:
            file.create_dataset("a", (10,), "u1", external=[("/etc/passwd", 0, 10)])
        self.refused(path, "/a: its values are in another file")

    def test_virtual_array(self, path: Path) -> None:
        layout = h5py.VirtualLayout((10,), "u1")
        layout[:] = h5py.VirtualSource("other.h5", "a", (10,))
        with h5py.File(path, "w") as file:
            file.create_virtual_dataset("a", layout)
        self.refused(path, "/a: its values are in another file")

    def test_shape_that_no_memory_holds(self, path: Path) -> None:
        with h5py.File(path, "w") as file:
            file.create_dataset("a", (10**6, 10**6), "f8", chunks=(100, 100))
        self.refused(path, "arrays of at most 4096 MiB")

    def test_chunk_that_no_memory_holds(self, path: Path) -> None:
        with h5py.File(path, "w") as file:
            file.create_dataset("a", (10,), "f8", chunks=(2**26,), maxshape=(None,))
        self.refused(path, "stored in chunks of 512 MiB")

    def test_ring_of_groups_ends(self, path: Path) -> None:
        with h5py.File(path, "w") as file:
            file["a"] = 3
            group = file.create_group("g")
            group["g"] = group
        with open_hdf5(path) as file:
            assert file["a"][()] == 3

    @pytest.mark.parametrize("raises", [KeyError("x"), RuntimeError("x"), OSError("x"), AttributeError("x")])
    def test_faults_while_reading(self, path: Path, raises: Exception) -> None:
        h5py.File(path, "w").close()
        with pytest.raises(InputError, match=r"a.h5: not a readable HDF5"), open_hdf5(path):
            raise raises

    def test_no_hdf5(self, path: Path) -> None:
        path.write_bytes(b"\x89HDF\r\n\x1a\n" + bytes(200))
        self.refused(path, r"a.h5: not a readable HDF5")
        with pytest.raises(InputError, match=r"a.h5: not a readable"):
            read_netcdf(path)


class TestArrays:
    def test_as_it_should_be(self, tmp_path: Path) -> None:
        np.savez_compressed(tmp_path / "a.npz", x=np.arange(3), y=np.eye(2))
        read = read_arrays(tmp_path / "a.npz", ("y", "x"))
        assert list(read) == ["y", "x"]
        assert (read["y"] == np.eye(2)).all()

    def test_objects_are_not_unpickled(self, tmp_path: Path) -> None:
        np.savez(tmp_path / "a.npz", x=np.array([{}], dtype=object))
        with pytest.raises(InputError, match=r"a.npz: cannot be read"):
            read_arrays(tmp_path / "a.npz", ("x",))

    def test_lacking(self, tmp_path: Path) -> None:
        np.savez(tmp_path / "a.npz", x=np.arange(3))
        with pytest.raises(InputError, match=r"a.npz: lacks y"):
            read_arrays(tmp_path / "a.npz", ("x", "y"))

    def test_header_claims_more_than_there_is(self, tmp_path: Path) -> None:
        head = b"{'descr': '<f8', 'fortran_order': False, 'shape': (1000000000000,), }"
        with zipfile.ZipFile(tmp_path / "a.npz", "w") as archive:
            archive.writestr("x.npy", b"\x93NUMPY\1\0" + struct.pack("<H", len(head)) + head)
        with pytest.raises(InputError, match=r"shape \(1000000000000,\) of float64 is not in it"):
            read_arrays(tmp_path / "a.npz", ("x",))

    @pytest.mark.parametrize("share", [0.0, 0.3, 0.9])
    def test_cut_off(self, tmp_path: Path, share: float) -> None:
        np.savez_compressed(tmp_path / "a.npz", x=np.random.default_rng(0).random(1000))
        content = (tmp_path / "a.npz").read_bytes()
        (tmp_path / "a.npz").write_bytes(content[: int(share * len(content))])
        with pytest.raises(InputError, match=r"a.npz: cannot be read"):
            read_arrays(tmp_path / "a.npz", ("x",))


def png(width: int, height: int, data: bytes, depth: int = 8, colours: int = 0) -> bytes:
    """A PNG of any claims."""

    def part(name: bytes, content: bytes) -> bytes:
        return struct.pack(">I", len(content)) + name + content + struct.pack(">I", zlib.crc32(name + content))

    header = struct.pack(">IIBBBBB", width, height, depth, colours, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + part(b"IHDR", header) + part(b"IDAT", data) + part(b"IEND", b"")


class TestImages:
    @pytest.mark.slow
    def test_raster_of_a_gigapixel_in_a_small_file(self, tmp_path: Path) -> None:
        rows = zlib.compressobj(9)
        data = b"".join(rows.compress(bytes(30_001 * 100)) for _ in range(300)) + rows.flush()
        (tmp_path / "a.png").write_bytes(png(30_000, 30_000, data))
        with pytest.raises(InputError, match=r"30000 x 30000 px are 900 million; at most 268 million are read: reduce"):
            read_image(tmp_path / "a.png")

    def test_raster_that_the_file_cannot_hold(self, tmp_path: Path) -> None:
        (tmp_path / "a.png").write_bytes(png(16_000, 16_000, zlib.compress(bytes(100)), 16, 2))
        with pytest.raises(InputError, match=r"16000 x 16000 px, which \d+ bytes cannot hold"):
            read_image(tmp_path / "a.png")

    def test_raster_that_the_memory_cannot_hold(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(memory, "_of_machine", lambda: 30 * 2**20)
        (tmp_path / "a.png").write_bytes(png(6000, 6000, zlib.compress(bytes(6001 * 6000))))
        with pytest.raises(InputError, match=r"6000 x 6000 px need 0.0 GiB of memory, 0.0 GiB are free"):
            read_image(tmp_path / "a.png")

    @pytest.mark.parametrize("suffix", [".png", ".jpg", ".tif", ".bmp"])
    @pytest.mark.parametrize("channels", [1, 3])
    def test_header_of_each_form(self, suffix: str, channels: int) -> None:
        import cv2

        image = np.zeros((37, 53, channels), np.uint8)
        content = cv2.imencode(suffix, image)[1].tobytes()
        header = image_header(content)
        assert header is not None
        assert (header.width_px, header.height_px, header.depth_bytes) == (53, 37, 1)
        assert header.stored_share >= 1
        if suffix != ".bmp":
            assert header.channels == channels

    @pytest.mark.parametrize("suffix", [".png", ".tif"])
    def test_sixteen_bits(self, suffix: str) -> None:
        import cv2

        header = image_header(cv2.imencode(suffix, np.zeros((3, 5), np.uint16))[1].tobytes())
        assert header is not None
        assert (header.width_px, header.height_px, header.depth_bytes) == (5, 3, 2)

    def test_every_beginning_of_a_file_is_no_crash(self) -> None:
        import cv2

        for suffix in (".png", ".jpg", ".tif", ".bmp"):
            content = cv2.imencode(suffix, np.zeros((3, 5), np.uint8))[1].tobytes()
            for size in range(0, len(content), 7):
                image_header(content[:size])


class TestLinks:
    def test_link_out_of_the_folder(self, tmp_path: Path) -> None:
        (tmp_path / "secret").write_text("x")
        folder = tmp_path / "folder"
        (folder / "inner").mkdir(parents=True)
        (folder / "a").write_text("a")
        (folder / "inside").symlink_to("a")
        refuse_links_out(folder)
        refuse_leading_out(folder, [folder / "a", folder / "inside", folder / ".." / "secret", folder / "absent"])
        (folder / "inner" / "out").symlink_to("../../secret")
        with pytest.raises(InputError, match="inner/out: a symbolic link leads out"):
            refuse_links_out(folder)

    @pytest.mark.parametrize("read", [build_report, Result])
    def test_results_with_a_link_out_of_them(self, tmp_path: Path, read: Callable[[Path], object]) -> None:
        folder = tmp_path / "folder"
        write_result(folder, "mirror", slope_map(), 1e-3)
        read(folder)
        (tmp_path / "secret.csv").write_text("secret")
        (folder / "points.csv").symlink_to("../secret.csv")
        with pytest.raises(InputError, match=r"points.csv: a symbolic link leads out of .*folder.*copy the file"):
            read(folder)

    def test_links_within_what_was_named(self, tmp_path: Path) -> None:
        (tmp_path / "one").mkdir()
        (tmp_path / "other").write_text("x")
        (tmp_path / "one" / "a").symlink_to("../other")
        refuse_links_out(tmp_path / "one", tmp_path)
        with pytest.raises(InputError, match="leads out"):
            refuse_links_out(tmp_path / "one")

    def test_folder_that_is_a_link_itself(self, tmp_path: Path) -> None:
        (tmp_path / "real").mkdir()
        (tmp_path / "real" / "a").write_text("a")
        (tmp_path / "named").symlink_to("real")
        refuse_leading_out(tmp_path / "named", [tmp_path / "named" / "a"])

    def test_folder_on_the_way_is_a_link(self, tmp_path: Path) -> None:
        (tmp_path / "photos").mkdir()
        (tmp_path / "folder").mkdir()
        (tmp_path / "folder" / "photos").symlink_to("../photos")
        with pytest.raises(InputError, match="leads out"):
            refuse_leading_out(tmp_path / "folder", [tmp_path / "folder" / "photos" / "a.png"])
