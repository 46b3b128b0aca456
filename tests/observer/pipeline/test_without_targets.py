"""Flights without marked targets: corners of panels, positions and turns of the drone, from folder to slopes."""

import csv
import struct
from pathlib import Path

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

from data_synth.troughs import TroughChoice, TroughOptions, read_trough_truth, trough_scene, write_trough_dataset
from heliogauge.errors import EstimationError, InputError
from heliogauge.geometry.rigid import RigidTransform
from heliogauge.measurement.load import load
from heliogauge.results.slope_map_file import read_slope_map
from heliogauge.running.cli import app
from heliogauge.running.progress import SilentProgress
from observer import Options, Result, run
from observer.pipeline.corners import find_corners
from observer.pipeline.inputs import read_inputs

MOUNTING_M = 1.5e-3


@pytest.fixture(scope="module")
def flight(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("natural") / "flight"
    choice = TroughChoice(2, n_photos=12, dictionary="none", mounting_m=MOUNTING_M)
    options = TroughOptions(2, rtk_sigma_m=0.02, gimbal_sigma_rad=0.025)
    write_trough_dataset(folder, trough_scene("small", choice), options)
    return folder


@pytest.fixture(scope="module")
def measured(flight: Path) -> Result:
    return run(load(flight), Options(jobs=1))


@pytest.mark.slow
def test_corners_are_where_the_truth_has_them(flight: Path, measured: Result) -> None:
    truth, points = read_trough_truth(flight).parameters, measured.network.measured.points
    errors = []
    for name, photo in truth["photos"].items():
        pose = RigidTransform.from_rotation_vector(*photo["cam_from_trough"].values())
        for k in np.flatnonzero(np.array(points.photos)[points.photo_index] == name):
            place = np.array(truth["corners_m"][points.targets[points.target_index[k]]])
            errors.append(points.pixels_px[k] - measured.network.camera.project(pose.apply(place)))
    far = np.linalg.norm(errors, axis=1)
    assert len(far) > 0.9 * 12 * 15
    assert np.mean(far < 1) >= 0.98
    assert np.median(far) < 0.1


@pytest.mark.slow
def test_poses_are_within_their_sigmas_in_the_frame_of_the_drawing(flight: Path, measured: Result) -> None:
    truth, bundle = read_trough_truth(flight).parameters["photos"], measured.network.solved.bundle
    assert len(bundle.cam_from_world) == 12
    ratios = []
    for k, name in enumerate(bundle.problem.observations.photos):
        true = RigidTransform.from_rotation_vector(*truth[name]["cam_from_trough"].values())
        found = bundle.cam_from_world[k]
        turn = RigidTransform(found.rotation @ true.rotation.T, np.zeros(3)).rotation_vector_rad
        step = np.concatenate([turn, found.translation_m - true.translation_m])
        covariance = bundle.covariance.joint((), np.array([k]))
        ratios.append(float(step @ np.linalg.solve(covariance, step)))
    # Photos share the frame's error: one chi-square of six, of which 99.9 % are below 22.
    assert np.median(ratios) < 22
    solution = measured.absorber_solution
    assert solution is not None
    off = np.concatenate([solution.path.x_m, solution.path.z_m - 1.49])
    sigma = np.concatenate(solution.path.sigma_at(solution.path.y_m))
    assert np.median(np.abs(off) / sigma) < 3
    assert np.median(sigma) < 3e-3


def _tagged(photo: Path, place: dict[str, str], sigmas_m: tuple[float, float, float]) -> bytes:
    """Return a photo as a drone writes it: JPEG with DJI's tags."""
    _, jpeg = cv2.imencode(".jpg", cv2.imread(str(photo), cv2.IMREAD_UNCHANGED), [cv2.IMWRITE_JPEG_QUALITY, 98])
    said = {
        "GpsLatitude": place["latitude_deg"],
        "GpsLongitude": place["longitude_deg"],
        "AbsoluteAltitude": place["altitude_m"],
        **dict(zip(("RtkStdLon", "RtkStdLat", "RtkStdHgt"), map(str, sigmas_m), strict=True)),
        **{f"Gimbal{axis.capitalize()}Degree": place[f"{axis}_deg"] for axis in ("yaw", "pitch", "roll")},
    }
    texts = "".join(f' drone-dji:{name}="{value}"' for name, value in said.items())
    block = b"http://ns.adobe.com/xap/1.0/\x00<rdf:Description" + texts.encode() + b"/>"
    return b"\xff\xd8\xff\xe1" + struct.pack(">H", len(block) + 2) + block + jpeg.tobytes()[2:]


@pytest.mark.slow
def test_photos_of_a_drone_are_all_the_command_needs(flight: Path, measured: Result, tmp_path: Path) -> None:
    """Places, their sigmas and turns in the photos' own tags: the same slopes as from the table, by the command."""
    drone = tmp_path / "drone"
    drone.mkdir()
    with (flight / "positions.csv").open() as file:
        places = list(csv.DictReader(file))
    lines = []
    for k, place in enumerate(places):
        (drone / f"DJI_{k + 1:04}.JPG").write_bytes(_tagged(flight / place["image"], place, (0.021, 0.022, 0.023)))
        at = f"{place['latitude_deg']},Lat\t{place['longitude_deg']},Lon\t{place['altitude_m']},Ellh"
        lines.append(f"{k + 1}\t261340.12{k}\t[2033]\t0,N\t0,E\t0,V\t{at}\t0.022, 0.021, 0.023\t50,Q")
    toml = (flight / "measurement.toml").read_text().replace("photo_*.png", "*.JPG")
    toml = toml.replace('[positions]\nfile = "positions.csv"', "[positions]").replace(
        "[images]", '[images]\nencoding = "linear"'
    )
    (drone / "measurement.toml").write_text(toml)
    searched = read_inputs(load(drone), SilentProgress()).corners
    assert searched is not None
    np.testing.assert_array_equal(searched.positions.sigma_m, np.tile([0.021, 0.022, 0.023], (12, 1)))
    done = CliRunner().invoke(
        app, ["observer", "measure", str(drone), "-o", str(tmp_path / "out"), "--no-report", "-q"]
    )
    assert done.exit_code == 0, done.output
    found, known = read_slope_map(tmp_path / "out" / "slope_map.nc"), measured.slope_map
    difference = found.slope_error_x - known.slope_error_x
    both = np.isfinite(difference)
    assert both.sum() > 0.9 * np.isfinite(known.slope_error_x).sum()
    # The same light through JPEG: less than the sigmas of either.
    assert np.mean((difference / known.sigma_slope()[0])[both] ** 2) < 0.5
    # The log beside the photos says the same places.
    (drone / "flight.MRK").write_text("\n".join(lines) + "\n")
    (drone / "measurement.toml").write_text(toml.replace("[positions]", '[positions]\nfile = "flight.MRK"'))
    logged = read_inputs(load(drone), SilentProgress()).corners
    assert logged is not None
    np.testing.assert_allclose(logged.positions.enu_m, searched.positions.enu_m, atol=1e-6)
    np.testing.assert_array_equal(logged.positions.sigma_m, searched.positions.sigma_m)


@pytest.mark.slow
def test_a_rolling_shutter_is_found_by_the_corners(tmp_path: Path) -> None:
    """40 mm of flight over a frame: at rest, corners of the outer rows are refused as far from the drawing."""
    choice = TroughChoice(2, n_photos=8, dictionary="none", mounting_m=MOUNTING_M)
    scene = trough_scene("small", choice).with_rolling_shutter(0.02)
    write_trough_dataset(tmp_path / "flight", scene, TroughOptions(2, rtk_sigma_m=0.02, gimbal_sigma_rad=0.025))
    with (tmp_path / "flight" / "measurement.toml").open("a") as file:
        file.write("\n[rolling_shutter]\nspeed_m_s = 2.0\n")
    result = run(load(tmp_path / "flight"), Options(jobs=1))
    motions, observations = result.motions, result.network.solved.bundle.problem.observations
    assert motions is not None
    assert len(motions.photos) == 8
    # 107 of 120; held to the drawing as a camera at rest 83 are left.
    assert observations.n > 0.8 * 8 * 15
    assert motions.sigma_readout < 2e-3
    assert abs(motions.readout - 0.02) < 4 * motions.sigma_readout


@pytest.mark.slow
def test_a_wrong_azimuth_is_named(flight: Path) -> None:
    toml = flight / "measurement.toml"
    said = toml.read_text()
    try:
        toml.write_text(said.replace("azimuth_deg = 8.0", "azimuth_deg = 55.0"))
        with pytest.raises(EstimationError, match="corners:"):
            run(load(flight), Options(jobs=1))
    finally:
        toml.write_text(said)


@pytest.mark.slow
def test_photos_without_turns_of_the_camera_are_placed_all_the_same(flight: Path) -> None:
    table = flight / "positions.csv"
    text = table.read_text()
    try:
        table.write_text("\n".join(line.rsplit(",", 3)[0] for line in text.splitlines()) + "\n")
        inputs = read_inputs(load(flight), SilentProgress())
        files = inputs.survey.photo_files
        assert inputs.corners is not None
        look = find_corners(files, inputs.finder, inputs.corners, jobs=1, progress=SilentProgress())
    finally:
        table.write_text(text)
    truth = read_trough_truth(flight).parameters["photos"]
    assert len(look.poses) == len(files)
    for name, pose in look.poses.items():
        true = RigidTransform.from_rotation_vector(*truth[name]["cam_from_trough"].values())
        # Corners of panels that are 1.5 mm off; a half turn, or the next panel, would be metres.
        assert np.linalg.norm(pose.inverse().translation_m - true.inverse().translation_m) < 0.1


@pytest.mark.slow
def test_a_photo_that_was_taken_elsewhere_is_left_out_with_the_reason(flight: Path) -> None:
    table = flight / "positions.csv"
    text = table.read_text()
    lines = text.splitlines()
    cells = lines[6].split(",")
    # A metre further north: less than a panel's width, and not where its panels' edges say.
    cells[1] = f"{float(cells[1]) + 1.0 / 111e3:.9f}"
    lines[6] = ",".join(cells)
    try:
        table.write_text("\n".join(lines) + "\n")
        result = run(load(flight), Options(jobs=1))
    finally:
        table.write_text(text)
    [doubt] = [one for one in result.doubts if one.code == "photos_without_corners"]
    assert cells[0] in doubt.text
    assert cells[0] not in result.network.solved.bundle.problem.observations.photos


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ("", "corners"),
        ("[corners]\nazimuth_deg = 0.0\n", "positions"),
        ('[corners]\nazimuth_deg = 0.0\n[targets]\ndictionary = "aicon-12"\n', "one of both"),
    ],
)
def test_what_is_missing_in_the_file_is_said(tmp_path: Path, change: str, reason: str) -> None:
    (tmp_path / "a.png").write_bytes(b"")
    (tmp_path / "measurement.toml").write_text(
        'kind = "observer"\nname = "x"\n[collector]\naperture_width_m = 5.0\nlength_m = 3.0\nfocal_length_m = 1.49\n'
        f'absorber_diameter_mm = 70.0\n[images]\nphotos = "*.png"\n{change}'
    )
    with pytest.raises(InputError, match=reason):
        load(tmp_path)
