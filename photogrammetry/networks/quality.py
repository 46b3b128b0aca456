"""What an adjusted network is worth: headline numbers, scale bars kept apart, doubts."""

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from heliogauge.doubts import Doubt, Severity
from heliogauge.validate import FloatArray
from photogrammetry.bundle.adjustment import BundleResult
from photogrammetry.bundle.constraints import Distance
from photogrammetry.bundle.statistics import examine_image_points
from photogrammetry.networks.length_error import LengthRole, LengthStatement, Verdict, measured_length
from photogrammetry.networks.solve_network import Solved
from photogrammetry.start_values.network import LeftOut

Numbers = dict[str, float | int | None]

#: A known value this many of its sigmas off is doubtful: 1 in 370 would be by chance.
_DOUBTFUL = 3.0
#: So many rejected image points of one target, a quarter of them all, are no accident.
_DOUBLED_RAYS = 2
#: Doubtful targets that get a sentence each; of the others so many are listed in one.
_NAMED_ALONE, _LISTED = 3, 10
#: Probability of naming any good image point of all.
_FAMILY = 0.01
#: Points whose distances from all others are looked at together.
_AT_ONCE = 64
#: Intersections below this many degrees say little of the depth.
_LEAST_ROLL_RAD = 0.5
#: Good measurements lose a few image points in a hundred; a wrong start loses every fifth.
_MANY_REJECTED = 0.08


@dataclass(frozen=True, slots=True)
class CheckedDistance:
    """A known distance beside the one in the network.

    name: What is known.
    targets: Its two ends.
    used: Whether the adjustment knew it.
    known_m, sigma_known_m, measured_m, sigma_measured_m: Distances and their sigmas [m].
    """

    name: str
    targets: tuple[str, ...]
    used: bool
    known_m: float
    sigma_known_m: float
    measured_m: float
    sigma_measured_m: float


def bar_checks(bundle: BundleResult, checks: Sequence[Distance]) -> tuple[CheckedDistance, ...]:
    """Compare known distances with those of the adjusted network.

    checks: Distances that were not used; those used follow from the network.
    Returns: Used ones first; those of targets that are not in the network are left out.
    """
    table = bundle.problem.observations
    place = {name: i for i, name in enumerate(table.targets)}
    used = [one for one in bundle.problem.constraints if isinstance(one, Distance)]
    found: list[CheckedDistance] = []
    for one, known in [*((one, True) for one in used), *((one, False) for one in checks)]:
        if not all(name in place for name in one.targets):
            continue
        pair = np.array([place[name] for name in one.targets], dtype=np.intp)
        length, sigma = measured_length(bundle, pair)
        found.append(CheckedDistance(one.name, one.targets, known, one.distance_m, one.sigma_m, length, sigma))
    return tuple(found)


def network_numbers(solved: Solved, lengths: LengthStatement) -> tuple[Numbers, dict[str, str]]:
    """Return the headline numbers, and why some are not determined.

    solved: The adjusted network.
    lengths: Known lengths against the network.
    Returns: Numbers with units in their names; reasons.
    """
    bundle = solved.bundle
    table = bundle.problem.observations
    squares = bundle.residuals_px**2
    sigmas = bundle.sigma_points_m[table.n_rays > 0]
    size_m = _extent_m(bundle)
    mean_sigma = np.sqrt((sigmas**2).mean(axis=0))
    checked = bar_checks(bundle, ())
    low, high = bundle.variance_factor_interval()
    overall = float(np.sqrt((mean_sigma**2).mean()))
    numbers: Numbers = {
        "points_count": int((table.n_rays > 0).sum()),
        "photos_count": int((table.n_targets_in_photo > 0).sum()),
        "image_points_count": table.n,
        "image_residual_rms_px": float(np.sqrt(squares.sum(axis=1).mean())),
        "image_residual_rms_per_coordinate_px": float(np.sqrt(squares.mean())),
        "largest_image_residual_px": float(np.sqrt(squares.sum(axis=1).max(initial=0.0))),
        "sigma0_ratio": bundle.sigma0,
        "variance_factor": bundle.variance_factor,
        "variance_factor_low_factor": low,
        "variance_factor_high_factor": high,
        "image_sigma_factor": solved.image_sigma_factor,
        "image_sigma_posterior_px": _posterior_sigma_px(bundle),
        "redundancy_count": bundle.redundancy,
        "point_sigma_x_rms_m": float(mean_sigma[0]),
        "point_sigma_y_rms_m": float(mean_sigma[1]),
        "point_sigma_z_rms_m": float(mean_sigma[2]),
        "point_sigma_largest_m": float(sigmas.max(initial=0.0)),
        "extent_m": size_m,
        "relative_precision_ratio": size_m / overall if overall > 0 else None,
        "largest_eccentricity_px": solved.largest_eccentricity_px,
        "rejected_image_points_count": len(solved.rejected) + len(solved.network.suspicious),
        "scale_bar_residual_rms_m": _rms([one.measured_m - one.known_m for one in checked]),
        **_length_numbers(lengths),
    }
    reasons = {
        "scale_bar_residual_rms_m": "no scale bar was used",
        **dict.fromkeys(
            ("length_error_rms_m", "length_error_largest_m", "length_error_sigma_ratio"),
            "no scale bar was kept apart (check_only = true)",
        ),
        **dict.fromkeys(
            ("length_error_left_out_rms_m", "length_error_left_out_largest_m", "length_error_left_out_sigma_ratio"),
            "leaving a scale bar out needs at least two",
        ),
        "length_errors_outside_count": "no permissible error is stated ([permissible_length_error])",
        "relative_precision_ratio": "all points are held",
        **dict.fromkeys(
            (
                "sigma0_ratio",
                "image_sigma_posterior_px",
                "variance_factor",
                "variance_factor_low_factor",
                "variance_factor_high_factor",
            ),
            "no redundancy",
        ),
    }
    known = {key: value if value is not None and np.isfinite(value) else None for key, value in numbers.items()}
    return known, {key: why for key, why in reasons.items() if known[key] is None}


def _length_numbers(lengths: LengthStatement) -> Numbers:
    numbers: Numbers = {}
    for role, name in ((LengthRole.KEPT_APART, "length_error"), (LengthRole.LEFT_OUT, "length_error_left_out")):
        errors = [one.error_m for one in lengths.of(role)]
        numbers[f"{name}_rms_m"] = _rms(errors)
        numbers[f"{name}_largest_m"] = max(map(abs, errors), default=None)
        numbers[f"{name}_sigma_ratio"] = _rms([one.error_m / one.sigma_error_m for one in lengths.of(role)])
    numbers["lengths_checked_count"] = len(lengths.best)
    numbers["measuring_lines_count"] = len(lengths.lengths_of_line)
    outside = sum(one.verdict is Verdict.OUTSIDE for one in lengths.best)
    numbers["length_errors_outside_count"] = None if lengths.permissible is None else outside
    return numbers


def check_lengths(lengths: LengthStatement) -> Iterator[Doubt]:
    """Yield which known lengths, that the network did not use, disagree with it."""
    for one in lengths.of(LengthRole.KEPT_APART):
        ratio = abs(one.error_m) / one.sigma_error_m
        if ratio > _DOUBTFUL:
            yield Doubt(
                "scale_bar_kept_apart_off",
                f"{one.name}, kept apart, is off by {1e3 * one.error_m:+.3f} mm, {ratio:.1f} "
                "times the sigma of this error: the lengths of this network are not as sure as their sigmas say",
                {"error_m": one.error_m, "sigma_error_m": one.sigma_error_m},
            )
    outside = [one for one in lengths.best if one.verdict is Verdict.OUTSIDE]
    if outside:
        text = f"length errors beyond the permissible one: {', '.join(one.name for one in outside)}"
        yield Doubt("length_errors_not_permissible", text, {"lengths_count": len(outside)})


def quality_texts(lengths: LengthStatement, extent_m: float) -> dict[str, str]:
    """Say what the numbers of quality mean, and what of VDI/VDE 2634 part 1 is fulfilled.

    lengths: Known lengths against the network.
    extent_m: Largest distance of two points [m].
    """
    limit, texts = lengths.permissible, {"length_check": lengths.coverage_text}
    if limit is not None:
        slope = f" + L / {limit.k:g}" if np.isfinite(limit.k) else ""
        bound = f", at most {1e3 * limit.b_m:g} mm" if np.isfinite(limit.b_m) else ""
        verdict = {"": "no length to decide with", "open": "undecided: the known lengths' own uncertainty decides"}
        answer = verdict.get(lengths.verdict.value, f"{lengths.verdict.value} for all {len(lengths.best)} lengths")
        if lengths.verdict is Verdict.OUTSIDE:
            outside = sum(one.verdict is Verdict.OUTSIDE for one in lengths.best)
            answer = f"exceeded by {outside} of {len(lengths.best)} length{'' if len(lengths.best) == 1 else 's'}"
        texts["permissible_length_error"] = f"{1e3 * limit.a_m:g} mm{slope}{bound}: {answer}"
    texts["relative_precision"] = (
        f"1:N with N the largest distance of two targets ({extent_m:.3f} m) over the RMS of all coordinates' sigmas"
    )
    return texts


def _posterior_sigma_px(bundle: BundleResult) -> float:
    """Return the sigma of an image coordinate as the residuals have it; DBAT's sigma0 where all are equal."""
    variances = np.einsum("mii->mi", bundle.problem.observations.covariance_px2)
    return float(np.sqrt(np.median(variances))) * bundle.sigma0


def _extent_m(bundle: BundleResult) -> float:
    """Return the largest distance of two points: of two corners of their hull."""
    points = bundle.points_m[bundle.problem.observations.n_rays > 0]
    return largest_distance_m(points[np.isfinite(points).all(axis=1)])


def largest_distance_m(points_m: FloatArray) -> float:
    """Return the largest distance of two points, shape (n, 3); 0 for fewer than two.

    No pair is longer than its two distances from the middle together, so most points need not be looked at.
    """
    if len(points_m) < 2:
        return 0.0
    # A long pair to begin with: from the point that is farthest from the middle to the farthest from that, and back.
    reach = np.linalg.norm(points_m - 0.5 * (points_m.min(axis=0) + points_m.max(axis=0)), axis=1)
    longest, place = 0.0, int(np.argmax(reach))
    for _ in range(3):
        others = np.linalg.norm(points_m - points_m[place], axis=1)
        longest, place = max(longest, float(others.max())), int(np.argmax(others))
    order = np.argsort(-reach)
    order = order[reach[order] + reach[order[0]] >= longest]
    outer, reach = points_m[order], reach[order]
    for first in range(0, len(outer), _AT_ONCE):
        # The first of these reaches farthest; only with such points as reach far enough can it be the longest.
        beside = outer[first:][reach[first:] + reach[first] >= longest]
        if reach[first] + reach[first] < longest:
            break
        own = outer[first : first + _AT_ONCE]
        squares = sum((own[:, axis, None] - beside[:, axis]) ** 2 for axis in range(3))
        longest = max(longest, float(np.sqrt(np.max(squares))))
    return longest


def _rms(values: Sequence[float]) -> float | None:
    return float(np.sqrt(np.mean(np.square(values)))) if values else None


def check_network(solved: Solved) -> Iterator[Doubt]:
    """Yield what makes a network doubtful."""
    bundle = solved.bundle
    yield from _photos_left_out(solved.network.photos_left_out)
    for one in solved.weak:
        yield Doubt("not_determined_left_out", f"{one.name}: {one.reason}; the network goes on without")
    yield from _doubtful_photos(solved.doubtful)
    yield from _unused_values(solved.unused)
    scaled = any(isinstance(one, Distance) for one in bundle.problem.constraints)
    if bundle.system.movements.count == 7 and not scaled:
        yield Doubt(
            "scale_missing",
            "there is no scale: coordinates and sigmas are in an arbitrary unit; add a [[scale_bar]]",
            severity=Severity.SERIOUS,
        )
    yield from _contradictions(bundle)
    yield from _many_rejected(solved)
    yield from _doubled_codes(solved)
    low, high = bundle.variance_factor_interval(0.999)
    if solved.image_sigma_factor == 1.0 and not low <= bundle.variance_factor <= high:
        yield Doubt(
            "residuals_contradict_stated_sigmas",
            f"the residuals are {bundle.sigma0:.2f} times what the stated sigmas say (sqrt of the variance factor; "
            f"{np.sqrt(low):.2f} to {np.sqrt(high):.2f} would be by chance); sigmas of the results are as stated, "
            'unless [adjustment] sigmas = "from residuals"',
            {"sigma0_ratio": bundle.sigma0, "low_ratio": float(np.sqrt(low)), "high_ratio": float(np.sqrt(high))},
        )
    yield from _unturned(bundle)
    yield from _kept_outliers(bundle)
    few = bundle.problem.observations.n_rays
    weak = [name for name, rays in zip(bundle.problem.observations.targets, few, strict=True) if rays == 2]
    if weak:
        listed = ", ".join(weak[:8]) + (f" and {len(weak) - 8} more" if len(weak) > 8 else "")
        text = f"{len(weak)} targets are seen in two photos only, where errors hardly show: {listed}"
        yield Doubt("targets_in_two_photos", text, {"targets_count": len(weak)})


def _photos_left_out(photos: Sequence[LeftOut]) -> Iterator[Doubt]:
    """Yield photos that are not in the network: one by its name, several together by their reasons."""
    if len(photos) == 1:
        yield Doubt("photo_not_in_network", f"photo {photos[0].name} is left out: {photos[0].reason}")
    elif photos:
        listed = ", ".join(f"{one.name} ({one.reason})" for one in photos[:_LISTED])
        more = ", ..." if len(photos) > _LISTED else ""
        text = f"{len(photos)} photos are left out: {listed}{more}"
        yield Doubt("photos_not_in_network", text, {"photos_count": len(photos)})


def _doubtful_photos(photos: Sequence[LeftOut]) -> Iterator[Doubt]:
    if photos:
        more = "" if len(photos) == 1 else f" (and {len(photos) - 1} more photos)"
        text = f"photo {photos[0].name}{more}: {photos[0].reason}"
        yield Doubt("photos_contradict_others", text, {"photos_count": len(photos)})


def _first_of(names: Sequence[str]) -> str:
    more = f" and {len(names) - _LISTED} more" if len(names) > _LISTED else ""
    return ", ".join(names[:_LISTED]) + more


def _unused_values(unused: Sequence[LeftOut]) -> Iterator[Doubt]:
    """Yield known values of targets that are not in the network, all for one reason together."""
    names_of: dict[str, list[str]] = {}
    for one in unused:
        names_of.setdefault(one.reason, []).append(one.name)
    if len(unused) == 1:
        yield Doubt("known_value_not_used", f"{unused[0].name}: {unused[0].reason}")
    elif unused:
        listed = "; ".join(
            f"{reason.removeprefix('not used: ')} ({_first_of(names)})" for reason, names in names_of.items()
        )
        yield Doubt("known_values_not_used", f"{len(unused)} known values are not used: {listed}")


def _unturned(bundle: BundleResult) -> Iterator[Doubt]:
    """Yield cameras whose principal point is estimated and that were always held the same way."""
    cameras = bundle.problem.cameras
    for place, model in enumerate(cameras):
        own = bundle.state.rotations[bundle.problem.camera_index == place]
        is_free = not {"center_x_px", "center_y_px"}.isdisjoint(model.free)
        if is_free and len(own) and (roll := _roll_range_rad(own)) < _LEAST_ROLL_RAD:
            whose = "" if len(cameras) == 1 else f" {model.name}"
            yield Doubt(
                "camera_never_turned",
                f"all photos are taken with the camera{whose} held the same way; turn it by 90 degrees for some, or "
                "the principal point is badly separated from the poses",
                {"roll_range_rad": roll},
            )


def _kept_outliers(bundle: BundleResult) -> Iterator[Doubt]:
    """Count image points that were used and contradict the rest: nothing is rejected on request, or rounds ran out."""
    tests = examine_image_points(bundle)
    # Sigmas that are too small as a whole are reported elsewhere; here one point against the others.
    scale = max(1.0, bundle.variance_factor) if np.isfinite(bundle.variance_factor) else 1.0
    squared = tests.length_squared / scale
    limit = -2 * np.log(_FAMILY / max(squared.size, 1))
    marked = np.nonzero(squared > limit)[0]
    if not marked.size:
        return
    worst = int(np.argmax(squared))
    length_px = float(np.hypot(*bundle.residuals_px[worst]))
    yield Doubt(
        "image_points_contradict",
        f"{marked.size} image points that were used contradict the others, most of all "
        f"{bundle.problem.observations.label(worst)} with {length_px:.2f} px ({np.sqrt(squared[worst]):.1f} sigma); "
        "see test in residuals.csv",
        {"image_points_count": marked.size, "largest_residual_px": length_px},
    )


def _many_rejected(solved: Solved) -> Iterator[Doubt]:
    """Yield a doubt where more image points were left out than chance and false codes explain."""
    lost = len(solved.rejected) + len(solved.network.suspicious)
    total = lost + solved.bundle.problem.observations.n
    if lost > _MANY_REJECTED * total:
        yield Doubt(
            "many_image_points_rejected",
            f"{lost} of {total} image points contradict the rest and were left out, too many for chance: a camera that "
            "started far off (give focal_length_35mm or focal_px), an object that moved, or one code at several places",
            {"rejected_count": lost, "image_points_count": total},
            Severity.SERIOUS,
        )


def _doubled_codes(solved: Solved) -> Iterator[Doubt]:
    """Yield targets of which several image points were rejected: one code at two places shows like this."""
    table = solved.bundle.problem.observations
    rejected = [one.target for one in solved.rejected]
    counts = Counter([*rejected, *(one.target for one in solved.network.suspicious)])
    rays = dict(zip(table.targets, table.n_rays.tolist(), strict=True))
    doubled = [(name, count, count + rays.get(name, 0)) for name, count in counts.most_common()]
    doubled = [one for one in doubled if one[1] >= _DOUBLED_RAYS and one[1] >= 0.25 * one[2]]
    for name, count, total in doubled[:_NAMED_ALONE]:
        yield Doubt(
            "target_contradicts_itself",
            f"target {name}: {count} of its {total} image points contradict the others; is the code there twice, or "
            "did the target move?",
            {"rejected_count": count, "image_points_count": total},
        )
    if len(doubled) > _NAMED_ALONE:
        rest = ", ".join(f"{name} ({count} of {total})" for name, count, total in doubled[_NAMED_ALONE:][:_LISTED])
        more = ", ..." if len(doubled) > _NAMED_ALONE + _LISTED else ""
        yield Doubt(
            "more_targets_contradict_themselves",
            f"so do those of {len(doubled) - _NAMED_ALONE} more targets or features: {rest}{more}",
            {"targets_count": len(doubled) - _NAMED_ALONE},
        )


def _contradictions(bundle: BundleResult) -> Iterator[Doubt]:
    """Yield what is known and contradicts the rest, the worst first."""
    found: list[tuple[float, str]] = []
    for name, residuals in bundle.constraint_residuals:
        worst = float(np.max(np.abs(residuals), initial=0.0))
        if worst > _DOUBTFUL:
            found.append((worst, name))
    distances = {one.name: one for one in bundle.problem.constraints if isinstance(one, Distance)}
    worst_first = sorted(found, reverse=True)
    axes = Counter(name.partition(" of ")[2] for _, name in worst_first)
    told: set[str] = set()
    for worst, name in worst_first[:8]:
        target = name.partition(" of ")[2]
        if target and target in told:
            continue  # Another coordinate of one target that is elsewhere.
        told.add(target)
        if target and axes[target] > 1:
            name = f"the listed place of {target} ({name.partition(' of ')[0]} most of all)"
        known = distances.get(name)
        size = "" if known is None else f" ({1e3 * worst * known.sigma_m:.2f} mm)"
        text = f"{name} contradicts the rest: its residual is {worst:.1f} times its sigma{size}"
        numbers = {"residual_over_sigma_ratio": worst}
        if target:
            yield Doubt("known_place_contradicts", text, numbers)
        else:
            yield Doubt("known_value_contradicts", text, numbers)


def _roll_range_rad(rotations: FloatArray) -> float:
    """Return how far a camera was turned about its axis, from the directions of its x axis across the views."""
    # Turn between each photo and the first after taking out the change of the viewing direction.
    first, angles = rotations[0], []
    for rotation in rotations:
        relative = rotation @ first.T
        angles.append(float(np.arctan2(relative[1, 0] - relative[0, 1], relative[0, 0] + relative[1, 1])))
    return float(np.abs(np.angle(np.exp(1j * np.array(angles)))).max(initial=0.0))
