"""Beams on targets: centroids of the plant's own pictures beside its labels, and what a picture costs.

The labels are those of the PAINT database (UTIS): the centroid of the picture without background, index over 256 on the
target's corners. Composites put the five real beams, turned, shrunk and moved, on the five real targets, with a shadow
whose border runs anywhere. Needs ../shared/data/csp/juelich_beam_images.
"""

import json
import tempfile
import time
from pathlib import Path

import cv2
import numpy as np
from _measure import ROOT, row, title

from calibration.beam.images import MarkerTemplates, TargetFrame
from calibration.beam.light import background_around, measure_beam
from calibration.beam.pipeline import measure_beams
from calibration.beam.target import Rectifier, view_from_points, whole_image
from heliogauge.images.photos import read_channel

FOLDER = ROOT.parent / "shared" / "data" / "csp" / "juelich_beam_images"
NAMES = ("106293", "137608", "152144", "194228", "203718")
SQUARE_M = np.array([[-4, 3.5], [4, 3.5], [4, -3.5], [-4, -3.5]])


def plane(name):
    """Corners and label on the target's plane [m]."""
    tower = json.loads((FOLDER / "tower-measurements.json").read_text())
    record = json.loads((FOLDER / f"{name}-calibration-properties.json").read_text())
    corners = tower[record["target_name"]]["coordinates"]
    geodetic = [corners[key] for key in ("upper_left", "upper_right", "lower_right", "lower_left")]
    latitude, longitude, altitude = np.array([*geodetic, record["focal_spot"]["UTIS"]]).T
    across = -np.radians(longitude - longitude[0]) * 6.3906e6 * np.cos(np.radians(latitude))
    points = np.stack([across, altitude - altitude[:4].mean()], axis=1)
    return points[:4], points[4]


def picture(name, kind):
    return cv2.imread(str(FOLDER / f"{name}-{kind}.png"), cv2.IMREAD_GRAYSCALE)


def labels():
    title("Real beams beside their labels", ("off by", "asked", "sigma"))
    for name in NAMES:
        corners, label = plane(name)
        pixel = np.ptp(corners, axis=0) / 256
        flux = measure_beam(whole_image(picture(name, "flux"), corners, by_index=True)).spot.position_m - label
        beam = measure_beam(whole_image(picture(name, "cropped"), corners, by_index=True))
        off = beam.spot.position_m - label
        row(f"{name}, background removed by the plant", f"{np.abs(flux / pixel).max():.2f} px", "1 px")
        sigma = f"{np.hypot(*beam.spot.sigma_m):.3f} m"
        row(f"{name}, with background {beam.reason}", f"{np.hypot(*off):.3f} m", "0.1 m", sigma)


def raw_frame():
    title("Raw frame of 3072 x 1728 px, rectified by the plant's templates of the marks", ("measured", "asked"))
    corners, _ = plane("203718")
    names = ("left_top", "right_top", "right_bottom", "left_bottom")
    templates = MarkerTemplates(tuple(FOLDER / "markers" / f"mft_{name}.png" for name in names))
    beams = measure_beams([FOLDER / "203718-raw.png"], ["target"], {"target": TargetFrame(corners, templates)}, jobs=1)
    mine = np.array([beams.x_m[0], beams.y_m[0]])
    theirs = measure_beam(whole_image(picture("203718", "cropped"), corners, by_index=True)).spot.position_m
    row("centroid, ours minus the one in the plant's crop", f"{np.hypot(*(mine - theirs)):.3f} m", "1 px = 0.02 m")


def composites():
    title("Real beams on real targets with a shadow of 10-30 DN", ("within 0.1 m", "accepted", "90 % within"))
    fluxes = [picture(name, "flux").astype(float) for name in NAMES]
    rng = np.random.default_rng(1)
    targets = []
    for name, flux in zip(NAMES, fluxes, strict=True):
        crop = picture(name, "cropped").astype(float)
        lit = cv2.dilate((flux > 1).astype(np.uint8), np.ones((9, 9))) > 0
        own = background_around(crop, ~lit).values_dn
        targets.append(np.where(lit, own + rng.normal(0, 1, crop.shape), crop))
    for low, high in ((50, 90), (25, 50)):
        errors, kept = [], []
        for k in range(60):
            values, true_px = composite(rng, fluxes[rng.integers(5)], targets[k % 5], (low, high), shadow=k % 5 != 1)
            if values is None:
                continue
            image = whole_image(values, SQUARE_M)
            beam = measure_beam(image)
            kept.append(not beam.rejected)
            errors.append(np.hypot(*(beam.spot.position_m - image.points_m(true_px))))
        good = np.array(errors)[kept]
        texts = (f"{np.mean(good < 0.1):.0%}", f"{np.mean(kept):.0%}", f"{np.quantile(good, 0.9):.3f} m")
        row(f"peak of the beam {low}-{high} DN, {len(errors)} pictures", *texts)


def composite(rng, flux, target, heights, *, shadow):
    """Return a picture and the true centroid [px]; None where more than 0.5 % of the beam misses the target."""
    y, x = np.mgrid[:256, :256]
    center = (float((flux * x).sum() / flux.sum()), float((flux * y).sum() / flux.sum()))
    warp = cv2.getRotationMatrix2D(center, rng.uniform(-40, 40), rng.uniform(0.5, 1.0))
    warp[:, 2] += 127.5 - np.array(center) + rng.uniform(-35, 35, 2)
    light = cv2.warpAffine(flux, warp, (256, 256))
    whole = cv2.warpAffine(flux, warp + [[0, 0, 128], [0, 0, 128]], (512, 512))
    angle, offset = rng.uniform(0, np.pi), rng.uniform(-60, 60)
    depth = rng.uniform(10, 30) * rng.choice([-1, 1]) * shadow
    distance = (x - 128) * np.cos(angle) + (y - 128) * np.sin(angle) - offset
    values = target + depth * np.clip(0.5 + distance / 4, 0, 1) + rng.uniform(*heights) / 255 * light
    if light.sum() < 0.995 * whole.sum():
        return None, None
    noisy = np.clip(np.rint(values + rng.normal(0, 0.7, light.shape)), 0, 255).astype(np.uint8)
    return noisy, np.array([(light * x).sum(), (light * y).sum()]) / light.sum()


def cost():
    cv2.setNumThreads(1)
    title("Processor time of a picture", ("measured", "asked"))
    y, x = np.mgrid[:1024, :1024]
    light = 90 * np.exp(-(((x - 500) / 140) ** 2 + ((y - 540) / 90) ** 2) / 2)
    values = 100 + 0.01 * x + light + np.random.default_rng(1).normal(0, 2, x.shape)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "beam.png"
        cv2.imwrite(str(file), np.clip(np.rint(values), 0, 255).astype(np.uint8))
        small = median_s(lambda: read_channel(file, "green"))
        image = read_channel(file, "green")
    corners = np.array([[0, 0], [1023, 0], [1023, 1023], [0, 1023]])
    rectifier = Rectifier(view_from_points(corners, SQUARE_M), [-4, 4, -3.5, 3.5])
    rectifier.rectify(image)
    ours = median_s(lambda: measure_beam(rectifier.rectify(image)))
    row("1 MP in grey: rectify and measure over decode (PNG)", f"{ours / small:.1f}", "2")
    row("  rectify and measure", f"{1e3 * ours:.0f} ms", "")
    raw = median_s(lambda: read_channel(FOLDER / "203718-raw.png", "green"), 5)
    row("5 MP in colour, as the plant takes them: the same", f"{ours / raw:.1f}", "3")


def median_s(work, n=15):
    times = []
    for _ in range(n):
        start = time.process_time()
        work()
        times.append(time.process_time() - start)
    return float(np.median(times))


if __name__ == "__main__":
    labels()
    raw_frame()
    composites()
    cost()
