"""How the photos of a trough are encoded, from a few of them."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from heliogauge.flags import SampleFlag
from heliogauge.images.photos import Image
from heliogauge.validate import FloatArray
from observer.photo_edges.reflection_edges import edge_profiles
from observer.photo_edges.tone import Tone, find_tone, linear_light
from observer.photo_edges.views import Shot, View
from observer.trough.expectation import Expectation
from photogrammetry.centers import NamedEllipses
from photogrammetry.detection import TargetSearch, measure_at
from photogrammetry.matching import KnownTargets
from photogrammetry.pipeline import OnePhoto

#: Photos from which the encoding is estimated, in the inner part of a pass, where the reflection is on the mirror.
_PHOTOS = 3
_INNER = (0.2, 0.8)


def some_of(count: int) -> list[int]:
    """Return numbers of the photos from which the encoding is estimated."""
    return sorted({round(share * (count - 1)) for share in np.linspace(*_INNER, _PHOTOS)})


@dataclass(frozen=True, slots=True, eq=False)
class Sample:
    """A photo from which the encoding is estimated.

    image (height, width): The photo as stored [DN].
    view: Its camera and pose.
    decoded (height, width): The photo taken for sRGB and turned into light [DN].
    """

    image: Image
    view: View
    decoded: Image = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "decoded", linear_light(self.image, Tone.SRGB))


def sizes_of(
    sample: Sample, found: OnePhoto, known: KnownTargets, search: TargetSearch, diameter_m: float | None
) -> tuple[FloatArray, FloatArray]:
    """Return how large targets look over what their stated diameter lets expect, as stored and taken for sRGB.

    known: Listed coordinates.
    Returns: Ratios of listed targets; empty where no diameter is stated.
    """
    camera, pose = sample.view
    place = dict(zip(known.names, known.points_m, strict=True))
    table = found.detections
    # White that is overexposed grows into the black, as in numbers encoded for the eye.
    fit = np.isfinite(found.ellipses_px2).all(axis=(1, 2)) & ((table.flags & np.uint32(SampleFlag.CLIPPED)) == 0)
    rows = [k for k, name in enumerate(table.names) if name in place and fit[k]]
    if diameter_m is None or not rows:
        return np.zeros(0), np.zeros(0)
    starts = NamedEllipses(tuple(table.names[k] for k in rows), table.pixels_px[rows], found.ellipses_px2[rows])
    decoded = measure_at([sample.decoded], [table.photo], [starts], search)[0][0]
    # Targets on the rims look along the optical axis; three points of each give the size at which the lens shows it.
    middle = np.array([place[name] for name in starts.names])
    aside = [middle + 0.5 * diameter_m * np.eye(3)[axis] for axis in range(2)]
    pixels = [camera.project(pose.apply(points)) for points in (middle, *aside)]
    area = np.abs(np.linalg.det(np.stack([pixels[1] - pixels[0], pixels[2] - pixels[0]], axis=2)))
    expected = dict(zip(starts.names, np.sqrt(area), strict=True))
    ratios = [
        np.array([size / expected[name] for name, size in zip(one.names, one.radius_px, strict=True)])
        for one in (table.chosen(np.array(rows)), decoded)
    ]
    return ratios[0], ratios[1]


def usual_tone(files: Sequence[Path]) -> Tone:
    """Return how photos are encoded where nothing in them shows it: JPEG for the eye, as cameras write them."""
    return Tone.SRGB if all(file.suffix.lower() in (".jpg", ".jpeg") for file in files) else Tone.LINEAR


def tone_of(
    samples: Sequence[Sample],
    expected: Expectation,
    sizes: Sequence[tuple[FloatArray, FloatArray]] = (),
    usual: Tone = Tone.LINEAR,
) -> Tone:
    """Return how photos are encoded.

    expected: Collector, absorber and rows.
    Returns: The encoding under which targets are as large as stated and edges of the reflection are even; the usual
        one where too few are seen.
    """
    profiles: list[list[FloatArray]] = [[], []]
    for one in samples:
        for image, found in zip((one.image, one.decoded), profiles, strict=True):
            found.append(edge_profiles(Shot(image, 0, one.view), expected))
    ratios = None
    if sizes:
        ratios = (np.concatenate([one[0] for one in sizes]), np.concatenate([one[1] for one in sizes]))
    return find_tone(np.concatenate(profiles[0]), np.concatenate(profiles[1]), ratios, usual=usual).tone
