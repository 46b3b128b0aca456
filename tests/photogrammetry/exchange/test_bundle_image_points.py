"""``image_points.csv``: what is read, and every fault by name."""

import numpy as np
import pytest

from heliogauge.errors import InputError
from photogrammetry.exchange.image_point_files import PixelOrigin, read_image_points_csv, write_image_points_csv
from photogrammetry.image_points import ImagePoints

HEADER = "image,target,x_px,y_px,sigma_x_px,sigma_y_px\n"


def written(tmp_path, text):
    path = tmp_path / "image_points.csv"
    path.write_text(text)
    return path


def test_round_trip(tmp_path):
    rng = np.random.default_rng(0)
    sigma = rng.uniform(0.01, 0.1, (4, 2))
    covariance = np.zeros((4, 2, 2))
    covariance[:, 0, 0], covariance[:, 1, 1] = sigma.T**2
    points = ImagePoints(("a", "b"), ("1", "2"), [0, 0, 1, 1], [0, 1, 0, 1], rng.normal(size=(4, 2)), covariance)
    path = tmp_path / "image_points.csv"
    write_image_points_csv(path, points)
    found = read_image_points_csv(path)
    assert not found.sigma_assumed
    assert found.points.photos == points.photos
    np.testing.assert_array_equal(found.points.pixels_px, points.pixels_px)
    np.testing.assert_allclose(found.points.covariance_px2, points.covariance_px2, rtol=1e-14)


def test_corner_origin_and_missing_sigma(tmp_path):
    path = written(tmp_path, "image,target,x_px,y_px\na,1,10.5,20.5\nb,1,11,21\n")
    found = read_image_points_csv(path, origin=PixelOrigin.CORNER, default_sigma_px=0.2)
    np.testing.assert_array_equal(found.points.pixels_px[0], [10.0, 20.0])
    np.testing.assert_allclose(found.points.covariance_px2[1], np.eye(2) * 0.04)
    assert found.sigma_assumed
    # What is done by default is said as done, with the key that undoes it.
    (doubt,) = found.doubts
    assert 'the residuals scale the covariance unless measurement.toml has [adjustment] sigmas = "stated"' in doubt.text
    assert doubt.numbers == {"missing_count": 2, "image_points_count": 2}
    some = read_image_points_csv(written(tmp_path, HEADER + "a,1,1,2,0.3,\na,2,3,4,,\n"))
    np.testing.assert_allclose(some.points.covariance_px2, np.broadcast_to(np.eye(2) * 0.09, (2, 2, 2)))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("image,x_px,y_px\n", "target"),
        (HEADER, "no image points"),
        (HEADER + "a,1,1,2,0.1,0.1\na,1,5,6,0.1,0.1\n", "lines 2 and 3: target 1 is measured twice in image a"),
        (HEADER + "a,1,1,2,0,0.1\n", "line 2: sigma"),
        (HEADER + "a,1,one,2,0.1,0.1\n", "x_px must hold numbers"),
        (HEADER + "a,1,,2,0.1,0.1\n", "line 2: x_px and y_px"),
        (HEADER + "a,,1,2,0.1,0.1\n", "line 2: image and target"),
        (HEADER + "a,1,100,1500,0.1,0.1\na,2,90,20,0.1,0.1\n", "swapped"),
    ],
)
def test_faults(tmp_path, text, message):
    with pytest.raises(InputError, match=message):
        read_image_points_csv(written(tmp_path, text), sizes_px=(2000, 1000))


def test_outside_is_not_always_swapped(tmp_path):
    path = written(tmp_path, HEADER + "a,1,2500,1500,0.1,0.1\n")
    with pytest.raises(InputError, match="outside the image of 2000 x 1000") as error:
        read_image_points_csv(path, sizes_px={"a": (2000, 1000)})
    assert "swapped" not in str(error.value)
    with pytest.raises(InputError, match="size of the images a"):
        read_image_points_csv(path, sizes_px={"b": (2000, 1000)})
