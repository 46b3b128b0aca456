"""Printable sheets: true scale, the right ink, readable by the programs that will read them."""

import re
import shutil
import subprocess

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

from heliogauge.errors import InputError
from heliogauge.images.photos import read_image
from heliogauge.results.tables import read_table_csv
from photogrammetry import cli
from photogrammetry.targets.coded_targets import aicon_dictionary
from photogrammetry.targets.ring_codes import Polarity, RingCode, ink_at
from photogrammetry.targets.sheet_layout import Paper, board_page, marker_pages, ring_pages, ring_paths
from photogrammetry.targets.target_sheets import write_sheets
from photogrammetry.targets.vector_page import Area, Page, Path, disc, rectangle, to_pdf, to_svg

POINTS_PER_MM = 72 / 25.4
CODES = aicon_dictionary(12).codes


def polygon(path: Path, n: int = 12) -> np.ndarray:
    """Points of an outline, by evaluating its curves."""
    points = [np.array(path.start)]
    t = (np.arange(1, n + 1) / n)[:, None]
    for piece in path.pieces:
        last, control = points[-1], np.array(piece).reshape(-1, 2)
        if len(control) == 1:
            points.append(control[0])
        else:
            a, b, c = control
            points += list((1 - t) ** 3 * last + 3 * (1 - t) ** 2 * t * a + 3 * (1 - t) * t**2 * b + t**3 * c)
    return np.array(points)


def painted(page: Page, px_per_mm: int) -> np.ndarray:
    """A page as pixels, by OpenCV's polygons with 1/256 px."""
    image = np.full((round(page.height_mm * px_per_mm), round(page.width_mm * px_per_mm)), 255, dtype=np.uint8)
    for area in page.areas:
        for path in area.paths:
            corners = np.rint((polygon(path) * px_per_mm - 0.5) * 256).astype(np.int32)
            cv2.fillPoly(image, [corners], 255 * area.grey, cv2.LINE_AA, 8)
    return image


def test_a_disc_is_round() -> None:
    points = polygon(disc(20.0, 30.0, 10.0))
    assert np.abs(np.hypot(*(points - (20, 30)).T) - 10).max() < 2e-5


@pytest.mark.parametrize("index", [0, 2, 10, 146])
def test_ink_is_where_the_description_says(index: int) -> None:
    code = CODES[index]
    page = Page(40.0, 40.0, (Area(ring_paths(code, (20.0, 20.0), 5.0)),))
    dark = painted(page, 10) < 128
    y, x = np.mgrid[0:400, 0:400]
    # Page: y down; description: y up.
    wanted = ink_at(code, ((x + 0.5) / 10 - 20) / 5, -((y + 0.5) / 10 - 20) / 5)
    # OpenCV's polygons include their outline: half a pixel more.
    inner, outer = (change(wanted.astype(np.uint8), np.ones((3, 3))) > 0 for change in (cv2.erode, cv2.dilate))
    assert dark[inner].all()
    assert not dark[~outer].any()


def test_a_full_ring_has_no_seam_missing() -> None:
    page = Page(40.0, 40.0, (Area(ring_paths(RingCode("all", 0xFFF, 12), (20.0, 20.0), 5.0)),))
    angle = np.linspace(0, 2 * np.pi, 50)
    x, y = np.rint(200 + 125 * np.cos(angle)).astype(int), np.rint(200 + 125 * np.sin(angle)).astype(int)
    assert (painted(page, 10)[y, x] < 200).all()


def test_pdf_is_in_true_scale() -> None:
    """Numbers of the file itself: the page and the ruler in points."""
    (page,) = ring_pages(CODES[:3], 10.0, Paper("A4"), title="aicon-12")
    text = to_pdf([page]).decode("latin-1")
    box = [float(n) for n in re.search(r"/MediaBox \[([^\]]*)\]", text).group(1).split()]
    assert box == pytest.approx([0, 0, 210 * POINTS_PER_MM, 297 * POINTS_PER_MM], abs=1e-4)
    scale = float(re.search(r"([0-9.]+) 0 0 -([0-9.]+) 0 [0-9.]+ cm", text).group(1))
    assert scale == pytest.approx(POINTS_PER_MM, abs=1e-8)
    ruler = np.concatenate([polygon(path) for path in page.areas[-1].paths[:12]])
    assert np.ptp(ruler[:, 0]) == pytest.approx(100.0)
    upright = np.concatenate([polygon(path) for path in page.areas[-1].paths[12:]])
    assert np.ptp(upright[:, 1]) == pytest.approx(100.0)


def test_cross_reference_table_of_the_pdf() -> None:
    content = to_pdf(ring_pages(CODES[:30], 10.0, Paper("A4"), title="t"))
    start = int(content.rsplit(b"startxref\n", 1)[1].split()[0])
    assert content[start : start + 4] == b"xref"
    entries = re.findall(rb"(\d{10}) 00000 n ", content)
    for number, offset in enumerate(entries, start=1):
        assert content[int(offset) :].startswith(b"%d 0 obj" % number)
    assert b"/Count 2" in content


def test_svg_is_in_true_scale() -> None:
    text = to_svg(Page(210.0, 297.0, (Area((rectangle(10.0, 20.0, 30.0, 5.0),)),)))
    assert 'width="210mm" height="297mm" viewBox="0 0 210 297"' in text
    assert "M 10.00000 20.00000 L 40.00000 20.00000 L 40.00000 25.00000" in text


@pytest.mark.skipif(shutil.which("pdftoppm") is None, reason="pdftoppm (poppler-utils) draws the PDF")
def test_drawn_at_300_dpi_everything_has_its_size(tmp_path) -> None:
    (page,) = ring_pages(CODES[4:5], 20.0, Paper("A4"), title="aicon-12")
    write_sheets(tmp_path / "s", [page])
    command = ["pdftoppm", "-r", "300", "-gray", "-png", "-singlefile", str(tmp_path / "s" / "sheets.pdf")]
    subprocess.run([*command, str(tmp_path / "drawn")], check=True)
    image = read_image(tmp_path / "drawn.png").astype(float)
    assert image.shape == pytest.approx((297 / 25.4 * 300, 210 / 25.4 * 300), abs=1)
    dark = 1 - image / 255
    rows, columns = np.nonzero(dark[-300:] > 0.5)
    line = columns[rows == np.bincount(rows).argmax()]
    assert (np.ptp(line) + 1) / 300 * 25.4 == pytest.approx(100.0, abs=0.1)
    # The dot: area and centre of gravity of the component in the middle of the first target.
    left, top, *_ = Paper("A4").frame_mm
    x, y = ((place + 40) / 25.4 * 300 for place in (left, top))
    reach = int(1.3 * 10 / 25.4 * 300)
    window = dark[int(y) - reach : int(y) + reach, int(x) - reach : int(x) + reach]
    v, u = np.mgrid[0 : 2 * reach, 0 : 2 * reach]
    assert 2 * np.sqrt(window.sum() / np.pi) / 300 * 25.4 == pytest.approx(20.0, abs=0.02)
    assert (window * u).sum() / window.sum() + int(x) - reach == pytest.approx(x - 0.5, abs=0.1)
    assert (window * v).sum() / window.sum() + int(y) - reach == pytest.approx(y - 0.5, abs=0.1)


def test_opencv_reads_the_printed_markers() -> None:
    (page,) = marker_pages("DICT_APRILTAG_36h11", [0, 7, 586], 40.0, Paper("A4"))
    detector = cv2.aruco.ArucoDetector(cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11))
    corners, numbers, _ = detector.detectMarkers(painted(page, 4))
    assert sorted(np.ravel(numbers).tolist()) == [0, 7, 586]
    assert np.linalg.norm(corners[0][0][0] - corners[0][0][1]) / 4 == pytest.approx(40.0, abs=0.5)


def test_opencv_reads_the_printed_charuco_board() -> None:
    page = board_page("charuco", 6, 8, 25.0, Paper("A4"))
    table = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_5X5_100)
    board = cv2.aruco.CharucoBoard((6, 8), 25.0, 17.5, table)
    corners, numbers, *_ = cv2.aruco.CharucoDetector(board).detectBoard(painted(page, 4))
    assert len(numbers) == 35
    order = np.argsort(np.ravel(numbers))
    first, last = np.reshape(corners, (-1, 2))[order[[0, -1]]] / 4
    assert last - first == pytest.approx([4 * 25.0, 6 * 25.0], abs=0.1)


def test_opencv_finds_the_printed_circles() -> None:
    page = board_page("circles-asymmetric", 4, 11, 36.0, Paper("A4"))
    found, centers = cv2.findCirclesGrid(painted(page, 4), (4, 11), flags=cv2.CALIB_CB_ASYMMETRIC_GRID)
    assert found
    centers = np.reshape(centers, (-1, 2)) / 4
    assert centers[1] - centers[0] == pytest.approx([36.0, 0.0], abs=0.1)
    assert centers[4] - centers[0] == pytest.approx([18.0, 18.0], abs=0.1)


def test_chessboard_and_circles_have_their_pitch() -> None:
    squares = board_page("chessboard", 7, 9, 20.0, Paper("letter")).areas[0].paths
    assert len(squares) == 32
    assert np.ptp(polygon(squares[0]), axis=0) == pytest.approx([20.0, 20.0])
    circles = board_page("circles", 5, 6, 30.0, Paper("A4")).areas[0].paths
    assert np.ptp(polygon(circles[0]), axis=0) == pytest.approx([15.0, 15.0], abs=1e-3)


def test_white_on_black_is_the_negative() -> None:
    dark, light = (
        painted(ring_pages(CODES[:1], 10.0, Paper(), title="", polarity=polarity)[0], 4)[80:160, 120:240]
        for polarity in (Polarity.WHITE_ON_BLACK, Polarity.BLACK_ON_WHITE)
    )
    assert np.abs(dark[5:-5, 5:-5].astype(int) + light[5:-5, 5:-5] - 255).mean() < 4


def test_commands_write_a_whole_folder(tmp_path) -> None:
    out = tmp_path / "sheets"
    answer = CliRunner().invoke(
        cli.app, ["sheets", "-o", str(out), "--dictionary", "metashape-12", "--first", "5", "--last", "9"]
    )
    assert answer.exit_code == 0, answer.output
    assert sorted(path.name for path in out.iterdir()) == ["codes.csv", "sheet_01.svg", "sheets.pdf"]
    table = read_table_csv(out / "codes.csv")
    assert table["target"] == ["5", "6", "7", "8", "9"]
    assert int(table["bits_clockwise"][0], 2) == int(table["word"][0])
    again = CliRunner().invoke(cli.app, ["sheets", "-o", str(out), "--board", "chessboard"])
    assert isinstance(again.exception, InputError)
    forced = CliRunner().invoke(
        cli.app, ["sheets", "-o", str(out), "--dictionary", "DICT_4X4_50", "--first", "0", "--last", "3", "--force"]
    )
    assert forced.exit_code == 0, forced.output
    assert sorted(path.name for path in out.iterdir()) == ["sheet_01.svg", "sheets.pdf"]


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Paper("A9"), "A4, A3, letter"),
        (lambda: ring_pages(CODES[:1], 60.0, Paper(), title=""), "larger paper or smaller dots"),
        (lambda: ring_pages([], 10.0, Paper(), title=""), "at least one target"),
        (lambda: board_page("chessboard", 12, 9, 20.0, Paper()), "larger paper, turn it"),
        (lambda: board_page("triangles", 12, 9, 20.0, Paper()), "one of chessboard"),
        (lambda: board_page("circles", 2, 9, 20.0, Paper()), "3 columns and 3 rows"),
        (lambda: marker_pages("DICT_4X4_50", [50], 40.0, Paper()), "goes from 0 to 49"),
        (lambda: marker_pages("4X4", [1], 40.0, Paper()), "OpenCV's name"),
    ],
)
def test_impossible_sheets(make, message: str) -> None:
    with pytest.raises(InputError, match=message):
        make()
