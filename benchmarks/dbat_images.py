"""DBAT's calibration photos: sigma0 of bundles over our own centres beside those over the published marks.

The dots are found and centred by our detector and named by the nearest published mark (corner origin, so 0.5 px are
taken off). Each column is one estimator, each row one model; all weights are equal, every mark takes part. The first
row is the published adjustment (four controls held, measured-to-ideal lens with aspect, residuals in the corrected
image, no correction of eccentricity). The controls' own coordinates are off by more than the marks: with them held,
their 84 marks carry residuals of 0.38 px, all others 0.13 px; the last rows let the network free.
Needs ../shared/data/photogrammetry/dbat_camcal.
"""

import csv
from dataclasses import replace

import numpy as np
from _measure import ROOT, row, title

from heliogauge.camera.distortion import BrownDistortion, DistortionDirection
from heliogauge.camera.model import Camera
from heliogauge.errors import EstimationError
from heliogauge.images.photos import read_image
from photogrammetry import ImagePoints
from photogrammetry.bundle import BundleProblem, CameraModel, ResidualSpace, adjust, alignment, eccentricity
from photogrammetry.centers import measure_center
from photogrammetry.detection import SearchLimits, find_candidates
from photogrammetry.start_values import build_network

FOLDER = ROOT.parent / "shared" / "data" / "photogrammetry" / "dbat_camcal"
SIGMA_PX = 0.1
SIZE_PX, FOCAL_PX = (2272, 1704), 7.5 / (5.43764 / 1704)
CONTROL = {"1001": [0.0, 1.0, 0.0], "1002": [1.0, 1.0, 0.0], "1003": [0.0, 0.0, 0.0], "1004": [1.0, 0.0, 0.0]}
FREE = ("focal_px", "aspect", "center_x_px", "center_y_px", "k1", "k2", "k3", "p1", "p2")
ONE_FOCAL = tuple(name for name in FREE if name != "aspect")


def published_marks():
    """Photo number, target name, pixels of each mark; (0, 0) is the centre of the first pixel."""
    with (FOLDER / "measurements" / "markpts.txt").open() as file:
        rows = [line for line in csv.reader(file, skipinitialspace=True) if line and not line[0].startswith("#")]
    pixels = np.array([[float(line[2]), float(line[3])] for line in rows]) - 0.5
    return np.array([int(line[0]) for line in rows]), [line[1].strip() for line in rows], pixels


def nearest_candidates(image, marks_px):
    """Return the spot nearest to each mark, None where there is none within a fifth of its diameter."""
    spots = find_candidates(image, SearchLimits(8.0, 100.0, least_contrast_dn=15.0))
    places = np.array([spot.ellipse.center_px for spot in spots])
    found = []
    for mark in marks_px:
        far = np.linalg.norm(places - mark, axis=1)
        near = int(np.argmin(far))
        found.append(spots[near] if far[near] < 0.4 * spots[near].ellipse.radius_px else None)
    return found


def measured(images, spots):
    """Centres of all spots, shape (m, 2), and their ellipses, (m, 2, 2); NaN where there is none."""
    centers, shapes = np.full((len(spots), 2), np.nan), np.full((len(spots), 2, 2), np.nan)
    for k, (image, spot) in enumerate(zip(images, spots, strict=True)):
        try:
            center = measure_center(image, spot.ellipse) if spot is not None else None
        except EstimationError:
            center = None
        if center is not None:
            centers[k], shapes[k] = center.center_px, center.ellipse.shape_px2
    return centers, shapes


def adjusted(table, model, *, held=True, shapes=None):
    """One adjustment of all image points; with shapes their eccentricity is corrected. Returns sigma0 [px]."""
    direction, space, free = model
    camera = CameraModel("c4040z", free, residual=space)
    guess = Camera(*SIZE_PX, FOCAL_PX, FOCAL_PX, 1135.5, 851.5, distortion=BrownDistortion(direction=direction))
    network = build_network(table, [guess], models=[camera])
    problem = BundleProblem(table, (camera,), fixed=tuple(CONTROL) if held else ())
    result = adjust(problem, alignment.aligned_to_control(network.state, table.targets, CONTROL))
    if shapes is not None:
        discs = eccentricity.estimate_discs(table, shapes, result.state, problem.camera_index)
        shift = eccentricity.eccentricities_px(table, discs, result.state, problem.camera_index)
        corrected = replace(problem, observations=replace(table, pixels_px=table.pixels_px - shift))
        result = adjust(corrected, result.state)
    return result.sigma0 * SIGMA_PX


def main():
    photo, names, marks = published_marks()
    images, spots = [], []
    for number, file in enumerate(sorted((FOLDER / "images").glob("*.JPG")), start=1):
        own = np.flatnonzero(photo == number)
        image = read_image(file)
        spots += nearest_candidates(image, marks[own])
        images += [image] * own.size
    found = {"marks": (marks, None)}
    found["blurred disc"] = measured(images, spots)
    photos = [str(number) for number in photo]

    def table(pixels):
        return ImagePoints.from_names(
            photos, names, pixels, np.broadcast_to(np.eye(2) * SIGMA_PX**2, (len(names), 2, 2))
        )

    title("sigma0 [px] of all 2074 image points", tuple(found))
    row("asked, best seen elsewhere", "", "0.150, 0.148")
    backward, forward = DistortionDirection.MEASURED_TO_IDEAL, DistortionDirection.IDEAL_TO_MEASURED
    measured_space, corrected = ResidualSpace.MEASURED, ResidualSpace.CORRECTED
    models = {
        "published: backward, corrected image (0.161480)": ((backward, corrected, FREE), True),
        "published: forward, one focal length (0.162168)": ((forward, measured_space, ONE_FOCAL), True),
        "backward, residuals in the measured image": ((backward, measured_space, FREE), True),
        "forward with aspect, residuals in the measured image": ((forward, measured_space, FREE), True),
        "backward, corrected image, free network": ((backward, corrected, FREE), False),
        "forward with aspect, free network": ((forward, measured_space, FREE), False),
    }
    for name, (model, held) in models.items():
        row(name, *(f"{adjusted(table(pixels), model, held=held):.4f}" for pixels, _ in found.values()))
    own = [
        f"{adjusted(table(pixels), models[name][0], held=False, shapes=shapes):.4f}"
        for pixels, shapes in list(found.values())[1:]
    ]
    row("the last with eccentricity corrected", "", *own)
    off = found["blurred disc"][0] - marks
    row(
        "minus mark: mean x, mean y, rms about it",
        "",
        f"{off[:, 0].mean():+.3f}",
        f"{off[:, 1].mean():+.3f}",
        f"{np.sqrt(((off - off.mean(axis=0)) ** 2).mean()):.3f}",
    )


if __name__ == "__main__":
    main()
