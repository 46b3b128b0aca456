"""Beams of real heliostats: centres beside the plant's labels, sizes beside the plant's own, flux traced from surfaces.

Photos and labels of the PAINT database: 139 crops of heliostat AA39 (an early release: its labels stand 1.626 m west of
the later one's, as the README of the data says; that shift alone is taken off), five crops of AA23, and three fluxes of
AA39 with the sun. Needs ../shared/data/csp. Nothing here was chosen by what it gives: settings are the commands' own.
"""

import json
import sys
from collections import Counter

import cv2
import numpy as np
from _measure import ROOT, StageClock, row, title

import heliogauge as hg
from calibration.beam import Options, run
from calibration.beam.light import BeamFlag
from calibration.beam.pipeline import CompareOptions, compare
from heliogauge.geometry.geodesy import enu_from_geodetic
from heliogauge.geometry.target_planes import PlaneTarget

TOWER, RECORD = "tower-measurements.json", "calibration-properties.json"
CORNERS = ("upper_left", "upper_right", "lower_right", "lower_left")
CSP = ROOT.parent / "shared" / "data" / "csp"
#: Longitude by which the early release's labels stand aside [deg]; metres at the plant.
SHIFT_M = np.radians(2.31243e-5) * 6.3906e6 * np.cos(np.radians(50.9134))
SURFACES = ("AA39", "AA28", "AA31", "AC43")


def measured(folder):
    result = run(hg.load(folder), Options(jobs=1))
    return result, ~result.beams.rejected


def line(name, offsets_m, sigma_m):
    """Median distance, the farthest, and error over sigma of both directions."""
    away = np.hypot(*offsets_m.T)
    ratio = float(np.sqrt(np.mean((offsets_m / sigma_m) ** 2)))
    row(
        f"{name}: median, farthest, error/sigma",
        f"{np.median(away):.3f} m",
        f"{away.max():.3f} m",
        f"{ratio:.2f}",
    )


def centres():
    title("Centres against the plant's labels (asked: 0.02 m, 0.25 m, 0.8 to 1.25)", ("median", "farthest", "ratio"))
    everything = []
    for name, folder, shift in (
        ("AA39, published shift", CSP / "juelich_surface" / "AA39" / "beams", SHIFT_M),
        ("AA23", CSP / "juelich_beam_images", 0.0),
    ):
        result, used = measured(folder)
        offsets, sigma = result.offsets_m + [shift, 0.0], result.beams.sigma_m
        line(f"{name}, {used.sum()} photos", offsets[used], sigma[used])
        everything.append((offsets[used], sigma[used]))
        if shift:
            # The targets' places of two releases differ by centimetres, each by its own.
            targets = np.array(result.beams.targets)
            own = offsets.copy()
            for target in set(targets):
                own[targets == target] -= np.median(own[used & (targets == target)], axis=0)
            line(f"{name}, and the median of each target", own[used], sigma[used])
        reasons = Counter(one.split(";")[0] for one, bad in zip(result.beams.reasons, ~used, strict=True) if bad)
        held, uneven = (
            float(np.mean((result.beams.flags[used] & np.uint32(flag)) != 0))
            for flag in (BeamFlag.BACKGROUND_MAY_HOLD_LIGHT, BeamFlag.UNEVEN_TARGET)
        )
        row(
            f"{name}: refused, each with a reason; aureole said; panels said",
            str((~used).sum()),
            f"{held:.0%}",
            f"{uneven:.0%}",
        )
        for reason, count in reasons.items():
            print(f"    {count} x {reason}")
    line("all", *(np.concatenate(one) for one in zip(*everything, strict=True)))


#: Left, top and right, bottom of the marks by the plant's published code (github.com/ARTIST-Association/PAINT,
#: paint/util/paint_mappings.py): east and up of the field's origin, rounded to centimetres.
_MARKS = {
    "solar_tower_juelich_upper": ((4.32, 46.70), (-4.30, 39.48)),
    "solar_tower_juelich_lower": ((4.33, 39.49), (-4.29, 32.27)),
    "multi_focus_tower": ((-14.88, 55.17), (-20.29, 48.78)),
}


def convention():
    """Read labels back into shares of the crop, as the plant's published code has made them.

    A label is the mean index over the number of pixels, on the rounded marks, moved along their mean sides
    (focal_spot_extractor.py); labels of AA39 were then turned into latitude and longitude as Gauss-Krueger coordinates
    (generate_calibration_stacs.py), whose north is 0.301 degrees off: all labels of a target have one north coordinate
    after that turn, and 8 to 15 mm of it before.
    """
    title("Labels as the plant's code makes them: centres in shares of the crop", ("median", "farthest", "ratio"))
    for name, folder, early in (
        ("AA39", CSP / "juelich_surface" / "AA39" / "beams", True),
        ("AA23", CSP / "juelich_beam_images", False),
    ):
        result, used = measured(folder)
        tower = json.loads(
            next(one for one in (folder, *folder.parents) if list(one.glob(TOWER))).joinpath(TOWER).read_text()
        )
        latitude, longitude, height = tower["power_plant_properties"]["coordinates"]
        turn = np.radians(longitude - 6) * np.sin(np.radians(latitude)) if early else 0.0
        offsets, norths, plants = [], {}, []
        for file, target, x, y in zip(
            result.beams.files, result.beams.targets, result.beams.x_m, result.beams.y_m, strict=True
        ):
            number = file.name.split("_")[0].split("-")[0]
            record = json.loads((folder / f"{number}-{RECORD}").read_text())
            spot = np.array(record["focal_spot"]["UTIS"]) + ([4.894e-7, 2.31243e-5, 0.0] if early else [0.0, 0.0, 0.0])
            east, north, _ = enu_from_geodetic(*spot, (latitude, longitude, height))
            true_north = np.sin(turn) * east + np.cos(turn) * north
            norths.setdefault(target, []).append((north, true_north))
            east = np.cos(turn) * east - np.sin(turn) * north
            (left, top), (right, bottom) = _MARKS[target]
            label = [(east - left) / (right - left), (top - (spot[2] - height)) / (top - bottom)]
            corners = tower[target]["coordinates"]
            places = [enu_from_geodetic(*corners[one], (latitude, longitude, height)) for one in CORNERS]
            plane = PlaneTarget.from_corners(target, np.array(places))
            seen = plane.coordinates(np.array(places)).astype(np.float32)
            crop = cv2.getPerspectiveTransform(seen, np.array([[0, 0], [1, 0], [1, 1], [0, 1]], dtype=np.float32))
            ours = crop @ [x, y, 1.0]
            offsets.append((ours[:2] / ours[2] - label) * [left - right, bottom - top])
            if (folder / f"{number}-flux.png").is_file():
                flux = cv2.imread(str(folder / f"{number}-flux.png"), cv2.IMREAD_GRAYSCALE).astype(float)
                y, x = np.indices(flux.shape)
                share = np.array([(flux * x).sum(), (flux * y).sum()]) / flux.sum() / flux.shape[0]
                plants.append((share - label) * [left - right, bottom - top])
        offsets, sigma = np.array(offsets), result.beams.sigma_m
        line(f"{name}, {used.sum()} photos", offsets[used], sigma[used])
        if plants:
            away = np.hypot(*np.array(plants).T)
            row(
                f"{name}: the plant's own pictures without background: median, farthest",
                f"{np.median(away):.3f} m",
                f"{away.max():.3f} m",
                "",
            )
        before, after = (max(float(np.ptp(np.array(one)[:, k])) for one in norths.values()) for k in (0, 1))
        row(
            f"{name}: range of north coordinates, as published; turned",
            f"{1e3 * before:.1f} mm",
            f"{1e3 * after:.2f} mm",
            "",
        )


def sizes():
    title("D90 of five crops of AA23 with background, against the plant's flux", ("ours", "plant's", "off/sigma"))
    folder = CSP / "juelich_beam_images"
    measurement = hg.load(folder)
    crops = run(measurement, Options(jobs=1))
    paint = measurement.model.paint.model_copy(update={"pictures": "flux"})
    model = measurement.model.model_copy(update={"paint": paint})
    fluxes = run(type(measurement)(measurement.folder, model, measurement.input_files), Options(jobs=1))
    for file, ours, theirs in zip(crops.beams.files, crops.beams.sizes, fluxes.beams.sizes, strict=True):
        d90, sigma = ours.diameters_m[1], ours.sigma_diameters_m[1]
        ratio = (d90 - theirs.diameters_m[1]) / sigma
        row(file.name, f"{d90:.2f} +- {sigma:.2f} m", f"{theirs.diameters_m[1]:.2f} m", f"{ratio:+.1f}")


def traced() -> None:
    title("Flux traced from measured surfaces against AA39's photos", ("correlation", "D90 off", "centre off"))
    print("  asked of its own surface: 0.95, 5 %, 0.1 m; the others' must fit less well")
    place = CSP / "juelich_surface"
    position = None
    for name in SURFACES:
        options = CompareOptions(place / "surfaces.h5", name, position, fit=False)
        result = compare.run(hg.load(place / "AA39" / "flux"), options)
        position = position or tuple(result.stand.position_m.tolist())
        correlations = [one.correlation for one in result.rows]
        d90 = [abs(one.d90_expected_m / one.d90_m - 1) for one in result.rows]
        row(
            f"surface of {name}: least, most, most of {len(result.rows)} photos",
            f"{min(correlations):.3f}",
            f"{max(d90):.1%}",
            f"{max(one.center_off_m for one in result.rows):.3f} m",
        )
    clock = StageClock()
    fitted = compare.run(hg.load(place / "AA39" / "flux"), CompareOptions(place / "surfaces.h5", "AA39"), clock)
    row(
        "AA39, canting, focus and scatter fitted: least correlation",
        f"{min(one.correlation_fitted for one in fitted.rows):.3f}",
        "rises",
        f"{sum(clock.cpu_s.values()):.1f} s CPU",
    )


if __name__ == "__main__":
    studies = {one.__name__: one for one in (centres, convention, sizes, traced)}
    for each in sys.argv[1:] or studies:
        studies[each]()
