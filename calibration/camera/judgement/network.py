"""Whether the photos of a calibration suffice: coverage of the image, tilt, roll, depth, photos from one place."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from calibration.camera.corners.detection import BoardPoints
from calibration.camera.start_values.board_network import BoardNetwork
from calibration.camera.start_values.intrinsics import tilt_and_roll
from calibration.camera.start_values.orientation import Orientations
from heliogauge.camera.model import Camera
from heliogauge.doubts import Doubt, Severity
from heliogauge.geometry.rigid import RigidTransform
from heliogauge.validate import FloatArray

#: Cells of the coverage count along x and y.
_CELLS = (10, 8)
#: Photos below which a calibration rests on too little, tilt and spread that decide about focal length and centre.
_FEW_PHOTOS = 6
_LEAST_TILT_RAD = np.radians(20.0)
_LEAST_ROLL_RAD = np.radians(45.0)
_LEAST_DEPTH_RATIO = 1.2
_LEAST_COVERED_SHARE = 0.7
_LEAST_RADIUS_SHARE = 0.8
#: Photos in which the board's points are this near, as a share of the image's diagonal, are from one place.
_SAME_PLACE_SHARE = 0.005
#: Where one uncertain direction makes a photo's misfit, three of its sigmas happen by chance to 1 photo in 400; a photo
#: that is predicted this many times worse than the middle one has a weight in the result that nothing else has.
CONTRADICTS, _ALONE = 3.0, 5.0
#: Boards that agree after a shift and a change of size to this share of their extent look alike: 8 deg of tilt or 1 deg
#: of roll make more, noise of corners less. It decides what a refusal lists, nothing else.
_ALIKE_SHARE = 0.005
#: What to do about a network that lacks something.
_PLAN = "; `heliogauge camera plan` proposes the next photos"
#: More of the board at the sensor's limit moves edges: light spills over.
_SATURATED_SHARE = 0.05


@dataclass(frozen=True, slots=True, eq=False)
class Coverage:
    """Where in the image the board was measured.

    counts (8, 10): Points in each cell of the image.
    share: Share of cells with points.
    radius_share: Largest distance of a point from the middle, over that of the image's corners.
    """

    counts: FloatArray
    share: float
    radius_share: float


def coverage(camera: Camera, pixels_px: FloatArray) -> Coverage:
    """Count measured points over the image.

    Shapes: pixels_px (n, 2).
    Returns: Counts in 10 x 8 cells.
    """
    size = np.array([camera.width_px, camera.height_px])
    edges = [np.linspace(-0.5, extent - 0.5, cells + 1) for extent, cells in zip(size, _CELLS, strict=True)]
    counts = np.histogram2d(pixels_px[:, 1], pixels_px[:, 0], bins=(edges[1], edges[0]))[0]
    middle = 0.5 * (size - 1)
    reach = float(np.linalg.norm(pixels_px - middle, axis=1).max() / np.linalg.norm(middle))
    return Coverage(counts, float(np.mean(counts > 0)), reach)


def check_network(poses: Sequence[RigidTransform], covered: Coverage) -> Iterator[Doubt]:
    """Yield what makes a network weak, with the number that shows it and the remedy.

    poses: ``cam_from_board`` of each photo.
    """
    angles = np.array([tilt_and_roll(pose) for pose in poses])
    distances = np.array([float(np.linalg.norm(pose.translation_m)) for pose in poses])
    if len(poses) < _FEW_PHOTOS:
        yield Doubt(
            "photos_few",
            f"only {len(poses)} photos: errors of single photos are hardly averaged; take 10 or more",
            {"photos_count": len(poses)},
        )
    most = float(angles[:, 0].max())
    if most < _LEAST_TILT_RAD:
        yield Doubt(
            "network_flat",
            f"flat network: the board is never tilted by more than {np.degrees(most):.0f} deg, so focal length and "
            "distance are hardly separated; tilt it by 30 to 45 deg to all sides"
            f"{_PLAN}",
            {"largest_tilt_rad": most},
        )
    difference = np.abs(np.angle(np.exp(1j * (angles[:, None, 1] - angles[None, :, 1]))))
    roll = float(np.minimum(difference, np.pi - difference).max())
    half_turns = float(difference.max())
    if max(roll, half_turns) < _LEAST_ROLL_RAD:
        yield Doubt(
            "network_without_roll",
            f"no roll: the camera is turned about its axis by {np.degrees(half_turns):.0f} deg at most, so principal "
            "point, tangential distortion and pixel aspect lean on the board's shape; turn it by 90 deg for some "
            f"photos{_PLAN}",
            {"largest_roll_rad": max(roll, half_turns)},
        )
    depth = float(distances.max() / distances.min())
    if depth < _LEAST_DEPTH_RATIO:
        yield Doubt(
            "network_without_depth",
            f"no depth: all photos are from nearly one distance (ratio {depth:.2f}); take some from half as far again"
            f"{_PLAN}",
            {"depth_ratio": depth},
        )
    if covered.share < _LEAST_COVERED_SHARE or covered.radius_share < _LEAST_RADIUS_SHARE:
        yield Doubt(
            "coverage_poor",
            f"poor coverage: {covered.share:.0%} of the image has points, out to {covered.radius_share:.0%} of the way "
            "to its corners; beyond, the lens is extrapolated: bring the board into every corner",
            {"covered_share": covered.share, "covered_radius_share": covered.radius_share},
        )


def same_views(photos: Sequence[BoardPoints], diagonal_px: float) -> list[tuple[str, str, float]]:
    """Find photos that show the board from one place: each counts fully, but together they hold little more than one.

    Returns: A photo, the earlier one it repeats, and the RMS distance of the board's points between both [px].
    """
    found = []
    for later, one in enumerate(photos):
        for other in photos[:later]:
            _, own, others = np.intersect1d(one.index, other.index, return_indices=True)
            if own.size == 0:
                continue
            steps = one.pixels_px[own] - other.pixels_px[others]
            distance = float(np.sqrt((steps**2).sum(axis=1).mean()))
            if distance < _SAME_PLACE_SHARE * diagonal_px:
                found.append((one.photo, other.photo, distance))
                break
    return found


def alike_text(photos: Sequence[BoardPoints]) -> str:
    """Say which photos show the board alike but for place and size, which adds little about a camera; empty for none.

    The board is not turned between them, neither tilted nor rolled: whatever the camera's intrinsics are, such photos
    differ by shift and size alone.
    """
    groups: list[list[BoardPoints]] = []
    for photo in photos:
        group = next((group for group in groups if _alike(group[0], photo)), None)
        if group is None:
            groups.append([photo])
        else:
            group.append(photo)
    largest = max(groups, key=len, default=[])
    if len(largest) < 2:
        return ""
    names = [one.photo for one in largest]
    return (
        f"; {len(names)} of {len(photos)} photos show the board alike, not turned against each other: "
        f"{', '.join(names[:5])}{' ...' if len(names) > 5 else ''}"
    )


def _alike(one: BoardPoints, other: BoardPoints) -> bool:
    _, own, others = np.intersect1d(one.index, other.index, return_indices=True)
    if own.size < 2:
        return False
    from_px, to_px = (px - px.mean(axis=0) for px in (one.pixels_px[own], other.pixels_px[others]))
    size = float((from_px * to_px).sum() / (from_px**2).sum())
    apart = np.sqrt(((size * from_px - to_px) ** 2).sum(axis=1).mean())
    return bool(apart < _ALIKE_SHARE * np.linalg.norm(np.ptp(to_px, axis=0)))


def check_photos(photos: Sequence[BoardPoints], camera: Camera) -> Iterator[Doubt]:
    """Yield which photos are doubtful in themselves.

    camera: For the size of the image.
    """
    same = same_views(photos, float(np.hypot(camera.width_px, camera.height_px)))
    if same:
        listed = ", ".join(f"{one} and {other} ({distance:.1f} px apart)" for one, other, distance in same[:5])
        more = f" and {len(same) - 5} more" if len(same) > 5 else ""
        yield Doubt(
            "photos_repeat",
            f"{len(same)} photos repeat another one: {listed}{more}; the board stands in the same place there, which "
            "adds nothing about the lens: move board or camera between photos",
            {"photos_count": len(same)},
        )
    bright = [one for one in photos if one.saturated_share > _SATURATED_SHARE]
    if bright:
        listed = ", ".join(f"{one.photo} ({one.saturated_share:.0%})" for one in bright[:5])
        yield Doubt(
            "photos_saturated",
            f"{len(bright)} photos are saturated on the board: {listed}; where light spills over, edges are shifted: "
            "expose less",
            {"photos_count": len(bright), "largest_saturated_share": max(one.saturated_share for one in bright)},
        )


def check_predictions(names: Sequence[str], apart_px: FloatArray, expected_px: FloatArray) -> Iterator[Doubt]:
    """Yield photos that all others contradict, and photos on which the calibration rests alone.

    Shapes: apart_px (p,), expected_px (p,).
    apart_px, expected_px: RMS of a photo's residuals when the others predict it, and the same from their covariance:
        the second infinite where the others alone determine no camera, the first where no pose explains the photo.
    """
    far = np.nonzero((apart_px > CONTRADICTS * expected_px) | np.isinf(apart_px))[0]
    if far.size:
        listed = ", ".join(
            f"{names[i]} (no pose explains it)"
            if np.isinf(apart_px[i])
            else f"{names[i]} ({apart_px[i]:.3f} px where {expected_px[i]:.3f} are expected)"
            for i in far[:5]
        )
        yield Doubt(
            "photos_contradict",
            f"{far.size} photos contradict all others: {listed}; the board bent, the lens moved, the photo is "
            "blurred or its file a mirror image: look why, or leave them out",
            {"photos_count": int(far.size), "largest_ratio": float((apart_px / expected_px)[far].max())},
        )
    measured = apart_px[np.isfinite(apart_px)]
    usual = float(np.median(measured)) if measured.size else float("nan")
    unknown = np.isinf(expected_px)
    alone = [i for i in np.nonzero((apart_px > _ALONE * usual) | unknown)[0].tolist() if i not in far]
    if alone:
        listed = ", ".join(
            f"{names[i]} (without it the others determine no camera)"
            if unknown[i]
            else f"{names[i]} ({apart_px[i]:.3f} px, expected {expected_px[i]:.3f})"
            for i in alone[:5]
        )
        others = f", where the others predict each other to {usual:.3f} px" if np.isfinite(usual) else ""
        yield Doubt(
            "photos_stand_alone",
            f"{len(alone)} photos show the camera as no other does: {listed}{others}; what only they see is not "
            "checked by anything: take another photo like each of them",
            {"photos_count": len(alone), "largest_apart_px": float(apart_px[alone].max()), "usual_apart_px": usual},
        )


def check_orientations(network: BoardNetwork, found: Orientations | None) -> Doubt | None:
    """Return a doubt where the print looks the same turned, and what that came to.

    found: How the photos were counted; None where the print cannot be mistaken.
    """
    if found is None:
        return None
    names = [one.photo for one in network.points]
    said = f"{network.board.describe()}: it looks the same turned, so only its own shape shows how photos are turned; "
    if found.open:
        listed = ", ".join(names[i] for i in found.open[:8]) + (" ..." if len(found.open) > 8 else "")
        said += (
            f"it does not in {len(found.open)} of {len(names)} photos ({listed}): there the points may be mixed up, "
            "which is harmless only on a flat and true board; "
        )
    else:
        said += f"it does so surely in all of them ({len(found.turned)} were turned); "
    return Doubt(
        "board_looks_the_same_turned",
        said + "better use one even and one odd number of corners, or an asymmetric grid with odd rows",
        {"open_count": len(found.open), "turned_count": len(found.turned), "photos_count": len(names)},
        Severity.DOUBT if found.open else Severity.NOTE,
    )
