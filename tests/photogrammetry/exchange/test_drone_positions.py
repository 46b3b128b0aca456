"""Positions of a drone from tags of its photos, from DJI's logs and from tables."""

import struct
from pathlib import Path

import numpy as np
import pytest

from heliogauge.errors import InputError
from heliogauge.geometry.geodesy import geodetic_from_enu
from heliogauge.images.drone_tags import drone_tag
from photogrammetry.exchange.drone_positions import positions_of_photos, read_positions

ORIGIN = (50.9134, 6.3878, 87.0)
ENU_M = np.array([[-3.0, 0.2, 15.0], [0.0, -0.1, 15.2], [3.0, 0.0, 14.9]])
PLACES = geodetic_from_enu(ENU_M, ORIGIN)
DJI_SIGMA = [0.011, 0.012, 0.025]


def jpeg(*segments: bytes) -> bytes:
    parts = [b"\xff\xe1" + struct.pack(">H", len(one) + 2) + one for one in segments]
    return b"\xff\xd8" + b"".join(parts) + b"\xff\xd9"


def exif(latitude: float, longitude: float, altitude: float, order: str = "<") -> bytes:
    """Return the EXIF block of a position, to a millionth of a second and a millimetre."""
    degrees = b""
    for value in (abs(latitude), abs(longitude)):
        whole, minutes = int(value), int(value % 1 * 60)
        seconds = (value - whole - minutes / 60) * 3600
        degrees += struct.pack(order + "6I", whole, 1, minutes, 1, round(1e6 * seconds), 1000000)
    head = (b"II*\x00" if order == "<" else b"MM\x00*") + struct.pack(order + "I", 8)
    head += struct.pack(order + "HHHIII", 1, 0x8825, 4, 1, 26, 0)
    data = 26 + 2 + 6 * 12 + 4
    south, west = (b"N" if latitude >= 0 else b"S"), (b"E" if longitude >= 0 else b"W")
    gps = struct.pack(order + "H", 6)
    gps += struct.pack(order + "HHI", 1, 2, 2) + south + bytes(3) + struct.pack(order + "HHII", 2, 5, 3, data)
    gps += struct.pack(order + "HHI", 3, 2, 2) + west + bytes(3) + struct.pack(order + "HHII", 4, 5, 3, data + 24)
    gps += struct.pack(order + "HHI", 5, 1, 1) + bytes([altitude < 0, 0, 0, 0])
    gps += struct.pack(order + "HHII", 6, 5, 1, data + 48) + bytes(4)
    return b"Exif\x00\x00" + head + gps + degrees + struct.pack(order + "2I", round(1000 * abs(altitude)), 1000)


def xmp(k: int, *, as_elements: bool = False) -> bytes:
    said = {
        "GpsLatitude": f"{PLACES.latitude_deg[k]:+.9f}",
        "GpsLongitude": f"{PLACES.longitude_deg[k]:+.9f}",
        "AbsoluteAltitude": f"{PLACES.altitude_m[k]:+.4f}",
        "RtkStdLon": "0.011",
        "RtkStdLat": "0.012",
        "RtkStdHgt": "0.025",
    }
    texts = [
        f"<drone-dji:{name}>{value}</drone-dji:{name}>" if as_elements else f' drone-dji:{name}="{value}"'
        for name, value in said.items()
    ]
    return b"http://ns.adobe.com/xap/1.0/\x00<rdf:Description" + "".join(texts).encode() + b"/>"


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("place", [(50.91342, 6.38781, 102.003), (-33.5, -70.25, -4.5)])
def test_position_of_exif(order: str, place: tuple[float, float, float]) -> None:
    tag = drone_tag(jpeg(exif(*place, order)))
    assert tag is not None
    assert (tag.latitude_deg, tag.longitude_deg, tag.altitude_m) == pytest.approx(place, abs=1e-9)
    assert tag.sigma_m is None


@pytest.mark.parametrize("as_elements", [False, True])
def test_xmp_has_more_digits_and_sigmas(as_elements: bool) -> None:
    tag = drone_tag(jpeg(exif(1.0, 2.0, 3.0), xmp(1, as_elements=as_elements)))
    assert tag is not None
    assert tag.latitude_deg == pytest.approx(float(PLACES.latitude_deg[1]), abs=1e-9)
    assert tag.sigma_m == tuple(DJI_SIGMA)


@pytest.mark.parametrize("cut", range(0, 150, 7))
def test_damaged_tags_say_nothing(cut: int) -> None:
    whole = exif(50.0, 6.0, 100.0)
    assert drone_tag(b"\xff\xd8\xff\xe1\x00\x00" + whole[:cut]) is None
    assert drone_tag(b"no JPEG" + whole) is None


def test_positions_of_photos(tmp_path: Path) -> None:
    files = [tmp_path / f"DJI_000{k + 1}.JPG" for k in range(3)]
    for k, file in enumerate(files):
        file.write_bytes(jpeg(xmp(k)))
    files.append(tmp_path / "other.jpg")
    files[3].write_bytes(jpeg())
    found = positions_of_photos(files, 0.05)
    assert found.photos == tuple(file.name for file in files[:3])
    # East, north, up about another origin: the same to a tenth of a millimetre.
    np.testing.assert_allclose(np.diff(found.enu_m, axis=0), np.diff(ENU_M, axis=0), atol=2e-4)
    np.testing.assert_array_equal(found.sigma_m[0], DJI_SIGMA)
    with pytest.raises(InputError, match="no photo says in EXIF or XMP"):
        positions_of_photos(files[3:], 0.05)


def mrk(k: int, number: int) -> str:
    return (
        f"{number}\t261340.12{k}\t[2033]\t  -12,N\t    3,E\t  190,V\t{PLACES.latitude_deg[k]:.9f},Lat\t"
        f"{PLACES.longitude_deg[k]:.9f},Lon\t{PLACES.altitude_m[k]:.4f},Ellh\t0.012, 0.011, 0.025\t50,Q"
    )


def test_mrk_counts_photos_by_the_numbers_in_their_names(tmp_path: Path) -> None:
    log = tmp_path / "flight_Timestamp.MRK"
    log.write_text("\n".join(mrk(k, number) for k, number in enumerate((7, 8, 9))) + "\n")
    found = read_positions(log, [tmp_path / "DJI_0009.JPG", tmp_path / "DJI_20260101_0007_V.JPG"], 0.05)
    assert found.photos == ("DJI_0009.JPG", "DJI_20260101_0007_V.JPG")
    np.testing.assert_allclose(found.enu_m[0] - found.enu_m[1], ENU_M[2] - ENU_M[0], atol=2e-4)
    np.testing.assert_array_equal(found.sigma_m[0], DJI_SIGMA)
    in_order = read_positions(log, [tmp_path / f"{name}.png" for name in "abc"], 0.05)
    assert in_order.photos == ("a.png", "b.png", "c.png")
    with pytest.raises(InputError, match="3 lines for 2 photos"):
        read_positions(log, [tmp_path / "a.png", tmp_path / "b.png"], 0.05)
    log.write_text("7 what\n")
    with pytest.raises(InputError, match=r"line 1: not a line of a \.MRK file"):
        read_positions(log, [], 0.05)


def test_mrk_lines_without_a_position_or_a_sigma(tmp_path: Path) -> None:
    log = tmp_path / "flight.MRK"
    nowhere = "8\t261340.1\t[2033]\t0,N\t0,E\t0,V\t0.0,Lat\t0.0,Lon\t0.0,Ellh\t0.0, 0.0, 0.0\t0,Q"
    log.write_text("\n".join([mrk(0, 7).replace("0.012, 0.011, 0.025", "0.0, 0.0, 0.0"), nowhere, mrk(2, 9)]))
    found = read_positions(log, [tmp_path / f"DJI_000{k}.JPG" for k in (7, 8, 9)], 0.05)
    assert found.photos == ("DJI_0007.JPG", "DJI_0009.JPG")
    np.testing.assert_allclose(found.enu_m[1] - found.enu_m[0], ENU_M[2] - ENU_M[0], atol=2e-4)
    np.testing.assert_array_equal(found.sigma_m, [[0.05] * 3, DJI_SIGMA])


def test_mrk_that_cannot_be_meant(tmp_path: Path) -> None:
    log, one = tmp_path / "flight.MRK", [tmp_path / "DJI_0007.JPG"]
    log.write_text(f"{mrk(0, 7)}\n{mrk(1, 7)}\n")
    with pytest.raises(InputError, match="line 2: number 7 is given twice"):
        read_positions(log, one, 0.05)
    log.write_text(mrk(0, 7).replace(".025", ".0.25"))
    with pytest.raises(InputError, match="line 1: not a line"):
        read_positions(log, one, 0.05)
    log.write_text(mrk(0, 7))
    with pytest.raises(InputError, match=r"DJI_1_0007_V.JPG and DJI_2_0007_V.JPG have one number"):
        read_positions(log, [tmp_path / f"DJI_{k}_0007_V.JPG" for k in (1, 2)], 0.05)
    lenses = read_positions(log, [tmp_path / f"DJI_1_0007_{lens}.JPG" for lens in "VW"], 0.05)
    assert len(lenses.photos) == 2


def test_a_drone_without_a_position_yet() -> None:
    assert drone_tag(jpeg(exif(0.0, 0.0, 12.0))) is None


def test_tables(tmp_path: Path) -> None:
    table = tmp_path / "log.csv"
    table.write_text("image,east_m,north_m,up_m\na.png,1,2,3\nb.png,4,5,6\n")
    found = read_positions(table, [], 0.03)
    np.testing.assert_array_equal(found.enu_m, [[1, 2, 3], [4, 5, 6]])
    np.testing.assert_array_equal(found.sigma_m, np.full((2, 3), 0.03))
    rows = [f"{k}.png,{a:.9f},{b:.9f},{c:.4f},10,11,20" for k, (a, b, c) in enumerate(zip(*PLACES, strict=True))]
    head = "image,latitude_deg,longitude_deg,altitude_m,sigma_east_mm,sigma_north_mm,sigma_up_mm"
    table.write_text("\n".join([head, *rows]) + "\n")
    found = read_positions(table, [], 0.03)
    np.testing.assert_allclose(np.diff(found.enu_m, axis=0), np.diff(ENU_M, axis=0), atol=2e-4)
    np.testing.assert_allclose(found.sigma_m[2], [0.010, 0.011, 0.020])


SIGMAS = "sigma_east_mm,sigma_north_mm,sigma_up_mm"


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("image,x\na,1\n", "columns image, latitude_deg"),
        ("image,east_m,north_m,up_m\na,1,2,3\na,1,2,3\n", "given twice"),
        ("image,east_m,north_m,up_m\na,1,2,three\n", "'three' is not a number"),
        (f"image,east_m,north_m,up_m,{SIGMAS}\na,1,2,3,1,0,1\n", "a sigma above 0 is needed"),
    ],
)
def test_tables_that_cannot_be_meant(tmp_path: Path, text: str, said: str) -> None:
    table = tmp_path / "log.csv"
    table.write_text(text)
    with pytest.raises(InputError, match=said):
        read_positions(table, [], 0.03)


def test_turns_of_the_camera_are_read(tmp_path: Path) -> None:
    """Flying east and looking straight down the image's top is east and its right side south."""
    told = (
        b'http://ns.adobe.com/xap/1.0/\x00<rdf:Description drone-dji:GpsLatitude="1" drone-dji:GpsLongitude="2" '
        b'drone-dji:AbsoluteAltitude="3" drone-dji:GimbalYawDegree="+90.00" drone-dji:GimbalPitchDegree="-90.00" '
        b'drone-dji:GimbalRollDegree="+0.00"/>'
    )
    (tmp_path / "a.jpg").write_bytes(jpeg(told))
    (tmp_path / "b.jpg").write_bytes(jpeg(exif(1.0, 2.0, 3.0)))
    found = positions_of_photos([tmp_path / "a.jpg", tmp_path / "b.jpg"], 0.02)
    expected = np.array([[0.0, -1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
    turn = found.enu_from_camera(0)
    assert turn is not None
    np.testing.assert_allclose(turn, expected, atol=1e-12)
    assert found.enu_from_camera(1) is None
    table = tmp_path / "flight.csv"
    table.write_text("image,east_m,north_m,up_m,yaw_deg,pitch_deg,roll_deg\na.jpg,1,2,3,90,-90,0\n")
    again = read_positions(table, [tmp_path / "a.jpg"], 0.02).enu_from_camera(0)
    np.testing.assert_allclose(again, expected, atol=1e-12)
