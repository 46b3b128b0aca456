"""Several cameras, known cameras, priors, millimetres and EXIF, from files to results."""

import json
import struct

import numpy as np
import pytest

from heliogauge.camera.distortion import BrownDistortion, DistortionDirection
from heliogauge.camera.model import Camera
from heliogauge.errors import InputError
from heliogauge.images.exif import focal_length_35mm
from heliogauge.images.photos import write_image
from heliogauge.measurement.writer import dump_toml
from heliogauge.results.tables import read_cameras_json, read_table_csv, write_camera_json
from photogrammetry.image_points import ImagePoints
from photogrammetry.keys.cameras import NetworkCameraSection
from photogrammetry.keys.load import load_photogrammetry
from photogrammetry.pipeline.measure import run
from tests.photogrammetry.bundle_networks import network
from tests.photogrammetry.network_jobs import (
    command,
    fitted,
    length,
    points_of,
    sigmas_of,
    summary_of,
    views,
    write_job,
)

WIDE = Camera(6000, 4000, 6100.0, 6103.0, 3010.0, 1990.0, distortion=BrownDistortion(k1=-0.12, k2=0.08, p1=3e-4))
SMALL = Camera(3000, 2000, 2500.0, 2500.0, 1490.0, 1004.0, distortion=BrownDistortion(k1=0.05))
SIGMA_PX = 0.05


def two_cameras(rng, n_each=8, n_points=40):
    """Two cameras round one object, 2 m and 1.2 times that away."""
    points = np.column_stack([rng.uniform(-1, 1, (n_points, 2)), rng.uniform(-0.3, 0.3, n_points)])
    photo, target, pixels, names, states = [], [], [], [], []
    for k, (camera, prefix) in enumerate(((WIDE, "a"), (SMALL, "b"))):
        angles = 2 * np.pi * (np.arange(n_each) + 0.5 * k) / n_each * 2
        centers = [(1.9 * np.cos(a), 1.9 * np.sin(a), 1.5 + 0.4 * (i % 3)) for i, a in enumerate(angles)]
        state = views(rng, centers, points, [camera])
        states.append(state)
        for i in range(n_each):
            seen = camera.project(state.cam_from_world(i).apply(points))
            inside = np.nonzero(((seen > 0) & (seen < [camera.width_px - 1, camera.height_px - 1])).all(axis=1))[0]
            photo += [len(names)] * inside.size
            target += inside.tolist()
            pixels.append(seen[inside] + rng.normal(0, SIGMA_PX, (inside.size, 2)))
            names.append(f"{prefix}{i}.jpg")
    pixels = np.concatenate(pixels)
    covariance = np.broadcast_to(np.eye(2) * SIGMA_PX**2, (len(pixels), 2, 2))
    table = ImagePoints(tuple(names), tuple(f"t{i}" for i in range(n_points)), photo, target, pixels, covariance)
    return states[0], table


def bar(truth, a, b):
    return {"a": f"t{a}", "b": f"t{b}", "length_m": length(truth, a, b), "sigma_mm": 0.002}


def size(camera):
    return {"width_px": camera.width_px, "height_px": camera.height_px}


@pytest.mark.slow
def test_two_cameras_each_with_its_own_intrinsics(tmp_path):
    truth, points = two_cameras(np.random.default_rng(3))
    cameras = [
        {"name": "wide", "photos": ["a*"], **size(WIDE)},
        {"name": "small", "focal_px": 2450.0, **size(SMALL), "free": ["focal_px", "center_x_px", "center_y_px", "k1"]},
    ]
    folder = write_job(tmp_path / "in", points, camera=cameras, scale_bar=[bar(truth, 0, 1), bar(truth, 2, 3)])
    assert command(folder, tmp_path / "out") == 0
    summary = summary_of(tmp_path / "out")
    assert summary["doubts"] == []
    found, poses = read_cameras_json(tmp_path / "out" / "cameras.json")
    assert {name: pose.camera for name, pose in poses.items()} == {
        name: "wide" if name.startswith("a") else "small" for name in points.photos
    }
    for name, camera in (("wide", WIDE), ("small", SMALL)):
        sigma = found[name].sigma_parameters
        free = sigma > 0
        miss = (found[name].parameters - camera.parameters)[free] / sigma[free]
        assert np.abs(miss).max() < 4.5, name
    # The small camera's aspect was held: its two focal lengths move as one.
    assert found["small"].focal_x_px == found["small"].focal_y_px
    errors = fitted(points_of(tmp_path / "out"), truth.points_m)
    sigma = np.array(list(sigmas_of(tmp_path / "out").values()))
    # The scale is one draw for all: it alone may take a third of the sigma away.
    assert 0.5 < np.sqrt((errors**2).mean() / (sigma**2).mean()) < 1.4


@pytest.mark.slow
def test_a_known_camera_beside_an_unknown_one(tmp_path):
    truth, points = two_cameras(np.random.default_rng(4))
    write_camera_json(tmp_path / "wide.json", WIDE)
    cameras = [{"name": "wide", "photos": ["a*"], "file": "../wide.json"}, {"name": "small", **size(SMALL)}]
    folder = write_job(tmp_path / "in", points, camera=cameras, scale_bar=[bar(truth, 0, 1)])
    assert command(folder, tmp_path / "out") == 0
    found, _ = read_cameras_json(tmp_path / "out" / "cameras.json")
    np.testing.assert_array_equal(found["wide"].parameters, WIDE.parameters)
    assert summary_of(tmp_path / "out")["texts"]["camera"].startswith("wide: 6000 x 4000 px; estimated: nothing; small")


@pytest.mark.parametrize(
    ("cameras", "message"),
    [
        ([{"name": "x", "photos": ["a*"], **size(WIDE)}], "photo b0.jpg is of no camera"),
        (
            [{"name": "x", "photos": ["a*", "b*"], **size(WIDE)}, {"name": "y", "photos": ["b*"], **size(SMALL)}],
            "photo b0.jpg is named by x and y",
        ),
        ([{"name": "x", **size(WIDE)}, {"name": "y", **size(SMALL)}], "say which photos x, y took"),
        ([{"name": "x", "photos": ["a*"], **size(WIDE)}, {"name": "x", **size(SMALL)}], "2 cameras are called 'x'"),
        ([{"name": "x", "photos": ["c*"], **size(WIDE)}, {"name": "y", **size(WIDE)}], "no photo fits photos = c"),
        ([{"name": "x", **size(SMALL)}], "outside the image of 3000 x 2000 px"),
    ],
)
def test_cameras_that_do_not_fit_their_photos(tmp_path, capsys, cameras, message):
    _, points = two_cameras(np.random.default_rng(5), 4, 20)
    assert command(write_job(tmp_path / "in", points, camera=cameras), tmp_path / "out") == 2
    assert message in capsys.readouterr().err.replace("\n", " ")


@pytest.mark.slow
def test_prior_of_a_calibration_and_of_single_sigmas(tmp_path):
    """A prior that is off by three of its sigmas gives way as far as the network says; both ways give the same."""
    truth, points = network(np.random.default_rng(6), 10, 40, sigma_px=0.3)
    camera = truth.cameras[0]
    sigmas = np.array([2.0, 2.0, 1.0, 1.0])
    moved = camera.with_parameters(camera.parameters + np.array([6.0, 6.0, -3.0, 3.0, *[0] * 6]))
    # One focal length: both of the file's move together.
    root = np.zeros((10, 3))
    root[0, 0], root[1, 0], root[2, 1], root[3, 2] = 2.0 * camera.focal_x_px / camera.focal_y_px, 2.0, 1.0, 1.0
    free = ["focal_px", "center_x_px", "center_y_px"]
    found = []
    for name, own in (
        ("file", {"file": "../camera.json", "prior": True}),
        ("held", {"file": "../camera.json", "free": []}),
        ("sigma", {"file": "../camera.json", "sigma": dict(zip(free, sigmas[1:].tolist(), strict=True))}),
    ):
        write_camera_json(tmp_path / "camera.json", moved.with_covariance(root @ root.T))
        job = write_job(tmp_path / name, points, camera={"free": free, **own}, scale_bar=[bar(truth, 0, 1)])
        assert command(job, tmp_path / f"{name} out") == 0
        found.append(read_cameras_json(tmp_path / f"{name} out" / "cameras.json")[0]["camera"])
    np.testing.assert_array_equal(found[1].parameters, moved.parameters)
    np.testing.assert_allclose(found[0].parameters, found[2].parameters, rtol=1e-9)
    np.testing.assert_allclose(found[0].sigma_parameters, found[2].sigma_parameters, rtol=1e-6)
    # The network alone knows the camera to 1 px or so: the prior takes part, and never makes less certain.
    assert (found[0].sigma_parameters[1:4] < sigmas[1:]).all()
    assert np.abs(found[0].parameters - camera.parameters)[2] < 3.0


def test_prior_without_covariance_is_refused(tmp_path, capsys):
    truth, points = network(np.random.default_rng(6), 6, 20)
    write_camera_json(tmp_path / "camera.json", truth.cameras[0])
    job = write_job(tmp_path / "in", points, camera={"file": "../camera.json", "prior": True, "free": ["focal_px"]})
    assert command(job, tmp_path / "out") == 2
    assert "states no covariance" in capsys.readouterr().err


@pytest.mark.slow
@pytest.mark.parametrize("form", ["brown", "aicon"])
def test_millimetres_in_are_millimetres_out(tmp_path, form):
    """A camera given in another program's words, held: nothing of it changes, the network fits."""
    truth, points = network(
        np.random.default_rng(7), 8, 30, sigma_px=0.05, direction=DistortionDirection.MEASURED_TO_IDEAL
    )
    camera, pixel = truth.cameras[0], 0.006
    from heliogauge.camera.millimetres import SENSOR_NAMES, LensForm, Sensor, sensor_parameters

    zero = 12.0 if form == "aicon" else 0.0
    given = sensor_parameters(camera, Sensor(6000, 4000, pixel, LensForm(form), zero)).values.tolist()
    said = {
        "form": form,
        "pixel_mm": pixel,
        "focal_mm": given[0],
        "principal_mm": given[1:3],
        "radial": given[3:6],
        "tangential": given[6:8],
        "affine": given[8:10],
    }
    said |= {"zero_radius_mm": zero} if zero else {}
    job = write_job(
        tmp_path / "in",
        points,
        camera={**size(camera), "distortion_direction": "measured_to_ideal", "millimetres": said},
        scale_bar=[bar(truth, 0, 1)],
    )
    assert command(job, tmp_path / "out") == 0
    table = read_table_csv(tmp_path / "out" / "camera_millimetres.csv")
    assert tuple(table["name"]) == SENSOR_NAMES[LensForm(form)]
    np.testing.assert_allclose([float(cell) for cell in table["value"]], given, rtol=1e-9, atol=1e-15)
    assert summary_of(tmp_path / "out")["doubts"] == []


def test_the_direction_of_a_lens_in_millimetres_is_asked_for(tmp_path, capsys):
    """Before anything is measured: the job has no image points yet."""
    said = {"form": "aicon", "pixel_mm": 0.006, "focal_mm": 33.0}
    (tmp_path / "measurement.toml").write_text(
        dump_toml({"kind": "photogrammetry", "name": "job", "camera": {**size(WIDE), "millimetres": said}})
    )
    assert command(tmp_path, tmp_path / "out") == 2
    message = capsys.readouterr().err
    corrected, applied = message.split('"measured_to_ideal"')[1].split('"ideal_to_measured"')
    assert all(program in corrected for program in ("PhotoModeler", "DBAT", "Australis", "iWitness"))
    assert all(program in applied for program in ("AICON", "Metashape"))


def exif(focal, order="<"):
    """The beginning of a JPEG file whose EXIF block says a focal length on 35 mm film."""

    def pack(form, *values):
        return struct.pack(order + form, *values)

    inner = pack("H", 1) + pack("HHIHH", 0xA405, 3, 1, focal, 0) + pack("I", 0)
    outer = pack("H", 1) + pack("HHII", 0x8769, 4, 1, 26) + pack("I", 0)
    tiff = {"<": b"II*\x00", ">": b"MM\x00*"}[order] + pack("I", 8) + outer + inner
    block = b"Exif\x00\x00" + tiff
    return b"\xff\xd8\xff\xe1" + struct.pack(">H", len(block) + 2) + block + b"\xff\xd9"


@pytest.mark.parametrize("order", ["<", ">"])
def test_focal_length_of_exif(order):
    assert focal_length_35mm(exif(24, order)) == 24.0
    assert focal_length_35mm(exif(0, order)) is None
    for cut in range(4, 60, 5):
        assert focal_length_35mm(exif(24, order)[:cut]) in (None, 24.0)
    assert focal_length_35mm(b"\x89PNG") is None


def test_every_key_is_in_the_file_that_is_written(tmp_path):
    truth, points = network(np.random.default_rng(6), 6, 20)
    job = write_job(tmp_path / "in", points, camera=size(truth.cameras[0]), scale_bar=[bar(truth, 0, 1)])
    assert command(job, tmp_path / "out") == 0
    assert json.loads((tmp_path / "out" / "cameras.json").read_text())["cameras"].keys() == {"camera"}


@pytest.mark.slow
def test_a_photo_that_is_not_determined_is_left_out_and_named(tmp_path):
    """One photo by a camera of its own, free, with six targets: twelve coordinates for six of pose, eight of camera."""
    free = ["focal_px", "center_x_px", "center_y_px", "k1", "k2", "k3", "p1", "p2"]
    truth, points = two_cameras(np.random.default_rng(5))
    few = np.flatnonzero(points.photo_index == len(points.photos) - 1)[6:]
    weak = points.subset(np.setdiff1d(np.arange(points.n), few))
    cameras = [
        {"name": "wide", "photos": ["a*"], **size(WIDE), "focal_px": 6100.0, "free": free},
        {"name": "single", "photos": ["b7.jpg"], **size(SMALL), "focal_px": 2500.0, "free": free},
        {"name": "small", **size(SMALL), "focal_px": 2500.0, "free": free},
    ]
    job = write_job(tmp_path / "in", weak, camera=cameras, scale_bar=[bar(truth, 0, 9), bar(truth, 3, 17)])
    assert command(job, tmp_path / "out") == 0
    doubts = {one["code"]: one["text"] for one in summary_of(tmp_path / "out")["doubts"]}
    assert "b7.jpg" in doubts.get("not_determined_left_out", "") + doubts.get("photo_left_out", "")
    sigmas = sigmas_of(tmp_path / "out")
    assert len(sigmas) == 40
    assert all(np.isfinite(one).all() for one in sigmas.values())


@pytest.mark.parametrize("pattern", ["a*", "shots/a*.png", "*/a*"])
def test_photos_of_a_camera_are_named_as_those_of_the_images(pattern):
    section = NetworkCameraSection(name="wide", photos=(pattern,))
    assert section.took("shots/a0.png")
    assert not section.took("shots/b0.png")


def test_patterns_that_fit_no_photo_are_found_before_measuring(tmp_path):
    for name in ("a0.png", "b0.png"):
        write_image(tmp_path / name, np.zeros((32, 32), dtype=np.uint8))
    (tmp_path / "measurement.toml").write_text(
        'kind = "photogrammetry"\nname = "x"\n[images]\nphotos = "*.png"\n[targets]\ndictionary = "aicon-12"\n'
        '[[camera]]\nname = "wide"\nphotos = ["c*"]\n[[camera]]\nname = "rest"\n'
    )
    with pytest.raises(InputError, match=r"camera wide: no photo fits photos = c\*"):
        run(load_photogrammetry(tmp_path))
