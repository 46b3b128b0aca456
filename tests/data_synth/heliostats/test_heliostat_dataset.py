"""Synthetic measurements of heliostats: files that load, errors of the size that was asked for, faults as named."""

import csv

import numpy as np
import pytest

from calibration.heliostat.keys import load_heliostat
from calibration.heliostat.observations import rtk_statistics
from data_synth.heliostats.dataset import (
    HeliostatOptions,
    heliostat_content,
    iterate_photos,
    read_heliostat_truth,
    write_heliostat_dataset,
)
from data_synth.heliostats.drone import Flight, fly
from data_synth.heliostats.faults import FAULTS
from data_synth.heliostats.presets import PRESETS, HeliostatChoice, heliostat_scene
from heliogauge.errors import InputError
from heliogauge.geometry.sun import angles_from_direction, sun_directions
from heliogauge.images.photos import read_image


def rows_of(folder):
    with (folder / "observations.csv").open() as file:
        return list(csv.DictReader(file))


def made(folder, preset, faults=(), **choice):
    scene = heliostat_scene(preset, HeliostatChoice(**choice)).with_faults(tuple(faults))
    write_heliostat_dataset(folder, scene, HeliostatOptions(choice.get("seed", 0)))
    return rows_of(folder), read_heliostat_truth(folder)


@pytest.mark.parametrize("preset", [preset for preset in PRESETS if not preset.startswith("images")])
def test_every_preset_is_a_measurement_that_loads(tmp_path, preset):
    n_heliostats = {"faulty": 24}.get(preset, 1)
    rows, truth = made(tmp_path / "set", preset, heliostats=n_heliostats, observations=4)
    loaded = load_heliostat(tmp_path / "set")
    assert loaded.model.kinematics.preset == truth.parameters["kinematics"]
    assert len(rows) == len(truth.spot_m) == len(truth.normal) > 0
    assert len(truth.parameters["heliostats"]) == n_heliostats or preset in ("stellenbosch", "drone")
    assert {row["heliostat"] for row in rows} <= {one["heliostat"] for one in truth.parameters["heliostats"]}


def test_the_same_seed_gives_the_same_files_and_another_one_does_not(tmp_path):
    for name, seed in (("a", 3), ("b", 3), ("c", 4)):
        made(tmp_path / name, "small", seed=seed, observations=6)
    first, second, other = ((tmp_path / name / "observations.csv").read_bytes() for name in "abc")
    assert first == second
    assert first != other


def test_spots_scatter_about_the_truth_as_they_say(tmp_path):
    rows, truth = made(tmp_path / "set", "small", seed=1)
    measured = np.array([[float(row["x_m"]), float(row["y_m"])] for row in rows])
    sigma = np.array([[float(row["sigma_x_mm"]), float(row["sigma_y_mm"])] for row in rows]) / 1e3
    error = (measured - truth.spot_m) / sigma
    # 480 numbers: the mean square is 1 within 0.065 (1 sigma).
    assert np.mean(error**2) == pytest.approx(1, abs=0.25)
    assert np.abs(truth.spot_m).max() < 3.5


def test_more_observations_with_outliers_wind_and_other_noise(tmp_path):
    scene = heliostat_scene("small", HeliostatChoice(observations=400, heliostats=1))
    scene = scene.with_disturbances(outliers=0.2, spot_m=(0.001, 0.001), wind_rad=None)
    write_heliostat_dataset(tmp_path / "set", scene)
    rows, truth = rows_of(tmp_path / "set"), read_heliostat_truth(tmp_path / "set")
    far = np.array(
        [
            np.hypot(float(row["x_m"]) - spot[0], float(row["y_m"]) - spot[1]) > 0.006
            for row, spot in zip(rows, truth.spot_m, strict=True)
        ]
    )
    assert truth.outlier.mean() == pytest.approx(0.2, abs=0.06)
    assert (far == truth.outlier).mean() > 0.99


def test_the_true_numbers_and_the_readings_send_the_sun_to_the_true_spot(tmp_path):
    """Closed loop through the files with equations of the simplest kind: an azimuth-elevation mirror by hand."""
    rows, truth = made(tmp_path / "set", "small", observations=8, heliostats=1)
    values = truth.values("H01")
    site = heliostat_scene("small").plant.site
    target = {one["name"]: np.array(one["center_m"]) for one in truth.parameters["targets"]}
    times = np.array([row["time_utc"][:-1] for row in rows], dtype="datetime64[ms]")
    for row, normal, spot, sun in zip(rows, truth.normal, truth.spot_m, sun_directions(times, site), strict=True):
        beam = 2 * (normal @ sun) * normal - sun
        start = np.array([values["position_e"], values["position_n"], values["position_u"]])
        hit = start + beam * (target[row["target"]][1] - start[1]) / beam[1]
        # The target faces north: seen from the field, west is to the right. 1 ms of rounded time is 10 um.
        np.testing.assert_allclose([-hit[0], hit[2] - target[row["target"]][2]], spot, atol=1e-4)
        # 0.2 mrad of wind twice over, and 12 mrad of errors between what the drives read and where the mirror looks.
        azimuth, elevation = angles_from_direction(normal)
        assert abs(azimuth % (2 * np.pi) - float(row["axis_1_rad"]) % (2 * np.pi)) < 0.03
        assert abs(elevation - float(row["axis_2_rad"])) < 0.03


@pytest.fixture(scope="module")
def faulty(tmp_path_factory):
    folder = tmp_path_factory.mktemp("faulty") / "set"
    return made(folder, "faulty", observations=25)


def test_every_fault_has_its_heliostat_and_as_many_are_healthy(faulty):
    _, truth = faulty
    found = [[fault["fault"] for fault in one["faults"]] for one in truth.parameters["heliostats"]]
    assert found[: len(FAULTS)] == [[fault] for fault in FAULTS]
    assert found[len(FAULTS) :] == [[]] * len(FAULTS)


def test_faults_do_what_their_names_say(faulty):
    rows, truth = faulty
    by_fault = {
        one["faults"][0]["fault"]: (one, [row for row in rows if row["heliostat"] == one["heliostat"]])
        for one in truth.parameters["heliostats"]
        if one["faults"]
    }
    assert len(by_fault["few"][1]) == 2
    assert len({row["axis_2_counts"] for row in by_fault["stuck-reading"][1]}) == 1
    doubled = by_fault["duplicates"][1]
    assert len({tuple(row.items()) for row in doubled}) < len(doubled)
    moved = by_fault["moved"][0]
    # 2 m off beside the 20 mm with which every heliostat stands elsewhere than its drawing says.
    assert np.hypot(*(moved["values"][k] - moved["stated"][k] for k in ("position_e", "position_n"))) > 1.8
    actuator = by_fault["wrong-actuator"][0]
    assert actuator["stated"]["initial_stroke_1"] - actuator["values"]["initial_stroke_1"] > 5e-3
    south = by_fault["south-azimuth"][1]
    healthy = [row for row in rows if row["heliostat"] == "H20"]
    assert max(abs(float(row["sun_azimuth_deg"])) for row in south) < 150
    assert min(float(row["sun_azimuth_deg"]) for row in healthy) > 60


def test_a_jump_moves_the_readings_from_its_date_on(tmp_path):
    rows, truth = made(tmp_path / "set", "small", faults=["change-point:H02"], observations=40)
    record = truth.parameters["heliostats"][1]
    offsets = []
    for row, normal in zip(rows, truth.normal, strict=True):
        if row["heliostat"] == "H02":
            turned = float(angles_from_direction(normal)[0]) - float(row["axis_1_rad"])
            offsets.append((row["time_utc"] >= record["jump_date"], (turned + np.pi) % (2 * np.pi) - np.pi))
    before = np.mean([value for later, value in offsets if not later])
    after = np.mean([value for later, value in offsets if later])
    assert record["jumps"] == {"azimuth_offset": 4e-3, "elevation_offset": -2e-3}
    assert after - before == pytest.approx(4e-3, abs=2e-3)


def test_what_cannot_be_is_refused_in_words(tmp_path):
    with pytest.raises(InputError, match="images"):
        heliostat_scene("smal")
    with pytest.raises(InputError, match="drift"):
        heliostat_scene("small").with_faults(("drit",))
    with pytest.raises(InputError, match="H01"):
        heliostat_scene("small").with_faults(("drift:X1",))
    with pytest.raises(InputError, match="linear"):
        heliostat_scene("small").with_faults(("wrong-actuator",))
    with pytest.raises(InputError, match="more heliostats"):
        heliostat_scene("drone").with_faults(("drift", "few"))


def test_the_drone_sees_the_target_where_it_says(tmp_path):
    rows, truth = made(tmp_path / "set", "drone", observations=30)
    drone = np.array([[float(row[f"drone_{axis}_m"]) for axis in "enu"] for row in rows])
    target = np.array(truth.parameters["targets"][0]["center_m"])
    values = truth.values("1")
    start = np.array([values["position_e"], values["position_n"], values["position_u"]])
    distance = np.linalg.norm(drone - start, axis=1)
    assert distance.min() > 31.9
    assert distance.max() < 70.1
    to_drone = (drone - start) / distance[:, None]
    to_target = (target - start) / np.linalg.norm(target - start)
    between = to_drone + to_target
    between /= np.linalg.norm(between, axis=1, keepdims=True)
    # The mirror's middle is half a metre from the reference point: of the order of half that over 29 m.
    assert np.arccos(np.einsum("ni,ni->n", between, truth.normal)).max() < 0.02


def test_the_log_of_the_receiver_at_rest_gives_the_sigmas_that_the_sightings_state(tmp_path):
    rows, _ = made(tmp_path / "set", "drone", observations=3)
    with (tmp_path / "set" / "rtk_static.csv").open() as file:
        log = list(csv.DictReader(file))
    places = np.array([[float(row[f"{axis}_mm"]) / 1e3 for axis in ("north", "east", "down")] for row in log])
    found = rtk_statistics(places, is_fixed=[row["fix_mode"] == "FIX" for row in log])
    stated = [float(rows[0][f"sigma_drone_{axis}_mm"]) / 1e3 for axis in "neu"]
    assert found.n_epochs == 1455
    np.testing.assert_allclose(found.sigma_m, stated, rtol=0.08)
    assert 1e3 * found.drms_m == pytest.approx(8.05, abs=0.4)


def test_a_longer_flight_begins_like_a_shorter_one():
    scene = heliostat_scene("drone")
    unit, target = scene.units[0], scene.plant.targets[0]
    flights = [
        fly(unit.true, target, Flight(points=n), (0.01, 0.01, 0.01), tuple(np.random.default_rng(5).spawn(2)))
        for n in (10, 10)
    ]
    np.testing.assert_array_equal(flights[0].measured_m, flights[1].measured_m)


@pytest.mark.slow
def test_photos_lie_beside_their_truth(tmp_path):
    rows, truth = made(tmp_path / "set", "images", observations=2, heliostats=1)
    assert load_heliostat(tmp_path / "set").model.images[0].target == "upper"
    photos = list(iterate_photos(truth))
    assert [photo["file"] for photo in photos] == [row["image"] for row in rows]
    assert all(row["x_m"] == "" for row in rows)
    for photo, spot in zip(photos, truth.spot_m, strict=True):
        picture = read_image(tmp_path / "set" / photo["file"])
        assert picture.shape == (768, 1024)
        assert 100 < picture.max() < 255
        assert photo["share_on_target"] > 0.99
        # The centroid of a slanting beam is not quite where its middle ray is.
        np.testing.assert_allclose(photo["centroid_m"], spot, atol=0.02)


def test_measurement_file_states_priors_and_photos():
    scene = heliostat_scene("images-lens")
    content = heliostat_content(scene, {"upper": np.zeros((4, 2))})
    assert content["images"][0]["empty"] == "photos_upper/empty_*.png"
    assert content["images"][0]["camera"] == "camera.json"
    assert content["kinematics"]["parameters"]["tilt_north"] == {"sigma": 3e-3}
