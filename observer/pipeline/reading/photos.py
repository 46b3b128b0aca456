"""All photos of a measurement to targets, edges of the reflection and bearings of the tube, each photo read once.

What a photo shows of the tube is looked for as soon as its targets give it a provisional pose, from the coordinates
listed; the adjustment of all photos comes later, and what was found is moved to its poses
(`observer.photo_edges.moved_edges`).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple, TypeVar

import numpy as np

from heliogauge.camera.model import Camera
from heliogauge.errors import InputError
from heliogauge.geometry.rigid import RigidTransform
from heliogauge.images.photos import Image, read_luma
from heliogauge.images.thumbnails import make_thumbnail
from heliogauge.results.thumbnails import MOST_THUMBNAILS
from heliogauge.running.progress import Progress
from heliogauge.running.threads import side_by_side
from heliogauge.validate import IntArray
from observer.photo_edges.moved_edges import bearings_in_poses, edges_in_poses
from observer.photo_edges.reflection_edges import ReflectionEdges, joined, reflection_edges
from observer.photo_edges.tone import Tone, ToneEvidence, full_scale, linear_light, numbers_for_the_eye
from observer.photo_edges.tube_bearings import Bearings, tube_bearings
from observer.photo_edges.views import Shot, View
from observer.pipeline.reading.photo_poses import PlacedPhoto, place_photo
from observer.pipeline.reading.target_kinds import TargetKinds
from observer.pipeline.reading.tone import (
    Encodings,
    Sample,
    between_encodings,
    find_encodings,
    look_at_tone,
    sizes_of,
    some_of,
)
from observer.product.pictures import Slices, empty_slices
from observer.trough.expectation import Expectation
from photogrammetry.centers import EdgeShape, edge_shape
from photogrammetry.detection import TargetSearch, measure_at
from photogrammetry.keys import PhotogrammetryMeasurement, TargetsSection, UncodedSection
from photogrammetry.matching import KnownTargets, Track, agrees_with_list, follow, provisional_pose, start_following
from photogrammetry.pipeline import OnePhoto, build_cameras, build_search, measure_photo
from photogrammetry.start_values import LEAST_TARGETS, StartValues
from photogrammetry.targets import refuse_mirrored_codes

_Part = TypeVar("_Part", ReflectionEdges, Bearings)

#: Most photos that are followed through: each run begins with a search of the whole photo and is one thread's work.
_MOST_IN_RUN = 125
#: Photos that are read and measured together, and what their images may take [bytes]: each step is one operation on
#: many numbers, and a step that follows itself takes half the time.
_TOGETHER, _TOGETHER_BYTES = 16, 64_000_000
#: Photos that are looked at twice at most: for edges of panels when all poses are adjusted. They are kept until then as
#: far as they are no larger together than this [bytes].
_TWICE, _KEPT_BYTES = 60, 160_000_000
#: A photo in which fewer of the targets followed can be centred is searched as a whole.
_LEAST_SHARE = 0.6
#: Targets foreseen further than this beside a photo, in its longer sides, are not looked for there: 5 degrees of
#: the next trough's turn move its rims by 0.2 m, a fiftieth of what a photo shows.
_BESIDE_SHARE = 0.1
#: With a camera that moves so far between provisional and adjusted pose another part of the mirror may show the tube:
#: the photo is looked at again [m].
_FAR_M = 0.25
#: Points so far on both sides of the tube say which way is across it in a photo [m].
_ACROSS_M = 0.05


@dataclass(frozen=True, slots=True, eq=False)
class SeenInPhotos:
    """What the photos show of the absorber.

    edges: Edges that may be those of its reflection.
    bearings: Directions of the tube itself.
    slices: A few rows of the mirror in all photos, to look at.
    encodings: How the photos are encoded.
    """

    edges: ReflectionEdges
    bearings: Bearings
    slices: Slices
    encodings: Encodings


@dataclass(frozen=True, slots=True, eq=False)
class Finder:
    """What is looked for in each photo, and with what.

    section: What targets there are.
    search: How circular ones are searched for.
    known: Those with listed coordinates.
    camera_of: Camera of each photo to start with; empty where none is known.
    expected: Collector, absorber and rows.
    encodings: How the photos are encoded; None: estimated from them.
    kinds: What the listed targets look like.
    wants_loose: Whether dots that the list does not have are to be measured, too.
    others: Names of the targets of other troughs in the same photos.
    list_from_frame: From the trough's frame to that of the list that all troughs of a flight share; None where it has
        a list of its own.
    """

    section: TargetsSection
    search: TargetSearch
    known: KnownTargets
    camera_of: Mapping[str, Camera]
    expected: Expectation
    encodings: Encodings | None = None
    kinds: TargetKinds = field(default_factory=TargetKinds)
    wants_loose: bool = True
    others: frozenset[str] = frozenset()
    list_from_frame: RigidTransform | None = None

    def read(self, file: Path) -> Image:
        """Return a photo whose numbers are proportional to light."""
        return self.as_light(read_luma(file), file.name)

    def as_light(self, image: Image, name: str) -> Image:
        """Return a photo, as its file stores it, with numbers that are proportional to light."""
        return image if self.encodings is None else linear_light(image, self.encodings.tone_of(name))

    def is_decoded(self, name: str) -> bool:
        """Return whether a photo's numbers were turned into light."""
        return self.encodings is not None and self.encodings.tone_of(name) is Tone.SRGB

    @property
    def measures_alone(self) -> bool:
        """Whether the targets of a photo can be identified without the other photos."""
        return self.section.dictionary is not None and self.section.tracked_from is None

    @property
    def follows(self) -> bool:
        """Whether targets can be followed: round ones that codes or the list name, with a camera that is known."""
        loose = (self.search.with_uncoded and self.wants_loose) or self.section.square_dictionary is not None
        return self.search.dictionary is not None and not loose and bool(self.camera_of)

    def is_beside(self, camera: Camera, cam_from_list: RigidTransform) -> bool:
        """Return whether a photo with a pose in the common list shows none of the targets."""
        if self.list_from_frame is None:
            return False
        pixels = camera.project((cam_from_list @ self.list_from_frame).apply(self.known.points_m))
        size = np.array([camera.width_px, camera.height_px])
        margin = _BESIDE_SHARE * float(size.max())
        return not bool(((pixels > -margin) & (pixels < size + margin)).all(axis=1).any())

    def placed(self, image: Image, found: OnePhoto, camera: Camera | None) -> PlacedPhoto:
        """Return a photo that was searched under the names of the list, and its pose.

        found: What the search found.
        """
        one = self.kinds.named(found)
        if camera is None:
            return PlacedPhoto(one, None)
        if self.section.is_listed:
            # Dots of a list of their own are matched through the poses.
            return PlacedPhoto(one, provisional_pose(one.detections, self.known, camera))
        placed = place_photo(one, self.known, self.kinds.plain, camera)
        listed = set(self.known.names).intersection(one.detections.names)
        if placed.pose is None and listed and not self.search.with_uncoded:
            # Codes that look too flat to be read are dots still.
            name = one.detections.photo
            found = measure_photo(image, name, self.section, replace(self.search, with_uncoded=True))
            again = place_photo(self.kinds.named(found), self.known, self.kinds.plain, camera)
            placed = again._replace(photo=again.photo.with_thumbnail(one.thumbnail))
        if self.wants_loose:
            return placed
        none = np.zeros(0, dtype=np.intp)
        one = replace(placed.photo, dots=placed.photo.dots.chosen(none), dot_ellipses_px2=np.zeros((0, 2, 2)))
        return placed._replace(photo=one)


@dataclass(frozen=True, slots=True, eq=False)
class FirstLook:
    """What was found while the photos were read.

    photos: Names of all photos.
    targets: Targets of each photo, of one trough of several only where it is seen; empty where they are not measured
        one by one.
    poses: Provisional ``cam_from_frame`` of the photos whose listed targets determine it.
    edges, bearings: What those photos show of the tube.
    slices: A few rows of the mirror in all photos.
    encodings: How the photos are encoded; None where that is not known yet.
    by_list: Photos whose pose rests on the places of their dots, because too few codes are read.
    kept: Some photos as their files store them, to be looked at again and then given up.
    """

    photos: tuple[str, ...]
    targets: tuple[OnePhoto, ...]
    poses: dict[str, RigidTransform]
    edges: dict[str, ReflectionEdges]
    bearings: dict[str, Bearings]
    slices: Slices
    encodings: Encodings | None = None
    by_list: tuple[str, ...] = ()
    kept: dict[str, Image] = field(default_factory=dict)

    @property
    def start(self) -> StartValues | None:
        """Start values for the adjustment; None where fewer than two photos have a pose."""
        return StartValues(self.poses) if len(self.poses) >= 2 else None


@dataclass(frozen=True, slots=True, eq=False)
class _Photo:
    """A photo in hand: its number, its name, and its camera if that is known."""

    number: int
    name: str
    image: Image
    camera: Camera | None


class _Placed(NamedTuple):
    """A photo in hand and its provisional ``cam_from_frame``; None where its targets determine none."""

    photo: _Photo
    pose: RigidTransform | None


@dataclass(slots=True, eq=False)
class _Run:
    """Consecutive photos in one thread's hands, and what was found so far."""

    finder: Finder
    slices: Slices
    track: Track | None = None
    #: Photos whose targets wait to be centred together, and where they are.
    waiting: list[tuple[_Photo, Track]] = field(default_factory=list)
    targets: dict[str, OnePhoto] = field(default_factory=dict)
    poses: dict[str, RigidTransform] = field(default_factory=dict)
    edges: dict[str, ReflectionEdges] = field(default_factory=dict)
    bearings: dict[str, Bearings] = field(default_factory=dict)
    #: What whole photos show, searched for this trough or for another one in the same photos.
    searched: "_Searched" = field(default_factory=lambda: _Searched({}, {}))
    #: Photos with a pose by the places of their dots, because too few codes are read.
    by_list: list[str] = field(default_factory=list)

    def take(self, number: int, name: str, image: Image, cam_from_list: RigidTransform | None = None) -> None:
        """Find what a photo shows, or leave that to `finish`.

        cam_from_list: Its pose in the common list by another trough; None where none is known.
        """
        photo = _Photo(number, name, image, self.finder.camera_of.get(name))
        if self.track is not None and photo.camera is not None:
            self.track = follow(image, self.track, self.finder.known, photo.camera)
            if self.track is not None:
                self.waiting.append((photo, self.track))
                return
        self.finish()
        if cam_from_list is None or photo.camera is None or not self.finder.is_beside(photo.camera, cam_from_list):
            self._look([_Placed(photo, self._searched(photo))])

    def finish(self) -> None:
        """Centre the targets of the photos that wait, and find what these show."""
        if not self.waiting:
            return
        waiting, self.waiting = self.waiting, []
        measured = measure_at(
            [photo.image for photo, _ in waiting],
            [photo.name for photo, _ in waiting],
            [track.ellipses for _, track in waiting],
            self.finder.search,
        )
        seen: list[_Placed] = []
        for (photo, track), (found, shapes) in zip(waiting, measured, strict=True):
            if np.count_nonzero(found.usable) < max(LEAST_TARGETS, _LEAST_SHARE * len(track.ellipses)):
                seen.append(_Placed(photo, self._searched(photo)))
                continue
            seen.append(_Placed(photo, track.pose))
            none, (height, width) = found.chosen(np.zeros(0, dtype=np.intp)), photo.image.shape
            size = int(width), int(height)
            self.targets[photo.name] = OnePhoto(found, shapes, size, (), none, np.zeros((0, 2, 2)))
        if self.track is not None and self.track is waiting[-1][1]:
            # Ellipses as they look now: the perspective changes along the path.
            found, shapes = measured[-1]
            ellipses = self.track.ellipses.renewed(found.names, found.pixels_px, shapes)
            self.track = replace(self.track, ellipses=ellipses)
        self._look(seen)

    def _look(self, photos: Sequence["_Placed"]) -> None:
        """Find what photos show, step by step: what works on all of them in turn stays in the processor's caches."""
        expected = self.finder.expected
        known = [
            (one.name, _shot(one.image, one.number, View(one.camera, pose), self.targets.get(one.name), expected))
            for one, pose in photos
            if one.camera is not None and pose is not None
        ]
        names, shots = [name for name, _ in known], [shot for _, shot in known]
        self.slices.take(shots, expected.collector)
        self.poses.update(zip(names, [shot.view.cam_from_frame for shot in shots], strict=True))
        self.edges.update(zip(names, reflection_edges(shots, expected), strict=True))
        self.bearings.update(zip(names, tube_bearings(shots, expected), strict=True))

    def _searched(self, photo: _Photo) -> RigidTransform | None:
        name, camera, finder = photo.name, photo.camera, self.finder
        found = self.searched.at(photo, finder)
        placed = finder.placed(photo.image, found, camera)
        if placed.pose is None and camera is not None and finder.is_decoded(name):
            # Light of dark codes is a few numbers only: no photo is lost that can be placed as it is stored.
            stored, found = self.searched.as_stored(photo, finder)
            again = finder.placed(stored, found, camera)
            placed = placed if again.pose is None else again
        found, pose = placed.photo, placed.pose
        if pose is None and finder.others and set(finder.known.names).isdisjoint(found.detections.names):
            # One of a hundred troughs is in few photos of a flight.
            return None
        self.targets[name] = found
        if placed.by_list:
            self.by_list.append(name)
        if pose is None or camera is None:
            return None
        own = np.array([k for k, one in enumerate(found.detections.names) if one not in finder.others], dtype=np.intp)
        detections = found.detections.chosen(own)
        if finder.follows and agrees_with_list(detections, finder.known, camera, pose):
            self.track = start_following(photo.image, detections, found.ellipses_px2[own], pose)
        return pose


@dataclass(frozen=True, slots=True, eq=False)
class _Searched:
    """Photos that were searched as a whole, by their names: as light, and decoded ones as they are stored."""

    light: dict[str, OnePhoto]
    stored: dict[str, OnePhoto]

    def at(self, photo: _Photo, finder: Finder) -> OnePhoto:
        """Return what a photo shows."""
        return _once(self.light, photo.name, photo.image, finder)

    def as_stored(self, photo: _Photo, finder: Finder) -> tuple[Image, OnePhoto]:
        """Return the numbers of a photo as its file has them, and what they show."""
        image = numbers_for_the_eye(photo.image)
        return image, _once(self.stored, photo.name, image, finder)


def _once(known: dict[str, OnePhoto], name: str, image: Image, finder: Finder) -> OnePhoto:
    if name not in known:
        known[name] = measure_photo(image, name, finder.section, finder.search)
    return known[name]


def build_finder(
    network: PhotogrammetryMeasurement,
    known: KnownTargets,
    expected: Expectation,
    encodings: Encodings | None = None,
    kinds: TargetKinds | None = None,
) -> Finder:
    """Collect what is looked for in each photo.

    known: Those with listed coordinates.
    expected: Collector, absorber and rows.
    encodings: How the photos are encoded; None: as they show it themselves.
    kinds: What the listed targets look like.
    Returns: With the cameras, where measurement.toml or their files have them.
    InputError: Cameras or dictionary that cannot be used.
    """
    # Corners are targets without a code whose places are listed.
    section = network.model.targets or TargetsSection(uncoded=_as_listed(known))
    cameras: dict[str, Camera] = {}
    names = [file.name for file in network.photo_files]
    stated = network.model.camera
    if all(one.is_known for one in stated):
        sizes = None
        if not all(one.has_size for one in stated):
            height, width = read_luma(network.photo_files[0]).shape
            sizes = dict.fromkeys(names, (width, height))
        built = build_cameras(network, names, sizes)
        cameras = {name: built.cameras[place] for name, place in built.camera_of.items()}
    search, looks = build_search(section, network.folder), kinds or TargetKinds()
    wants_loose = search.with_uncoded
    if looks.plain and cameras:
        # They are named in each photo; without a camera they are matched through the poses.
        search = replace(search, with_uncoded=True)
    return Finder(section, search, known, cameras, expected, encodings, looks, wants_loose)


def _as_listed(known: KnownTargets) -> tuple[UncodedSection, ...]:
    return tuple(
        UncodedSection(target=name, xyz_m=(place[0], place[1], place[2]), sigma_mm=1e3 * sigma)
        for name, place, sigma in zip(known.names, known.points_m.tolist(), known.sigma_m.tolist(), strict=True)
    )


def measure_targets(files: Sequence[Path], finder: Finder, *, jobs: int | None, progress: Progress) -> FirstLook:
    """Measure the targets of photos alone; the absorber is looked for when all poses are adjusted.

    files: The photos.
    jobs: Photos side by side.
    Returns: Targets and provisional poses.
    InputError: A photo cannot be read.
    """
    names = tuple(file.name for file in files)
    slices = empty_slices(finder.expected.collector, finder.expected.y_m, len(files))
    if not finder.measures_alone:
        return FirstLook(names, (), {}, {}, {}, slices, finder.encodings)

    def one(number: int) -> PlacedPhoto:
        image, name = finder.read(files[number]), names[number]
        found = measure_photo(image, name, finder.section, finder.search)
        stage.advance()
        return finder.placed(image, found.with_thumbnail(make_thumbnail(image)), finder.camera_of.get(name))

    with progress.stage("measure photos", len(files)) as stage:
        found = side_by_side(one, range(len(files)), jobs)
    poses = {name: one.pose for name, one in zip(names, found, strict=True) if one.pose is not None}
    by_list = tuple(name for name, one in zip(names, found, strict=True) if one.by_list)
    return FirstLook(names, tuple(one.photo for one in found), poses, {}, {}, slices, finder.encodings, by_list)


def look_first(files: Sequence[Path], finder: Finder, *, jobs: int | None, progress: Progress) -> FirstLook:
    """Read all photos once: measure their targets, find the absorber and its reflection.

    files: The photos, in the order in which they were taken.
    jobs: Photos side by side.
    Returns: What was found, photos by their numbers among the files.
    InputError: A photo cannot be read.
    """
    return look_first_at_each(files, [finder], jobs=jobs, progress=progress)[0]


def look_first_at_each(
    files: Sequence[Path], finders: Sequence[Finder], *, jobs: int | None, progress: Progress
) -> list[FirstLook]:
    """Look for several troughs in the same photos, each of which is read, and searched as a whole, once.

    files: The photos, in the order in which they were taken.
    finders: What is looked for, for each trough; they differ in known targets and expectation only.
    jobs: Photos side by side.
    Returns: What was found for each trough, photos by their numbers among the files.
    InputError: A photo cannot be read, or its codes are mirrored.
    """
    slices = [empty_slices(one.expected.collector, one.expected.y_m, len(files)) for one in finders]
    names = tuple(file.name for file in files)
    leader = finders[0]
    if not leader.measures_alone:
        return [FirstLook(names, (), {}, {}, {}, own, leader.encodings) for own in slices]
    searched: dict[str, OnePhoto] = {}
    with progress.stage("look how photos are encoded"):
        # One flight, one camera: the first trough that shows it decides.
        encodings = _find_encodings(files, finders, searched)
        finders = [replace(one, encodings=encodings) for one in finders]
    leader = finders[0]
    parts = _runs_of(len(files)) if leader.follows else [range(k, k + 1) for k in range(len(files))]
    wanted = set(evenly(len(files)).tolist()) if len(finders) == 1 else set()
    kept: dict[str, Image] = {}
    # Of long flights some photos, evenly: a report shows no more.
    every = -(-len(files) // MOST_THUMBNAILS)
    with progress.stage("measure photos", len(files)) as stage:

        def one_run(k: int) -> list[_Run]:
            both = _Searched(dict(searched), {})
            own = [_Run(finder, part, searched=both) for finder, part in zip(finders, slices, strict=True)]
            images: list[tuple[int, Image]] = []
            small: dict[str, bytes] = {}
            for number in parts[k]:
                # Decoding drives all other code out of the processor's caches: several photos, then the rest.
                stored = read_luma(files[number])
                if number in wanted and stored.nbytes <= _KEPT_BYTES / len(wanted):
                    kept[files[number].name] = stored
                images.append((number, leader.as_light(stored, files[number].name)))
                if number % every == 0:
                    small[files[number].name] = make_thumbnail(images[-1][1])
                is_full = len(images) >= min(_TOGETHER, _TOGETHER_BYTES / images[-1][1].nbytes)
                if is_full or number == parts[k][-1]:
                    _look_for_each(own, [(taken, files[taken].name, image) for taken, image in images])
                    stage.advance(len(images))
                    images.clear()
            for run in own:
                for name in small.keys() & run.targets.keys():
                    run.targets[name] = replace(run.targets[name], thumbnail=small[name])
            return own

        found = side_by_side(one_run, range(len(parts)), jobs)
    if leader.search.dictionary is not None:
        whole = [one for runs in found for one in (*runs[0].searched.light.values(), *runs[0].targets.values())]
        read = {name for one in whole for name in one.detections.names}
        refuse_mirrored_codes(read, [name for one in finders for name in one.known.names], leader.search.dictionary)
    looks = [
        _put_together(names, runs, own, encodings) for runs, own in zip(zip(*found, strict=True), slices, strict=True)
    ]
    return [replace(one, kept=kept) for one in looks]


def evenly(count: int) -> IntArray:
    """Return numbers of photos, evenly spread over a pass, that are looked at twice."""
    return np.unique(np.linspace(0, count - 1, min(count, _TWICE)).round().astype(np.intp))


def _look_for_each(runs: Sequence[_Run], photos: Sequence[tuple[int, str, Image]]) -> None:
    """Look for each trough in some photos; where one is found, others that must be beside the photo are not sought.

    Troughs that are followed come first, and one that is found in a photo is followed through the rest before the
    others are sought there: else a trough that comes into view after another one would be sought in whole photos.
    """
    cam_from_list: dict[str, RigidTransform] = {}

    def take(run: _Run, some: Sequence[tuple[int, str, Image]]) -> None:
        for number, name, image in some:
            run.take(number, name, image, cam_from_list.get(name))

    def put_down(run: _Run) -> None:
        frame = run.finder.list_from_frame
        if frame is not None:
            found = {name: run.poses[name] for _, name, _ in photos if name in run.poses}
            cam_from_list.update({name: pose @ frame.inverse() for name, pose in found.items()})

    lost = [run for run in runs if run.track is None]
    for run in runs:
        if run.track is not None:
            take(run, photos)
            run.finish()
            put_down(run)
    for k in range(len(photos)):
        for run in tuple(lost):
            take(run, photos[k : k + 1])
            if run.track is not None:
                lost.remove(run)
                take(run, photos[k + 1 :])
                run.finish()
            put_down(run)


def _runs_of(count: int) -> list[range]:
    """Divide photos into runs that begin, after the first, with those from which the encoding of all is estimated."""
    ends = [*sorted({0, *some_of(count)}), count]
    runs = []
    for first, end in pairwise(ends):
        length = -(-(end - first) // -(-(end - first) // _MOST_IN_RUN))
        runs += [range(k, min(k + length, end)) for k in range(first, end, length)]
    return runs


def _put_together(
    names: tuple[str, ...], runs: Sequence[_Run], slices: Slices, encodings: Encodings | None
) -> FirstLook:
    """Return what consecutive runs over the photos found."""
    targets = tuple(one for run in runs for one in run.targets.values())
    poses = {name: pose for run in runs for name, pose in run.poses.items()}
    edges = {name: part for run in runs for name, part in run.edges.items()}
    bearings = {name: part for run in runs for name, part in run.bearings.items()}
    by_list = tuple(name for run in runs for name in run.by_list)
    return FirstLook(names, targets, poses, edges, bearings, slices, encodings, by_list)


def _find_encodings(
    files: Sequence[Path], finders: Sequence[Finder], searched: dict[str, OnePhoto]
) -> Encodings | None:
    """Return how photos are encoded, from those whose targets determine the pose; None where no camera is known.

    searched: What is found in photos that need no decoding is put down here.
    """
    leader = finders[0]
    if leader.encodings is not None or not leader.camera_of:
        return leader.encodings

    def evidence_of(file: Path) -> ToneEvidence | None:
        image, name = read_luma(file), file.name
        found = searched[name] = measure_photo(image, name, leader.section, leader.search)
        # One flight, one camera: the first trough whose targets the photo shows.
        for finder in finders:
            one, pose, _ = finder.placed(image, found, finder.camera_of[name])
            if pose is not None:
                sample, stated = Sample(image, View(finder.camera_of[name], pose)), finder.section.diameter_mm
                size_m = None if stated is None else 1e-3 * stated
                sizes = sizes_of(sample, one, finder.known, finder.search, size_m)
                return look_at_tone(sample, finder.expected, sizes)
        return None

    found = find_encodings(files, evidence_of)
    for name in [name for name in searched if found.tone_of(name) is Tone.SRGB]:
        del searched[name]  # It was searched as it is stored.
    return found


def look_again(
    files: Sequence[Path],
    views: Sequence[View],
    finder: Finder,
    first: FirstLook,
    *,
    jobs: int | None,
    progress: Progress,
) -> SeenInPhotos:
    """Carry what was found to the adjusted poses.

    Read again are only photos that had no pose yet, or a wrong one, or whose camera moved while it read its rows.

    views: Camera and ``cam_from_frame`` of each, adjusted.
    first: What was found when the photos were read.
    jobs: Photos side by side.
    InputError: A photo cannot be read, or all cameras stand behind the mirror.
    """
    expected = finder.expected
    encodings = first.encodings
    if encodings is None:
        view_of = dict(zip(files, views, strict=True))

        def evidence_of(file: Path) -> ToneEvidence:
            return look_at_tone(Sample(read_luma(file), view_of[file]), expected, np.zeros((2, 0)))

        encodings = find_encodings(files, evidence_of)
    finder = replace(finder, encodings=encodings)
    if views and max(float(one.eye_m[2]) for one in views) < 0:
        raise InputError(
            "targets: with the coordinates listed all cameras stand behind the mirror (z below 0); is the list "
            "mirrored? x goes across, y along, z from the vertex to the absorber, right-handed"
        )
    before, late = [], []
    for number, (file, view) in enumerate(zip(files, views, strict=True)):
        pose = first.poses.get(file.name)
        is_near = pose is not None and _distance_m(pose, view.cam_from_frame) < _FAR_M
        if pose is not None and is_near and file.name in first.edges and not view.moves:
            before.append(View(finder.camera_of[file.name], pose))
        else:
            before.append(view)
            late.append(number)
    place = {name: k for k, name in enumerate(first.photos)}
    order = [place[file.name] for file in files]
    slices = first.slices.of_photos(order)
    targets = {one.detections.photo: one for one in first.targets}

    def one(number: int) -> tuple[ReflectionEdges, Bearings]:
        file = files[number]
        shot = _shot(finder.read(file), number, views[number], targets.get(file.name), expected)
        slices.take([shot], expected.collector)
        stage.advance()
        return reflection_edges([shot], expected)[0], tube_bearings([shot], expected)[0]

    with progress.stage("find the reflection", len(late)) as stage:
        found = dict(zip(late, side_by_side(one, late, jobs), strict=True))
    edges = [found[k][0] if k in found else first.edges[file.name] for k, file in enumerate(files)]
    bearings = [found[k][1] if k in found else first.bearings[file.name] for k, file in enumerate(files)]
    everything = [_renumbered(part, k) for k, part in enumerate(edges)]
    tubes = [_renumbered(part, k) for k, part in enumerate(bearings)]
    together = Bearings(*(np.concatenate([getattr(one, name) for one in tubes]) for name in Bearings.__slots__))
    moved = edges_in_poses(joined(everything), before, views, expected)
    placed, encodings = between_encodings(moved, files, views, encodings, expected)
    return SeenInPhotos(placed, bearings_in_poses(together, before, views, expected), slices, encodings)


def _shot(image: Image, number: int, view: View, targets: OnePhoto | None, expected: Expectation) -> Shot:
    """Return a photo with its view, and with what its targets tell of how edges are blurred across the trough."""
    if targets is None:
        return Shot(image, number, view)

    def edges() -> EdgeShape | None:
        axis, middle = expected.absorber, float(np.mean(expected.y_m))
        x, z = (float(one) for one in axis.at(np.array(middle)))
        ends = view.project(np.array([[x - _ACROSS_M, middle, z], [x + _ACROSS_M, middle, z]]))
        centers = np.concatenate([targets.detections.pixels_px, targets.dots.pixels_px])
        ellipses = np.concatenate([targets.ellipses_px2, targets.dot_ellipses_px2])
        good = np.concatenate([targets.detections.usable, targets.dots.usable])
        return edge_shape(image, centers[good], ellipses[good], ends[1] - ends[0], full_scale(image))

    return Shot(image, number, view, edges)


def _distance_m(first: RigidTransform, second: RigidTransform) -> float:
    return float(np.linalg.norm(first.inverse().translation_m - second.inverse().translation_m))


def _renumbered(part: _Part, number: int) -> _Part:
    return replace(part, photo=np.full(part.photo.size, number, dtype=np.intp))
