"""Photos and cameras that cannot give a result, or not a good one: where they stand, how far apart, how exposed."""

import re
from collections.abc import Sequence

import numpy as np

from heliogauge.adjust.robust_scale import robust_scale
from heliogauge.doubts import Doubt, Severity
from heliogauge.errors import InputError
from heliogauge.validate import FloatArray, IntArray
from observer.trough.collector import Collector

#: Bright spots of a sky are a few per cent of the mirror; more is an exposure that was too long.
_CLIPPED_SHARE = 0.1
#: What a pass with photos near enough to each other measures of what can show the tube, and how near that is [m].
_SPARSE_SHARE, _GOOD_STEP_M = 0.6, 0.2
#: From further away no camera flies across; a collector that turns before it measures 0.8 of its mirror in steps of
#: 0.125 deg, 0.2 in steps of 0.38 deg.
FAR_M, _GOOD_TURN_DEG = 42.0, 0.125
#: Edges of targets foretell the scatter of centres to a factor of 1.3 (`photogrammetry.centers.edge_noise`); where it
#: is so many times larger something moved. Slopes of troughs are wanted to a tenth of a milliradian [rad].
_SCATTER_FACTOR, _WANTED_RAD = 3.0, 1e-4
#: Photos are said to be missing where their numbers leave out so many of all: a drone that writes every picture leaves
#: out none, a few are sorted out by hand.
_MISSING_SHARE = 0.2
#: The other encoding makes targets 4 to 10 % larger or smaller (`observer.photo_edges.tone`): half of the least. In
#: photos of one flight sizes differ by a few tenths; beyond so many of their scatters it is no chance.
_OTHER_SIZE, _SIZE_TIMES_SCATTER, _FEWEST_SIZES = 0.02, 6.0, 4
#: No camera that sees a collector is further away than this many times its largest dimension.
_FARTHEST_TIMES = 100.0


def refuse_impossible_cameras(eyes_m: FloatArray, listed_m: FloatArray, collector: Collector) -> None:
    """Refuse cameras that are where none can see the mirror: the list of targets is mirrored, or in other units.

    eyes_m (n, 3): The cameras in the trough's frame [m].
    listed_m (m, 3): Targets with listed coordinates [m].
    InputError: Most cameras are behind the mirror, or extremely far away.
    """
    height = float(np.median(eyes_m[:, 2]))
    if height < collector.rim_height_m:
        raise InputError(
            f"targets: with the listed coordinates the cameras are behind the mirror (median z = {height:.2f} m): the "
            f"list is mirrored. {_why_mirrored(listed_m, collector)}"
        )
    largest = max(collector.aperture_width_m, collector.length_m, collector.focal_length_m)
    distance = float(np.median(np.linalg.norm(eyes_m, axis=1)))
    if distance > _FARTHEST_TIMES * largest:
        raise InputError(
            f"targets: with the listed coordinates the cameras are {distance:.0f} m away from a collector of "
            f"{largest:g} m; are the coordinates in metres?"
        )


def _why_mirrored(listed_m: FloatArray, collector: Collector) -> str:
    """Say whether columns or a sign make a list mirrored, by how it spreads beside the collector."""
    x, y = np.ptp(listed_m[:, :2], axis=0) if len(listed_m) else np.zeros(2)
    aperture, length = collector.aperture_width_m, collector.length_m
    right = "x must go across the aperture, y along the trough and z to the absorber, right-handed"
    if min(x, y) > 0:
        as_listed = abs(np.log(x / aperture)) + abs(np.log(y / length))
        exchanged = abs(np.log(y / aperture)) + abs(np.log(x / length))
        if exchanged < as_listed:
            return (
                f"Its columns x_m and y_m seem exchanged: it spreads over {x:.2f} m in x and {y:.2f} m in y, the "
                f"collector over {aperture:g} m across and {length:g} m along. {right}: exchange the two columns"
            )
    return (
        f"{right}: change the sign of x_m or of y_m for all targets. Choose the one that is wrong: the other one turns "
        "the result by 180 degrees about z, so that panels are numbered from the opposite corner"
    )


def overexposure_doubt(clipped_share: float) -> Doubt | None:
    """Say whether too much of the mirror is overexposed.

    clipped_share: Share of the mirror at full scale in a usual photo.
    """
    if not clipped_share > _CLIPPED_SHARE:
        return None
    return Doubt(
        "mirror_overexposed",
        f"{100 * clipped_share:.0f} % of the mirror is overexposed: beside a sky at full scale the reflection's edges "
        "move and the tube looks thinner than it is; expose so that the sky stays below full scale",
        {"overexposed_share": clipped_share},
    )


def sparse_doubt(measured_share: float, eyes_m: FloatArray) -> Doubt | None:
    """Say whether the photos are too far apart to measure the mirror.

    Shapes: eyes_m (n, 3).
    measured_share: Share of the mirror with a value, of what can show the tube to these cameras.
    Returns: None where enough is measured.
    """
    if measured_share > _SPARSE_SHARE:
        return None
    steps = np.diff(np.sort(eyes_m[:, 0]))
    usual = float(np.median(steps)) if steps.size else 0.0
    remedy = "look at reflection_edges.csv for why edges were refused"
    if np.median(np.linalg.norm(eyes_m, axis=1)) > FAR_M:
        remedy = f"let the collector turn by {_GOOD_TURN_DEG:g} deg or less from photo to photo"
    elif usual > _GOOD_STEP_M:
        remedy = f"take photos at most {_GOOD_STEP_M:g} m apart across the trough"
    return Doubt(
        "mirror_measured_sparsely",
        f"only {100 * measured_share:.0f} % of the mirror that can show the tube was measured, by {len(eyes_m)} photos "
        f"some {usual:.2f} m apart: an edge of the reflection gives the slope only where it lies; {remedy}",
        {"measured_share": measured_share, "photos_count": len(eyes_m), "usual_step_m": usual},
    )


def scatter_doubt(image_sigma_factor: float, residual_rms_px: float, focal_px: float) -> Doubt | None:
    """Say whether image points scatter more than the edges of their targets let expect, while no other camera fits.

    image_sigma_factor: How many times their stated sigmas they scatter.
    residual_rms_px: RMS length of their residuals [px].
    Returns: Serious where lines of sight are off by so much that slopes are no tenth of a milliradian any more.
    """
    if image_sigma_factor < _SCATTER_FACTOR:
        return None
    # A mirror turns a ray by twice its own turn.
    slope_rad = 0.5 * residual_rms_px / focal_px
    return Doubt(
        "image_points_scatter",
        f"the targets' image points scatter by {residual_rms_px:.2f} px, {image_sigma_factor:.1f} times what the edges "
        "of the targets let expect, and no other camera was found that fits better; sigmas rest on the scatter, and "
        f"slopes may be off by {1e3 * slope_rad:.2f} mrad together. Did targets or the trough move between photos, did "
        "zoom or focus change, were photos scaled (focal_px scales with them), or did the camera fly fast with a "
        "rolling shutter?",
        {"image_sigma_factor": image_sigma_factor, "image_residual_rms_px": residual_rms_px, "slope_rad": slope_rad},
        Severity.SERIOUS if slope_rad > _WANTED_RAD else Severity.DOUBT,
    )


def missing_photos_doubt(names: Sequence[str]) -> Doubt | None:
    """Say whether the numbers in the photos' names leave out many.

    names: File names in their order.
    Returns: Nothing where names hold no numbers that count up; a note where every n-th is there, which may be wanted.
    """
    found = [re.fullmatch(r"(.*?)(\d+)(\.\w+)?", name) for name in names]
    parts = [(one[1], int(one[2])) for one in found if one is not None]
    if len(parts) < max(3, len(names)) or len({start for start, _ in parts}) > 1:
        return None
    numbers, given = (
        np.array(sorted(number for _, number in parts)),
        [name for _, name in sorted(zip(parts, names, strict=True))],
    )
    if int(np.ptp(numbers)) + 1 > 2 * numbers.size:
        # Numbers that are times or dates leave out nearly all; a single photo of another flight lies beyond the rest.
        kept = _without_stray_ends(numbers)
        numbers, given = numbers[kept], given[kept]
    steps = np.diff(numbers)
    span = int(numbers[-1] - numbers[0]) + 1
    missing = span - numbers.size
    if (steps < 1).any() or not _MISSING_SHARE * span <= missing <= numbers.size:
        return None
    widest = int(np.argmax(steps))
    between = f"{given[widest]} and {given[widest + 1]}" if steps[widest] > 2 else f"{given[0]} and {given[-1]}"
    return Doubt(
        "photos_missing",
        f"{missing} of {span} numbers of photos are missing, "
        f"{int(steps[widest]) - 1 if steps[widest] > 2 else missing} of them between {between}: an edge of the "
        "reflection gives the slope only where it lies, so what these showed is not measured; were files lost on the "
        "way from the camera?",
        {"missing_count": missing, "photos_count": int(numbers.size)},
        Severity.NOTE if np.ptp(steps) == 0 else Severity.DOUBT,
    )


def _without_stray_ends(numbers: IntArray) -> slice:
    """Return where numbers are without a single one at either end that is half as far off as all others span."""
    first = int(numbers[1] - numbers[0] > np.ptp(numbers[1:]) / 2)
    last = int(numbers[-1] - numbers[-2] > np.ptp(numbers[:-1]) / 2)
    return slice(first, numbers.size - last)


def other_sizes_doubt(
    photos: Sequence[str], photo: IntArray, target: IntArray, over_expected: FloatArray
) -> Doubt | None:
    """Say whether targets look larger or smaller in a few photos than in the others, as in another encoding.

    photos: Names of the photos.
    photo, target (n,): Number of the photo and of the target of each size.
    over_expected (n,): Sizes over what any one diameter lets expect at that place.
    """
    size = np.log(over_expected)
    usual = np.array(
        [np.median(size[target == one]) if (target == one).any() else 0.0 for one in range(target.max(initial=0) + 1)]
    )
    off = size - usual[target]
    own = [off[photo == one] for one in range(len(photos))]
    means = np.array([np.median(one) if one.size >= _FEWEST_SIZES else np.nan for one in own])
    known = np.isfinite(means)
    if np.count_nonzero(known) < 3:
        return None
    means -= np.nanmedian(means)
    least = max(_OTHER_SIZE, _SIZE_TIMES_SCATTER * robust_scale(means[known]))
    out = np.flatnonzero(np.abs(np.where(known, means, 0.0)) > least)
    if not out.size:
        return None
    worst = float(means[out[np.argmax(np.abs(means[out]))]])
    more = f" and {out.size - 5} more" if out.size > 5 else ""
    return Doubt(
        "targets_of_other_size",
        f"in {', '.join(photos[k] for k in out[:5])}{more} targets look {100 * abs(worst):.1f} % "
        f"{'larger' if worst > 0 else 'smaller'} than in the others: they are encoded otherwise (linear or sRGB), or "
        "overexposed, which moves their edges of the reflection, too; convert them as the others, or leave them out",
        {"photos_count": int(out.size), "size_off_ratio": worst},
    )
