"""Photos read row after row while the camera flew: image points as a camera at rest would have taken them, and back.

Poses and targets are adjusted to image points that are moved to the middle row; the motions over the frames come from
the normal equations of that adjustment. Both in turn settle where the joint adjustment has its minimum.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from heliogauge.doubts import Doubt, Severity
from heliogauge.errors import EstimationError, InputError
from heliogauge.geometry.rigid import RigidTransform
from heliogauge.images.photo_times import photo_time_s
from heliogauge.images.video_names import FRAME, video_of
from heliogauge.validate import FloatArray, IntArray
from observer.keys import RollingShutterSection
from observer.photo_edges.views import project_moving
from observer.shutter.flight import Flight, flight_by_places, flight_by_times
from observer.shutter.readout import Known, RowMotions, estimate_motions, reduce_to_motions, steady_readout
from photogrammetry import pipeline as photogrammetry_pipeline
from photogrammetry.pipeline import MeasuredPhotos

#: Rounds of motions and adjustment. Each leaves a tenth to a third of the error, as the path turns with the poses and
#: rejected image points come back; from 60 mm to a tenth of a sigma takes nine.
_MOST_ROUNDS = 25
#: Parts of the way that are tried in a round: image points that are far off can mislead one, as the rejected ones are.
_SHARES = (1.0, 0.5, 0.25, 0.125)
#: Motions have settled where none changes by more than this share of its sigma: less than that is left.
_SETTLED = 0.1
#: Targets show a readout, or contradict the stated one, from so many sigmas on: by chance one in 10^6.
CONTRADICTED = 4.9
#: With fewer photos no path tells in which direction the camera flew.
_FEWEST_PHOTOS = 3
#: A readout is stated as well as this share where nothing else is said: read off a data sheet or a test clip.
_STATED_SHARE = 0.05
#: Where nobody says it: root mean square of the readouts of 17 cameras of drones, 17 to 74 ms, half of them below 33 ms
#: (measured, table of OpenDroneMap, `opendm/rollingshutter.py`) [s].
_USUAL_READOUT_S = 0.04
#: No drone takes photos sooner after each other (data sheet of the Zenmuse P1): where none says when it was taken [s].
_SOONEST_S = 0.7
#: Between photos more than so many times the usual time apart the drone paused, or flew to the next pass: photos at
#: even times, cut off to whole seconds, are no further apart, also where one is missing between two.
_PAUSE_TIMES = 3.0


@dataclass(frozen=True, slots=True, eq=False)
class Shutter:
    """What is stated of a rolling shutter and of the flight.

    known: Readout and its sigma [s]; None: unknown.
    speed_m_s: Speed over ground; None: by the times of the photos, or unknown.
    times_s: When each photo was taken, by its name; empty where that is not known.
    """

    known: Known | None = None
    speed_m_s: float | None = None
    times_s: Mapping[str, float] | None = None

    @property
    def in_seconds(self) -> bool:
        """Whether the readout is known and estimated as a time, not as the way flown in it."""
        return self.speed_m_s is not None or bool(self.times_s)

    def flight(self, names: Sequence[str], places_m: FloatArray) -> Flight:
        """Return how the camera flew past photos; directions where no speed is known.

        places_m (n, 3): The cameras in the order of the flight [m].
        """
        if self.times_s:
            return flight_by_times(places_m, np.array([self.times_s[name] for name in names]))
        return flight_by_places(places_m, self.speed_m_s or 1.0)


@dataclass(frozen=True, slots=True, eq=False)
class RolledNetwork:
    """A network adjusted with the motions over its frames.

    network: The adjustment, to image points as a camera at rest would have taken them.
    motions: How the camera moves while it reads each photo; without the stated readout where the targets contradict it.
    alone: The same with the readout unknown: what the targets say of it.
    """

    network: photogrammetry_pipeline.Result
    motions: RowMotions
    alone: RowMotions


def read_shutter(section: RollingShutterSection | None, files: Sequence[Path]) -> Shutter | None:
    """Collect what measurement.toml and the photos' times say; None where no rolling shutter is stated.

    files: Photos or frames of a video, in the order of the flight.
    InputError: A readout in milliseconds without a speed, and no times from which it follows.
    """
    if section is None:
        return None
    speed = section.speed_m_s
    times = {} if speed is not None else _times_of(files)
    known = None
    if section.readout_ms is not None:
        if speed is None and not times:
            raise InputError(
                "rolling_shutter.readout_ms: how far the camera flew in it is not known: the photos do not say when "
                "they were taken to fractions of a second; add speed_m_s, or leave readout_ms out"
            )
        sigma = section.sigma_ms if section.sigma_ms is not None else _STATED_SHARE * abs(section.readout_ms)
        known = Known(1e-3 * section.readout_ms, 1e-3 * sigma)
    return Shutter(known, speed, times)


def frame_motion_m(section: RollingShutterSection, files: Sequence[Path], places_m: Mapping[str, FloatArray]) -> float:
    """Return how far a camera flies while it reads a photo's rows, as what is stated or else photos and drone say [m].

    files: Photos or frames of a video, in the order of the flight.
    places_m: Where the drone took them, by their names [m].

    The speed is the length of the way over its time, without pauses and what is flown in them. Where no photo says when
    it was taken, the camera flew from one to the next in no less than a drone needs between two.
    """
    readout_s = _USUAL_READOUT_S if section.readout_ms is None else 1e-3 * abs(section.readout_ms)
    if section.speed_m_s is not None:
        return readout_s * section.speed_m_s
    placed = [file for file in files if file.name in places_m]
    if len(placed) < 2:
        return 0.0
    ways_m = np.linalg.norm(np.diff([places_m[file.name] for file in placed], axis=0), axis=1)
    times_s = np.diff([time_s for time_s, _ in _said_times(placed)])
    if not (times_s > 0).any():
        return readout_s * float(ways_m.mean()) / _SOONEST_S
    in_flight = (times_s >= 0) & (times_s <= _PAUSE_TIMES * np.median(times_s[times_s > 0]))
    return readout_s * float(ways_m[in_flight].sum() / times_s[in_flight].sum())


def _times_of(files: Sequence[Path]) -> dict[str, float]:
    """Return when photos were taken, by their names; empty unless all say it to fractions, each later than the last."""
    said = _said_times(files)
    times = [time_s for time_s, sigma_s in said if sigma_s == 0]
    if len(times) < len(files) or (np.diff(times) <= 0).any():
        return {}
    return dict(zip([file.name for file in files], times, strict=True))


def _said_times(files: Sequence[Path]) -> list[tuple[float, float]]:
    """Return when photos or frames were taken and how well they say it [s]; nothing unless all do."""
    frames = [FRAME.fullmatch(file.name) for file in files]
    if all(frame is not None for frame in frames):
        from heliogauge.images.video import frames_per_second

        rate = frames_per_second(video_of(files[0]))
        return [] if rate is None else [(int(frame["number"]) / rate, 0.0) for frame in frames if frame is not None]
    said = [one for file in files if (one := photo_time_s(file)) is not None]
    return said if len(said) == len(files) else []


def adjust_rolling(
    adjust: Callable[[MeasuredPhotos], photogrammetry_pipeline.Result], measured: MeasuredPhotos, shutter: Shutter
) -> RolledNetwork:
    """Adjust poses, targets and the motions over the frames.

    adjust: Adjusts the network to image points.
    measured: Image points as they were measured.
    EstimationError: They do not settle, or nothing is determined.
    """
    network, path = adjust(measured), _Path(shutter, measured.points.photos)
    moved: Mapping[str, FloatArray] = {}
    before: tuple[str, ...] = ()
    left, share = np.zeros(0), 1.0
    for _ in range(_MOST_ROUNDS):
        path.follow(network)
        found = path.motions_of(network, moved)[0]
        was_left, left = left, np.ravel(found.motions_m - [moved.get(name, np.zeros(3)) for name in found.photos])
        is_alike = before == found.photos
        settled = is_alike and _has_settled(left, found)
        share = _part_of_the_way(share, was_left, left) if is_alike else 1.0
        before = found.photos
        network, moved, share = _adjusted(adjust, measured, network, path, path.of_all(found), moved, share)
        # A part of the way is no sign that it is short.
        if settled:
            path.follow(network)
            return RolledNetwork(network, *path.motions_of(network, moved))
    raise EstimationError(
        f"rolling_shutter: readout and poses do not settle in {_MOST_ROUNDS} rounds; are the photos in the order of "
        "the flight, and did the camera hold its direction while it read them?"
    )


class _Path:
    """Where photos were taken and how the camera flew past them; also those lost, where a network last had them.

    A photo is lost while its points, not yet moved to a camera at rest, fit no pose. The way past its neighbours leads
    over it, and its points are moved as its own part of the way says, else neither comes right.

    photos: All photos in the order of the flight.
    """

    def __init__(self, shutter: Shutter, photos: Sequence[str]) -> None:
        self._shutter = shutter
        self._photos = photos
        self.poses: dict[str, RigidTransform] = {}

    def follow(self, network: photogrammetry_pipeline.Result) -> None:
        """Take the poses of a network."""
        bundle = network.solved.bundle
        self.poses |= dict(zip(bundle.problem.observations.photos, bundle.cam_from_world, strict=True))

    def motions_of(
        self, network: photogrammetry_pipeline.Result, moved_to: Mapping[str, FloatArray]
    ) -> tuple[RowMotions, RowMotions]:
        """Estimate the motions over the frames, as the function of the same name."""
        names, flight = self._flight()
        kept = np.flatnonzero(np.isin(names, network.solved.bundle.problem.observations.photos))
        return motions_of(network, self._shutter, flight.of(kept), moved_to)

    def of_all(self, found: RowMotions) -> dict[str, FloatArray]:
        """Return the motion of each photo that has a pose [m]; of one that is lost, by the path."""
        names, flight = self._flight()
        motions = dict(zip(names, found.readout * flight.velocity, strict=True))
        return motions | dict(zip(found.photos, found.motions_m, strict=True))

    def _flight(self) -> tuple[list[str], Flight]:
        names = [name for name in self._photos if name in self.poses]
        return names, self._shutter.flight(
            names, np.array([self.poses[name].inverse().translation_m for name in names])
        )


def _adjusted(
    adjust: Callable[[MeasuredPhotos], photogrammetry_pipeline.Result],
    measured: MeasuredPhotos,
    network: photogrammetry_pipeline.Result,
    path: _Path,
    wanted: Mapping[str, FloatArray],
    moved: Mapping[str, FloatArray],
    whole: float,
) -> tuple[photogrammetry_pipeline.Result, Mapping[str, FloatArray], float]:
    """Adjust to a part of the way to new motions, or to less of it where that cannot be adjusted.

    whole: The part, at most 1.
    Returns: The network, the motions to which its image points were moved, and the part of the way that this is.
    EstimationError: Not even an eighth of the way.
    """
    for share in (whole * part for part in _SHARES):
        reached = {name: (1 - share) * moved.get(name, np.zeros(3)) + share * motion for name, motion in wanted.items()}
        try:
            return adjust(_at_rest(measured, network, path.poses, reached)), reached, share
        except EstimationError as error:
            refused = error
    raise refused


def _nearest_of(photos: Sequence[str], among: Sequence[str]) -> dict[str, str]:
    """Return for each photo the nearest one of some in the order of the flight: itself, if it is one."""
    place = {name: k for k, name in enumerate(photos)}
    return {name: min(among, key=lambda one: abs(place[one] - place[name])) for name in photos}


def motions_of(
    network: photogrammetry_pipeline.Result, shutter: Shutter, flight: Flight, moved_to: Mapping[str, FloatArray]
) -> tuple[RowMotions, RowMotions]:
    """Estimate the motions over the frames of an adjusted network: with what is stated, and by the targets alone.

    flight: How the camera flew past the photos of the network.
    moved_to: Motion of each photo to which its image points were moved [m]; those of others were not.
    EstimationError: Poses and targets are not determined.
    """
    bundle = network.solved.bundle
    names = bundle.problem.observations.photos
    moved = np.array([moved_to.get(name, np.zeros(3)) for name in names])
    reduced = reduce_to_motions(bundle, moved)
    alone = replace(estimate_motions(reduced, moved, flight), in_seconds=shutter.in_seconds)
    known = shutter.known
    if known is None or times_sigma(alone, known) >= CONTRADICTED:
        return alone, alone
    both = estimate_motions(reduced, moved, flight, known)
    return replace(both, in_seconds=shutter.in_seconds), alone


def times_sigma(alone: RowMotions, known: Known) -> float:
    """Return by how many sigmas what the targets say of the readout differs from what is stated."""
    return float(abs(alone.readout - known.value) / np.hypot(alone.sigma_readout, known.sigma))


def _has_settled(left_m: FloatArray, found: RowMotions) -> bool:
    return bool((np.abs(left_m) <= _SETTLED * np.sqrt(np.diag(found.covariance_m2))).all())


def _part_of_the_way(last: float, was_left_m: FloatArray, left_m: FloatArray) -> float:
    """Return which part of what is left to go, as the last part changed what was left: all of it, or less.

    Aitken's relaxation (Irons and Tuck 1969, Int. J. Numer. Methods Eng. 1, 275) for rounds that go to and fro, as the
    path turns with the poses; never more than all.
    """
    change = left_m - was_left_m
    return float(np.clip(-last * (was_left_m @ change) / max(float(change @ change), 1e-300), _SHARES[-1], 1.0))


def _at_rest(
    measured: MeasuredPhotos,
    network: photogrammetry_pipeline.Result,
    poses: Mapping[str, RigidTransform],
    motions: Mapping[str, FloatArray],
) -> MeasuredPhotos:
    """Move image points to where a camera at rest in the middle row would have taken them.

    poses, motions: Of photos that are or were in the network.

    Targets that are not in the network, and dots without a name, are moved as those beside them; all of a photo that
    never was in it as those of the nearest one that is.
    """
    bundle, points, loose = network.solved.bundle, measured.points, measured.loose
    table, state = bundle.problem.observations, bundle.state
    pixels = points.pixels_px.copy()
    dots = np.zeros((0, 2)) if loose is None else loose.dots.pixels_px.copy()
    place = {name: k for k, name in enumerate(table.targets)}
    known = np.array([place.get(name, -1) for name in points.targets], dtype=np.intp)[points.target_index]
    rows_of, dots_of = _rows_by_name(points.photos, points.photo_index), {}
    if loose is not None:
        dots_of = _rows_by_name(loose.photos, loose.dots.photo_index)
    camera_of = _nearest_of(points.photos, table.photos)
    number = {name: k for k, name in enumerate(table.photos)}
    placed = [name for name in poses if (known[rows_of[name]] >= 0).any()]
    for photo, near in _nearest_of(points.photos, placed).items():
        pose, rows, motion = poses[near], rows_of[photo], poses[near].rotate(motions[near])
        camera = state.cameras[int(bundle.problem.camera_index[number[camera_of[near]]])]
        of_near = known[rows_of[near]]
        shown = pose.apply(state.points_m[np.unique(of_near[of_near >= 0])])
        taken = project_moving(camera, shown, motion)
        away = camera.project(shown) - taken
        beside = away[_nearest(pixels[rows], taken)]
        if photo == near:
            own = pose.apply(state.points_m[np.maximum(known[rows], 0)])
            named = camera.project(own) - project_moving(camera, own, motion)
            beside = np.where((known[rows] >= 0)[:, None], named, beside)
        pixels[rows] += beside
        mine = dots_of.get(photo)
        if mine is not None:
            dots[mine] += away[_nearest(dots[mine], taken)]
    if loose is not None:
        loose = replace(loose, dots=replace(loose.dots, pixels_px=dots))
    return replace(measured, points=replace(points, pixels_px=pixels), loose=loose)


def _rows_by_name(photos: Sequence[str], photo_index: IntArray) -> dict[str, IntArray]:
    return {name: np.flatnonzero(photo_index == k) for k, name in enumerate(photos)}


def _nearest(pixels_px: FloatArray, among_px: FloatArray) -> IntArray:
    """Return which of some image points is nearest to each of others."""
    return np.asarray(np.linalg.norm(pixels_px[:, None] - among_px, axis=2).argmin(axis=1))


def shutter_doubts(found: RolledNetwork, shutter: Shutter) -> tuple[Doubt, ...]:
    """Say whether the targets contradict the readout as it is stated."""
    known, alone = shutter.known, found.alone
    if known is None or times_sigma(alone, known) < CONTRADICTED:
        return ()
    text = (
        f"rolling_shutter: the targets say that a frame is read in {1e3 * alone.readout:.2f} +- "
        f"{1e3 * alone.sigma_readout:.2f} ms, {1e3 * known.value:.2f} +- {1e3 * known.sigma:.2f} ms are stated, which "
        "was not used. Is readout_ms the time from the first row to the last one, "
        "and speed_m_s or the times right? Did the camera turn while it read? Leave readout_ms out to have it estimated"
    )
    numbers = {
        "found_s": alone.readout,
        "sigma_found_s": alone.sigma_readout,
        "stated_s": known.value,
        "sigma_stated_s": known.sigma,
    }
    return (Doubt("rolling_shutter_contradicted", text, numbers, Severity.SERIOUS),)


def unstated_doubt(network: photogrammetry_pipeline.Result, *, can_be_stated: bool = True) -> Doubt | None:
    """Say whether the targets show a rolling shutter that nobody stated; None where they do not, or cannot.

    can_be_stated: Whether the table is allowed: not with targets without codes.
    """
    bundle = network.solved.bundle
    if len(bundle.cam_from_world) < _FEWEST_PHOTOS:
        return None
    try:
        flight = Shutter().flight(bundle.problem.observations.photos, bundle.state.centers_m)
        steady, sigma = steady_readout(bundle, flight)
        # Where all rows are read at once nothing moves, and the path leaves nothing open either.
        if abs(steady) < CONTRADICTED * sigma:
            return None
        found = motions_of(network, Shutter(), flight, {})[0]
    except EstimationError:
        return None
    if abs(found.readout) < CONTRADICTED * found.sigma_readout:
        return None
    advice = "Hover for each photo, or use targets with codes"
    if can_be_stated:
        advice = "Write the table [rolling_shutter] into measurement.toml to have it estimated, or hover for each photo"
    return Doubt(
        "rolling_shutter_not_stated",
        f"photos: image points lie as if the camera had moved by {1e3 * abs(found.readout):.1f} +- "
        f"{1e3 * found.sigma_readout:.1f} mm along its path while it read each photo"
        f"{' from the last row to the first' if found.readout < 0 else ''}, as with a rolling shutter; poses, slopes "
        f"and absorber are wrong with that. {advice}; else look whether the camera's aspect and skew and the list of "
        "targets or the drawing are right",
        {"motion_m": found.readout, "sigma_motion_m": found.sigma_readout},
        Severity.SERIOUS,
    )
