"""What makes the turns of facets doubtful: exchanged facets, a source elsewhere, places that contradict each other."""

from collections.abc import Iterator, Sequence

import numpy as np

from deflectometry.overlay.facet_fit import Unused
from deflectometry.overlay.joint_turns import FEWEST_CHECKS, NO_CHECK, TURN_BY_WAVES, JointTurns
from deflectometry.overlay.source_image import Source
from deflectometry.overlay.source_size import FEWEST_FACETS, SourceSizes
from heliogauge.doubts import Doubt, Severity
from heliogauge.geometry.surfaces import Facet
from heliogauge.validate import FloatArray

#: What happens by chance once in a hundred measurements.
_UNLIKELY = 0.01
#: A mount is rarely out by more; the bright spot may be something else, or the facet another one.
_FAR_RAD = 0.03
#: Of a normal distribution 6e-5 is beyond: one false alarm in some thousand surveyed places.
_SURE_SIGMAS = 4.0
#: No facet of a heliostat is wavier (spec C-03, V-41: slope errors of 0.5 to 2 mrad, here of means over edges).
_WAVIEST_RAD = 1e-3
#: Light that is something else than the source.
_STRANGE = {Unused.DARKER, Unused.FOREIGN, Unused.CONTRADICTS, Unused.ALL_CONTRADICT}
#: Exchanged facets have at least halved turns once they are put back.
_BETTER = 0.5
#: And point much further from their design than the others typically do.
_UNUSUAL = 5.0


def doubts_of_turns(
    facets: Sequence[Facet],
    source: Source,
    found: JointTurns,
    names: Sequence[str],
    sigma_m: float,
    sizes: SourceSizes | None = None,
) -> Iterator[Doubt]:
    """Yield what a user should know before a mount is moved.

    names: Of the photos.
    sigma_m: As stated for the source's middle [m].
    sizes: Of its images; a plan has none.
    """
    unlikely = [name for name, one in zip(names, found.stations, strict=True) if one.probability < _UNLIKELY]
    if unlikely:
        worst = max(one.residual_px for one in found.stations)
        yield Doubt(
            "points_misfit_photo",
            f"points of known place are up to {worst:.2f} px RMS off in {', '.join(unlikely)}, more than sigma_px "
            "makes: their sigma was enlarged by as much",
            {"residual_px": worst, "photos_count": len(unlikely)},
        )
    strange = [n for n, one in enumerate(found.place_misfits) if one > _SURE_SIGMAS]
    if strange:
        yield Doubt(
            "place_contradicted",
            f"all facets in {', '.join(names[n] for n in strange)} are off alike against the other photos, by "
            f"{max(found.place_misfits[strange]):.0f} sigma: check the surveyed place (place_m) of its camera, and "
            "that the photo belongs to it",
            {"photos_count": len(strange)},
        )
    yield from _not_used(facets, found, names)
    yield from _exchanged_or_far(facets, found)
    yield from _common(source, found)
    if sizes is not None:
        yield from _size(sizes, source, found)
    if found.wave_rad > _WAVIEST_RAD:
        yield Doubt(
            "turns_contradict",
            f"turns of one facet differ by {1e3 * found.wave_rad:.2f} mrad from photo to photo, more than waves of a "
            "facet make: is a photo mirrored or of another heliostat, is the focal length the facets', and do distance "
            "and size of the source hold? The sigmas contain the difference",
            {"difference_rad": found.wave_rad},
        )
    if found.redundancy < FEWEST_CHECKS:
        own = float(np.sqrt(np.nanmean(found.random_rad**2)))
        yield Doubt(
            "waves_unknown",
            "too few photos check each other: how wavy the facets are is not known, and sigmas of turns and canting "
            f"contain the noise of the pixels, {1e3 * own:.2g} mrad, but hardly the waves, which turn a facet by "
            f"some {TURN_BY_WAVES:g} of their RMS slope in each photo ({TURN_BY_WAVES:g} mrad of 1 mrad); take three "
            "photos from different places",
            {"checks_count": found.redundancy, "sigma_random_rad": own},
            severity=Severity.SERIOUS if found.redundancy < NO_CHECK else Severity.DOUBT,
        )
    if sigma_m == 0:
        yield Doubt(
            "source_place_exact",
            "no sigma is given for the place of the source ([source] sigma_center_mm): it counts as exact, and the "
            "sigma of how the heliostat as a whole points is too small",
            severity=Severity.NOTE,
        )


def _not_used(facets: Sequence[Facet], found: JointTurns, names: Sequence[str]) -> Iterator[Doubt]:
    """Say which facets have no turn and why, which light was left out, and which turns nothing checks."""
    for k, (first, second) in found.rivals_rad.items():
        yield Doubt(
            "facet_ambiguous",
            f"facet {facets[k].name}: turns of ({1e3 * first[0]:+.2f}, {1e3 * first[1]:+.2f}) and "
            f"({1e3 * second[0]:+.2f}, {1e3 * second[1]:+.2f}) mrad explain its light equally well; none is stated. "
            "Photos from other places, or a facet that shows more of the source, decide",
            {"turns_apart_rad": float(np.linalg.norm(second - first))},
        )
    missing: dict[str, list[str]] = {}
    for k in np.flatnonzero(~found.known).tolist():
        if k not in found.rivals_rad:
            missing.setdefault(reasons(found, k, names), []).append(facets[k].name)
    if missing:
        texts = [f"{', '.join(own)} ({why})" for why, own in missing.items()]
        yield Doubt(
            "facet_without_image",
            f"no photo shows enough of the source's edge in facet {'; '.join(texts)}: it is turned too far, the "
            "source fills it or is hidden; the overlay shows where its image should be. Other photos may show it",
            {"facets_count": sum(map(len, missing.values()))},
        )
    for number, name in enumerate(names):
        strangers = [facet.name for facet, why in zip(facets, found.unused, strict=True) if why.get(number) in _STRANGE]
        if strangers:
            yield Doubt(
                "light_left_out",
                f"{name}: the light in facet {', '.join(strangers)} is no image of the source that a turn could make "
                "with the other photos: left out. Is the photo mirrored or of another place, the facet partly in shade "
                "or hidden, or something else bright?",
                {"facets_count": len(strangers)},
            )
    alone = [facet.name for facet, one in zip(facets, found.unchecked, strict=True) if one]
    if alone and found.redundancy >= NO_CHECK:
        yield Doubt(
            "facet_unchecked",
            f"the turn of facet {', '.join(alone)} hangs on one photo: no other checks it, and a part in shade or "
            "another bright thing may pass for the source's edge; take photos that show the source in it",
            {"facets_count": len(alone)},
        )


def reasons(found: JointTurns, facet: int, names: Sequence[str]) -> str:
    """Return why photos are not used for a facet, of a number, and that nothing checks its turn; empty if neither."""
    photos: dict[str, list[str]] = {}
    for number, why in sorted(found.unused[facet].items()):
        photos.setdefault(why, []).append(names[number])
    texts = [f"{' '.join(own)}: {why}" for why, own in photos.items()]
    return "; ".join([*texts, "one photo alone, unchecked"] if found.unchecked[facet] else texts)


def _normals(facets: Sequence[Facet], turns_rad: FloatArray) -> FloatArray:
    """Return the normals at the reference points in the heliostat's frame, shape (k, 3)."""
    found = []
    for facet, turn in zip(facets, turns_rad, strict=True):
        slope_x, slope_y = facet.design.gradient(*facet.reference_point_m)
        normal = np.array([-slope_x - turn[0], -slope_y - turn[1], 1.0])
        found.append(facet.ensemble_from_facet.rotate(normal / np.linalg.norm(normal)))
    return np.array(found)


def _exchanged_or_far(facets: Sequence[Facet], found: JointTurns) -> Iterator[Doubt]:
    """Name pairs of facets that fit each other's design, and facets that are far from theirs."""
    measured, design = _normals(facets, found.turns_rad), _normals(facets, np.zeros_like(found.turns_rad))
    mean = np.nanmean(found.turns_rad, axis=0)
    own = np.linalg.norm(found.turns_rad - np.nanmedian(found.turns_rad, axis=0), axis=1)
    pairs: list[tuple[int, int]] = []
    for i in range(len(facets)):
        for j in range(i):
            apart = np.linalg.norm(design[i] - design[j])
            crossed = max(np.linalg.norm(measured[i] - design[j]), np.linalg.norm(measured[j] - design[i]))
            straight = min(np.linalg.norm(measured[i] - design[i]), np.linalg.norm(measured[j] - design[j]))
            others = np.delete(own, [i, j])
            typical = float(np.nanmedian(others)) if np.isfinite(others).any() else 0.0
            if straight > _UNUSUAL * typical and crossed < _BETTER * apart and crossed < _BETTER * straight:
                pairs.append((j, i))
    if pairs:
        texts = [f"{facets[i].name} and {facets[j].name}" for i, j in pairs]
        yield Doubt(
            "facets_exchanged",
            f"facets {'; '.join(texts)} point where the other one should: their rotations in measurement.toml are "
            "exchanged; move no mount before that is clear",
            {"pairs_count": len(pairs)},
        )
    taken = {n for pair in pairs for n in pair}
    far = [
        facet.name
        for n, (facet, turn) in enumerate(zip(facets, found.turns_rad, strict=True))
        if np.linalg.norm(turn - mean) > _FAR_RAD and n not in taken
    ]
    if far:
        yield Doubt(
            "facet_turned_far",
            f"facet {', '.join(far)} is turned by more than {1e3 * _FAR_RAD:.0f} mrad against the others: is the "
            "bright spot in it the source, and are position and rotation of the facet those of the design?",
            {"facets_count": len(far)},
        )


def _common(source: Source, found: JointTurns) -> Iterator[Doubt]:
    """Say that all facets are off alike, and where the source would have to be for that."""
    known = found.known
    rows = np.repeat(known, 2)
    share = np.kron(np.ones(int(known.sum())) / known.sum(), np.eye(2))
    mean = np.mean(found.turns_rad[known], axis=0)
    covariance = share @ found.covariance[np.ix_(rows, rows)] @ share.T
    count = int(known.sum())
    if count < FEWEST_FACETS:
        return
    # Facets that scatter by so much have a mean that is off by a root of their number less: Hotelling's test.
    variance = covariance + np.cov(found.turns_rad[known].T) / count
    statistic = float(mean @ np.linalg.solve(variance, mean)) * (count - 2) / (2 * (count - 1))
    # Of two and count - 2 degrees of freedom it is beyond x with this probability.
    if (1 + 2 * statistic / (count - 2)) ** (-0.5 * (count - 2)) < _UNLIKELY:
        distance = float(np.linalg.norm(source.heliostat_from_source.translation_m))
        angle = float(np.linalg.norm(mean))
        yield Doubt(
            "all_facets_alike",
            f"all facets are turned alike, by {1e3 * angle:.2f} mrad: the heliostat as a whole points elsewhere, or "
            f"the source stood {2e3 * angle * distance:.0f} mm from where center_m says; photos cannot tell "
            "these apart. Moves of mounts do not contain it",
            {"mean_turn_rad": angle, "source_shift_m": 2 * angle * distance},
        )


def _size(sizes: SourceSizes, source: Source, found: JointTurns) -> Iterator[Doubt]:
    """Name the stated size of the source where its images have another one, and turns are less sure with it.

    An edge that is taken for one that lies elsewhere turns a facet by half of the angle between both.
    """
    distance = float(np.linalg.norm(source.heliostat_from_source.translation_m))
    usual = float(np.sqrt(np.nanmean(np.diag(found.canting()[1]))))
    keys = ("diameter_m",) if source.is_disc else ("width_m", "height_m")
    for axis, key in enumerate(keys):
        ratio = float(np.exp(sizes.mean[axis]))
        turned = abs(ratio - 1) * source.half_m[axis] / (2 * distance)
        if not (sizes.chance[axis] < _UNLIKELY and turned > usual):
            continue
        stated = 2 * source.half_m[axis]
        way = "smaller" if ratio < 1 else "larger"
        yield Doubt(
            "source_of_another_size",
            f"the images of the source are {100 * abs(ratio - 1):.0f} % {way} than [source] {key} = {stated:g} m makes "
            f"them: as of {stated * ratio:.3g} m. Is that its size, are focal_length_m and the distance (center_m) "
            "right, and was all of it lit? With the wrong one, turns of facets that show only one edge are wrong by "
            f"up to {1e3 * turned:.2g} mrad",
            {"size_ratio": ratio, "sigma_size_ratio": float(sizes.sigma[axis] * ratio), "turn_rad": turned},
        )
