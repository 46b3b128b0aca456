"""Photos to image points: read, find targets, measure, several photos at a time."""

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from itertools import islice
from pathlib import Path
from typing import TypeVar

import numpy as np

from heliogauge.doubts import Doubt, Severity, gather_doubts
from heliogauge.errors import MOST_PICTURES, EstimationError, FailurePicture, InputError
from heliogauge.flags import SampleFlag
from heliogauge.images.photos import Image, read_image
from heliogauge.images.thumbnails import make_thumbnail
from heliogauge.running.progress import Progress
from heliogauge.short_repr import ShortRepr
from heliogauge.validate import FloatArray, IntArray
from photogrammetry.detection.board_corners import find_charuco
from photogrammetry.detection.detections import Detections
from photogrammetry.detection.markers import find_markers
from photogrammetry.detection.photo_targets import TargetSearch, measure_targets
from photogrammetry.image_points import ImagePoints
from photogrammetry.keys.targets import TargetsSection
from photogrammetry.matching.uncertain_rays import Dots
from photogrammetry.networks.solve_uncoded import LooseDots
from photogrammetry.start_values.network import ImagePlace, LeftOut
from photogrammetry.targets.ring_codes import VENDOR_RADII, RingRadii, Sense

#: Share of overexposed targets from which there is a doubt.
_MANY_CLIPPED = 0.2
#: Share by which rings lie elsewhere than stated from which it is said; ink that spreads moves them by less.
_UNUSUAL_RADII = 0.05
#: Different codes of a photo that agree on where the rings lie, so that other photos are read there: as many as make a
#: second family of rings in one photo.
_SHARES = 3

_Read = TypeVar("_Read")


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredPhotos(ShortRepr):
    """Image points of all photos.

    ellipses_px2 (m, 2, 2): Shape of each target's ellipse; NaN for corners [px^2].
    sizes_px: Width and height of each photo; None where image points were given [px].
    refused: False codes, doubled names, photos without targets.
    doubts: What makes the result doubtful.
    sigma_assumed: Whether the sizes of the sigmas, beyond their ratios, are not to be believed.
    loose: Dots without a code, to be matched when the photos' poses are known.
    kinds (m,): Kind of each image point, of which each has a sigma of its own; None where all are alike.
    thumbnails: Small JPEG of each photo; empty where image points were given.
    """

    points: ImagePoints
    ellipses_px2: FloatArray
    sizes_px: dict[str, tuple[int, int]] | None
    refused: tuple[LeftOut, ...]
    doubts: tuple[Doubt, ...]
    sigma_assumed: bool
    loose: LooseDots | None = None
    kinds: IntArray | None = None
    thumbnails: Mapping[str, bytes] = field(default_factory=dict)

    def pictures(self, note: str = "") -> Iterator[FailurePicture]:
        """Yield photos with the targets that were measured in them, those with the fewest first.

        note: What was not found in them.
        """
        points, sizes = self.points, self.sizes_px or {}
        counts = np.bincount(points.photo_index, minlength=len(points.photos))
        numbers = {points.photos[number]: number for number in np.argsort(counts, kind="stable").tolist()}
        order = [*numbers, *(photo for photo in self.thumbnails if photo not in numbers)]
        for photo in order:
            if photo not in self.thumbnails:
                continue
            rows = np.flatnonzero(points.photo_index == numbers.get(photo, -1))
            labels = [points.targets[index] for index in points.target_index[rows].tolist()]
            said = "; ".join(filter(None, (f"{len(rows)} targets", note)))
            yield FailurePicture(photo, self.thumbnails[photo], said, sizes.get(photo), points.pixels_px[rows], labels)


@dataclass(frozen=True, slots=True, eq=False)
class OnePhoto(ShortRepr):
    """What one photo shows.

    detections: Targets with a name.
    ellipses_px2 (n, 2, 2): Shape of each target's ellipse; NaN for corners [px^2].
    size_px: Width and height [px].
    refused: What was not used.
    dots: Dots without a code.
    dot_ellipses_px2 (k, 2, 2): Their ellipses [px^2].
    unread: Code rings that are not in the dictionary as they are seen.
    thumbnail: The photo as a small JPEG; empty where there is none.
    """

    detections: Detections
    ellipses_px2: FloatArray
    size_px: tuple[int, int]
    refused: tuple[LeftOut, ...]
    dots: Detections
    dot_ellipses_px2: FloatArray
    unread: "UnreadRings | None" = None
    thumbnail: bytes = b""

    def with_thumbnail(self, thumbnail: bytes) -> "OnePhoto":
        """Return the same with the photo as a small JPEG."""
        return replace(self, thumbnail=thumbnail)


@dataclass(frozen=True, slots=True)
class UnreadRings:
    """Code rings of a photo that are not in the dictionary as they are seen.

    mirrored: Rings whose mirror image is in it.
    unknown: Bits of the others, clockwise.
    other_sense: Sense in which the dictionary does not count.
    radii: Where the rings lie, read or not; None without rings.
    stated: Where the dictionary says that they lie.
    fitting_bits: Number of sectors into which they divide, where it is not that of the dictionary.
    bits: That of the dictionary.
    elsewhere: Rings that read like codes where none of the photo's others lies.
    """

    mirrored: int
    unknown: tuple[str, ...]
    other_sense: str
    radii: RingRadii | None = None
    stated: RingRadii = VENDOR_RADII
    fitting_bits: int | None = None
    bits: int = 0
    elsewhere: int = 0


def measure_each(
    files: Sequence[Path], section: TargetsSection, search: TargetSearch, *, jobs: int | None, progress: Progress
) -> list[OnePhoto]:
    """Find and measure the targets of all photos.

    jobs: Photos measured side by side.
    Returns: Each photo's targets and dots, in the order of the files.
    InputError: A photo cannot be read, or two have the same name.
    """
    twice = [name for name, count in Counter(file.name for file in files).items() if count > 1]
    if twice:
        raise InputError(
            f"images.photos: {len(twice)} names occur in two folders ({twice[0]}); give photos other names"
        )

    def one(file: Path, asked: TargetSearch) -> OnePhoto:
        image = read_image(file)
        return measure_photo(image, file.name, section, asked).with_thumbnail(make_thumbnail(image))

    return read_together("measure photos", one, files, search, lambda found: found, jobs=jobs, progress=progress)


def read_together(
    name: str,
    work: Callable[[Path, TargetSearch], _Read],
    files: Sequence[Path],
    search: TargetSearch,
    photo_of: Callable[[_Read], OnePhoto],
    *,
    jobs: int | None,
    progress: Progress,
) -> list[_Read]:
    """Read photos of one sheet side by side, weak ones again where the others say where its rings lie.

    name: Of the stage.
    work: Reads one photo; the first error ends it.
    photo_of: What of that the photo shows.
    jobs: Photos at a time.
    Returns: What came of each, in the order of the files.
    """
    found = _side_by_side(name, lambda file: work(file, search), files, jobs, progress)
    again, weak = weak_photos([photo_of(one) for one in found], search)
    if weak:
        chosen = [files[k] for k in weak]
        better = _side_by_side(f"{name} again", lambda file: work(file, again), chosen, jobs, progress)
        for k, one in zip(weak, better, strict=True):
            found[k] = one
    return found


def _side_by_side(
    name: str, work: Callable[[Path], _Read], files: Sequence[Path], jobs: int | None, progress: Progress
) -> list[_Read]:
    found: list[_Read] = []
    with progress.stage(name, len(files)) as stage, ThreadPoolExecutor(jobs) as pool:
        waiting = [pool.submit(work, file) for file in files]
        try:
            for future in waiting:
                found.append(future.result())
                stage.advance()
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise
    return found


def weak_photos(found: Sequence[OnePhoto], search: TargetSearch) -> tuple[TargetSearch, list[int]]:
    """Say which photos may show more where the rings of another photo say where the sheet has its rings.

    found: The photos, each by itself.
    Returns: A search that reads rings there, too, and the photos worth it: those whose own rings do not say where they
        lie (few, small or blurred), or with rings that none of their own confirms. Without a photo of `_SHARES` codes
        that says it, none.
    """
    rings = [one.unread for one in found]
    sure = [
        (len(set(one.detections.names)), ring.radii)
        for one, ring in zip(found, rings, strict=True)
        if ring is not None and ring.radii is not None and len(set(one.detections.names)) >= _SHARES
    ]
    if not sure or search.radii is not None:
        return search, []
    best = max(sure, key=lambda one: one[0])[1]
    weak = [k for k, ring in enumerate(rings) if ring is not None and (ring.radii is None or ring.elsewhere)]
    return replace(search, other_radii=(best,)), weak


def measure_photo(image: Image, name: str, section: TargetsSection, search: TargetSearch) -> OnePhoto:
    """Find and measure the targets of one photo.

    Shapes: image (height, width).
    """
    squares = section.dictionary if section.has_markers else section.square_dictionary
    found = None if squares is None else _measure_markers(image, name, section, squares)
    if section.square_dictionary is not None and found is not None:
        return _beside_markers(_measure_circles(image, name, search), found)
    if found is not None and not search.with_uncoded:
        return found
    circles = _measure_circles(image, name, search)
    if found is not None:
        return replace(found, dots=circles.dots, dot_ellipses_px2=circles.dot_ellipses_px2)
    return circles


def _beside_markers(circles: OnePhoto, markers: OnePhoto) -> OnePhoto:
    """Put circular targets and square markers of a photo together."""
    return replace(
        circles,
        detections=circles.detections.joined(markers.detections),
        ellipses_px2=np.concatenate([circles.ellipses_px2, markers.ellipses_px2]),
        refused=(*circles.refused, *markers.refused),
    )


def _measure_circles(image: Image, name: str, search: TargetSearch) -> OnePhoto:
    """Find and measure ring codes and dots of one photo."""
    rings = measure_targets(image, name, search)
    shapes = np.array([center.ellipse.shape_px2 for center in rings.centers]).reshape(-1, 2, 2)
    count = len(rings.readings)
    dots = rings.detections.chosen(np.arange(count, len(rings.detections)))
    refused = [
        _left_out(f"target {code} in {name}", "is in the dictionary only as a mirror image", name, place)
        for code, place in zip(rings.mirrored, rings.mirrored_px, strict=True)
    ]
    refused += [
        _left_out(f"code ring in {name}", f"its bits, {word} clockwise, are not in the dictionary", name, place)
        for word, place in zip(rings.unknown_words, rings.unknown_px, strict=True)
    ]
    # Dots at the border that may be codes cut off are no news; rings that read like codes and are none are.
    refused += [
        _left_out(f"{'target ' + bad.name if bad.name else 'code ring'} in {name}", bad.reason, name, bad.center_px)
        for bad in rings.unused
        if bad.flag is not SampleFlag.CUT_BY_BORDER
    ]
    coded = rings.detections.chosen(np.arange(count))
    size = (int(image.shape[1]), int(image.shape[0]))
    counted = Sense.CLOCKWISE if search.dictionary is None else search.dictionary.sense
    other = Sense.COUNTERCLOCKWISE if counted is Sense.CLOCKWISE else Sense.CLOCKWISE
    unread = UnreadRings(len(rings.mirrored), rings.unknown_words, other)
    if search.dictionary is not None:
        radii = rings.radii[0] if rings.radii else None
        bits = search.dictionary.n_bits
        unread = replace(
            unread,
            radii=radii,
            stated=search.dictionary.radii,
            fitting_bits=rings.fitting_bits,
            bits=bits,
            elsewhere=rings.elsewhere,
        )
    return OnePhoto(coded, shapes[:count], size, tuple(refused), dots, shapes[count:], unread)


def _left_out(name: str, reason: str, photo: str, place_px: FloatArray) -> LeftOut:
    x, y = place_px.tolist()
    return LeftOut(name, reason, place=ImagePlace(photo, x, y))


def _measure_markers(image: Image, photo: str, section: TargetsSection, dictionary: str) -> OnePhoto:
    markers = find_markers(image, photo, dictionary)
    refused = [
        _left_out(
            f"marker {bad.number} at ({bad.center_px[0]:.0f}, {bad.center_px[1]:.0f}) in {photo}",
            bad.reason,
            photo,
            bad.center_px,
        )
        for bad in markers.rejected
    ]
    detections = markers.detections
    if section.charuco is not None:
        detections = _add_board(image, detections, section)
    shapes = np.full((len(detections), 2, 2), np.nan)
    size = (int(image.shape[1]), int(image.shape[0]))
    none = detections.chosen(np.zeros(0, dtype=np.intp))
    return OnePhoto(detections, shapes, size, tuple(refused), none, np.zeros((0, 2, 2)))


def _add_board(image: Image, markers: Detections, section: TargetsSection) -> Detections:
    """Add the inner corners of a ChArUco board, "board.0", "board.1"... row by row from its top left."""
    if section.charuco is None or section.dictionary is None:
        return markers
    board = section.charuco
    share = board.marker_mm / board.square_mm
    try:
        corners = find_charuco(markers.photo, image, board.columns, board.rows, section.dictionary, share)
    except EstimationError:
        corners = None
    if corners is None:
        return markers  # a photo without the board, or with too little of it
    count = corners.index.size
    return Detections(
        markers.photo,
        (*markers.names, *(f"board.{number}" for number in corners.index.tolist())),
        np.concatenate([markers.pixels_px, corners.pixels_px]),
        np.concatenate([markers.covariance_px2, corners.covariance_px2]),
        np.concatenate([markers.radius_px, np.full(count, np.nan)]),
        np.concatenate([markers.flags, np.zeros(count, dtype=np.uint32)]),
    )


def _collect_dots(found: Sequence[OnePhoto]) -> LooseDots:
    """Put together the dots of all photos."""
    photo = np.repeat(np.arange(len(found)), [len(one.dots) for one in found])
    covariance = np.concatenate([one.dots.covariance_px2 for one in found])
    dots = Dots(
        photo,
        np.concatenate([one.dots.pixels_px for one in found]),
        0.5 * (covariance + np.swapaxes(covariance, 1, 2)),
        np.concatenate([one.dot_ellipses_px2 for one in found]),
    )
    return LooseDots(tuple(one.detections.photo for one in found), dots)


def without_doubled(one: OnePhoto) -> OnePhoto:
    """Refuse the targets that are more than once in a photo."""
    twice = set(one.detections.duplicated)
    if not twice:
        return one
    # A marker of which one corner is doubled is there twice.
    markers = {name.split(".")[0] for name in twice}
    twice |= {name for name in one.detections.names if name.split(".")[0] in markers}
    photo = one.detections.photo
    refused = [
        _left_out(f"target {name} in {photo}", "is there more than once", photo, one.detections.pixels_px[places[0]])
        for name, places in sorted(_places_of(one.detections, twice).items())
    ]
    keep = np.array([k for k, name in enumerate(one.detections.names) if name not in twice], dtype=np.intp)
    return replace(
        one,
        detections=one.detections.chosen(keep),
        ellipses_px2=one.ellipses_px2[keep],
        refused=(*one.refused, *refused),
    )


def find_systematic_faults(found: Sequence[OnePhoto]) -> tuple[Doubt, ...]:
    """Return what many rings that are not in the dictionary say of it, and targets on overexposed white."""
    read = [one.detections for one in found]
    clipped = sum(int(np.count_nonzero(one.flags & np.uint32(SampleFlag.CLIPPED))) for one in read)
    count = sum(map(len, read))
    return gather_doubts(_unread_codes(found, count), _clipped(clipped, count))


def collect_photos(found: Sequence[OnePhoto]) -> MeasuredPhotos:
    """Put the targets of all photos together; those that are twice in a photo are not used there.

    Returns: Image points with covariances, and what was refused.
    EstimationError: No photo shows a target.
    """
    photos, names, parts, shapes = [], [], [], []
    refused: list[LeftOut] = []
    empty: list[str] = []
    doubled: dict[str, list[str]] = {}
    for seen in found:
        one = without_doubled(seen)
        refused += one.refused
        photo = one.detections.photo
        for name in sorted({name.split(".")[0] for name in set(seen.detections.names) - set(one.detections.names)}):
            doubled.setdefault(name, []).append(photo)
        keep = np.flatnonzero(one.detections.usable).tolist()
        if not keep:
            empty.append(photo)
            refused.append(LeftOut(photo, "shows no target that can be used"))
        photos += [photo] * len(keep)
        names += [one.detections.names[k] for k in keep]
        parts.append(one.detections.chosen(np.array(keep, dtype=np.intp)))
        shapes.append(one.ellipses_px2[keep])
    unread = tuple(_unread_codes(found, len(names)))
    if not names:
        usual = "is it the right one, and are the targets large enough ([targets] smallest_px, largest_px)?"
        error = EstimationError(
            f"images.photos: none of {len(found)} photos shows a target of the dictionary or list; "
            + (unread[0].text if unread else usual)
        )
        error.pictures = tuple(islice(pictures_of_photos(found), MOST_PICTURES))
        raise error
    clipped = sum(int(np.count_nonzero(part.flags & np.uint32(SampleFlag.CLIPPED))) for part in parts)
    doubts = gather_doubts(unread, _count_doubts(len(found), empty, doubled), _clipped(clipped, len(names)))
    covariance = np.concatenate([part.covariance_px2 for part in parts])
    # Estimators leave the two halves different in the last bit.
    covariance = 0.5 * (covariance + np.swapaxes(covariance, 1, 2))
    sizes = {one.detections.photo: one.size_px for one in found}
    thumbnails = {one.detections.photo: one.thumbnail for one in found if one.thumbnail}
    points = ImagePoints.from_names(photos, names, np.concatenate([part.pixels_px for part in parts]), covariance)
    # Corners of square markers and centres of dots are measured in other ways: each has a sigma of its own.
    ellipses = np.concatenate(shapes)
    is_corner = ~np.isfinite(ellipses).all(axis=(1, 2))
    is_mixed = 0 < np.count_nonzero(is_corner) < is_corner.size
    kinds: IntArray | None = np.asarray(is_corner, dtype=np.intp) if is_mixed else None
    return MeasuredPhotos(
        points,
        ellipses,
        sizes,
        tuple(refused),
        doubts,
        True,
        _collect_dots(found),
        kinds,
        thumbnails=thumbnails,
    )


def _places_of(detections: Detections, names: set[str]) -> dict[str, list[int]]:
    """Return where in the detections some names are."""
    places: dict[str, list[int]] = {name: [] for name in names}
    for k, name in enumerate(detections.names):
        if name in places:
            places[name].append(k)
    return places


def pictures_of_photos(found: Iterable[OnePhoto]) -> Iterator[FailurePicture]:
    """Yield photos with what was found in them, those with the least first: they show why it was not enough."""
    for one in sorted(found, key=lambda photo: len(photo.detections) + len(photo.dots)):
        if not one.thumbnail:
            continue
        refused = [bad for bad in one.refused if bad.place is not None]
        labels = [*one.detections.names, *("no code is read" for _ in one.dots.names), *(bad.reason for bad in refused)]
        places = [(bad.place.x_px, bad.place.y_px) for bad in refused if bad.place is not None]
        points = np.concatenate([one.detections.pixels_px, one.dots.pixels_px, np.reshape(places, (-1, 2))])
        note = f"{len(one.detections)} named targets, {len(one.dots)} dots without a code, {len(one.refused)} refused"
        yield FailurePicture(one.detections.photo, one.thumbnail, note, one.size_px, points, labels)


def _count_doubts(photos: int, empty: Sequence[str], doubled: Mapping[str, Sequence[str]]) -> Iterator[Doubt]:
    """Yield photos that show nothing, and targets that are twice in a photo."""
    if empty:
        listed = ", ".join(empty[:5]) + (", ..." if len(empty) > 5 else "")
        text = f"{len(empty)} of {photos} photos show no target that can be used: {listed}"
        yield Doubt("photos_without_target", text, {"empty_count": len(empty), "photos_count": photos})
    if doubled:
        most = sorted(doubled.items(), key=lambda pair: -len(pair[1]))[:5]
        listed = ", ".join(
            f"{name} (in {photos[0]})" if len(photos) == 1 else f"{name} ({len(photos)} photos: {photos[0]}, ...)"
            for name, photos in most
        )
        text = f"targets that occur more than once in a photo were not used there: {listed}; two equal sheets?"
        yield Doubt("targets_twice_in_a_photo", text, {"targets_count": len(doubled)})


def _clipped(clipped: int, targets: int) -> Doubt | None:
    if clipped <= _MANY_CLIPPED * targets:
        return None
    return Doubt(
        "targets_overexposed",
        f"{clipped} of {targets} targets lie on or are overexposed white: their sizes are uncertain and their "
        "centres less exact than their sigmas say; expose the photos less",
        {"overexposed_count": clipped, "targets_count": targets},
    )


def _unread_codes(found: Sequence[OnePhoto], read: int) -> Iterator[Doubt]:
    """Yield what many rings that are not in the dictionary say of it, the strongest sign first."""
    rings = [one.unread for one in found if one.unread is not None]
    mirrored, unknown = sum(one.mirrored for one in rings), [word for one in rings for word in one.unknown]
    total = mirrored + read + len(unknown)
    yield from _unusual_rings(rings)
    if mirrored > read:
        yield Doubt(
            "codes_mirrored",
            f"{mirrored} of {total} code rings are in the dictionary only as mirror images. "
            "If the prints are the right way round, the dictionary counts the bits in the other sense: set "
            f'sense = "{rings[0].other_sense}" in [targets]; else prints or photos are mirrored',
            {"mirrored_count": mirrored, "rings_count": total},
        )
    if len(unknown) > max(read, 3):
        yield Doubt(
            "codes_not_in_dictionary",
            f"{len(unknown)} code rings are not in the dictionary, bits clockwise {', '.join(unknown[:3])}...: is it "
            "another one, or one of your own ([targets] dictionary = a file)?",
            {"unknown_count": len(unknown), "rings_count": total},
        )


def _unusual_rings(rings: Sequence[UnreadRings]) -> Iterator[Doubt]:
    """Yield that rings divide otherwise than the dictionary says, and that they lie elsewhere."""
    divided = Counter(one.fitting_bits for one in rings if one.fitting_bits is not None)
    if divided:
        bits, count = divided.most_common(1)[0]
        yield Doubt(
            "codes_of_other_bits",
            f"in {count} of {len(rings)} photos the code rings divide into {bits} sectors, the dictionary has codes of "
            f"{rings[0].bits}: none of them was read. Name another dictionary, or a file with your own codes "
            "([targets] dictionary)",
            {"photos_count": count, "sectors_count": float(bits or 0), "dictionary_sectors_count": rings[0].bits},
        )
    found = np.array([(one.radii.inner, one.radii.outer) for one in rings if one.radii is not None]).reshape(-1, 2)
    if not len(found):
        return
    inner, outer = np.median(found, axis=0).tolist()
    stated = rings[0].stated
    if max(abs(inner / stated.inner - 1), abs(outer / stated.outer - 1)) > _UNUSUAL_RADII:
        yield Doubt(
            "code_rings_at_other_radii",
            f"the code rings lie at {inner:.2f} to {outer:.2f} radii of their dots, not at {stated.inner:g} to "
            f"{stated.outer:g}; that was found from the photos and used: either the print differs from the standard "
            "one, or the diameter that is stated for the dots is not theirs",
            {"ring_inner_radius_ratio": inner, "ring_outer_radius_ratio": outer, "photos_count": len(found)},
            Severity.NOTE,
        )
