"""How the photos of a trough are encoded: by the odds from as many of them as it takes."""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from heliogauge.doubts import Doubt
from heliogauge.flags import SampleFlag
from heliogauge.images.photos import Image, read_luma
from heliogauge.validate import FloatArray
from observer.photo_edges.outward_edges import moved_outward, outward_between
from observer.photo_edges.reflection_edges import ReflectionEdges, edge_profiles, joined, reflection_edges
from observer.photo_edges.tone import Tone, ToneEvidence, linear_light, log_odds_of_linear, tone_evidence
from observer.photo_edges.views import Shot, View
from observer.trough.expectation import Expectation
from photogrammetry.centers import NamedEllipses
from photogrammetry.detection import TargetSearch, measure_at
from photogrammetry.matching import KnownTargets
from photogrammetry.pipeline import OnePhoto

#: Photos that are looked at first, in the inner part of a pass, where the reflection is on the mirror.
_PHOTOS = 3
_INNER = (0.2, 0.8)
#: Odds at which no further photo is looked at.
_CERTAIN = math.log(100.0)
#: Odds that twice as many photos change by less than this factor are not made clearer by further ones: what is left is
#: common to all photos of a flight (`observer.photo_edges.tone.log_odds_of_linear`).
_SETTLED = math.log(2.0)
#: Odds below which the encoding is doubtful, and from which a single photo contradicts the others.
_CLEAR = math.log(20.0)
#: Photos that are read in both encodings where it is not clear which is right, and edges that tell how far these are
#: apart: the median of a hundred is known to a tenth of their scatter.
_BOTH, _ENOUGH_EDGES = 9, 100
#: Odds that a JPEG file is encoded for the eye: cameras write no others, programs may.
_JPEG_ODDS = math.log(100.0)


def some_of(count: int) -> list[int]:
    """Return numbers of the photos that are looked at first."""
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
) -> FloatArray:
    """Return how large targets look over what their stated diameter lets expect, as stored and taken for sRGB.

    known: Listed coordinates.
    Returns (2, n): Ratios of listed targets; none where no diameter is stated.
    """
    place = dict(zip(known.names, known.points_m, strict=True))
    table = found.detections
    # White that is overexposed grows into the black, as in numbers encoded for the eye.
    round_ones = np.isfinite(found.ellipses_px2).all(axis=(1, 2)) & np.array(
        [name in place for name in table.names], bool
    )
    clipped = (table.flags & np.uint32(SampleFlag.CLIPPED)) != 0
    rows = np.flatnonzero(round_ones & ~clipped)
    # Where most are overexposed the others nearly are.
    if diameter_m is None or 2 * rows.size <= np.count_nonzero(round_ones):
        return np.zeros((2, 0))
    starts = NamedEllipses(tuple(table.names[k] for k in rows), table.pixels_px[rows], found.ellipses_px2[rows])
    decoded = measure_at([sample.decoded], [table.photo], [starts], search)[0][0]
    # Targets on the rims look along the optical axis; three points of each give the size at which the lens shows it.
    middle = np.array([place[name] for name in starts.names])
    aside = [middle + 0.5 * diameter_m * np.eye(3)[axis] for axis in range(2)]
    pixels = [sample.view.project(points) for points in (middle, *aside)]
    area = np.abs(np.linalg.det(np.stack([pixels[1] - pixels[0], pixels[2] - pixels[0]], axis=2)))
    expected = dict(zip(starts.names, np.sqrt(area), strict=True))
    # A target that can be measured in one of both only says nothing.
    as_stored = dict(zip(starts.names, table.radius_px[rows], strict=True))
    both = [
        (as_stored[name], size, expected[name]) for name, size in zip(decoded.names, decoded.radius_px, strict=True)
    ]
    stored, light, right = np.array(both).reshape(-1, 3).T
    return np.asarray(np.stack([stored, light]) / right)


def look_at_tone(sample: Sample, expected: Expectation, sizes: FloatArray) -> ToneEvidence:
    """Return what a photo says of its encoding.

    expected: Collector, absorber and rows.
    sizes (2, n): Of `sizes_of`.
    """
    stored, decoded = (edge_profiles(Shot(image, 0, sample.view), expected) for image in (sample.image, sample.decoded))
    return tone_evidence(stored, decoded, sizes)


@dataclass(frozen=True, slots=True)
class Encoding:
    """How files of one kind are encoded.

    kind: How their names end; empty for all.
    tone: The likelier encoding.
    log_odds: Logarithm of the odds for it; infinite where it was stated.
    photos, targets, edges: Numbers of what that rests on.
    own: Photos that contradict the others, and their encoding.
    """

    kind: str
    tone: Tone
    log_odds: float = math.inf
    photos: int = 0
    targets: int = 0
    edges: int = 0
    own: Mapping[str, Tone] = field(default_factory=dict)

    @property
    def is_open(self) -> bool:
        """Whether it is not clear; photos of two encodings contradict each other in their common odds."""
        return self.log_odds < _CLEAR and not self.own

    @property
    def other_probability(self) -> float:
        """Probability of the other encoding."""
        return 1 / (1 + math.exp(self.log_odds)) if math.isfinite(self.log_odds) else 0.0

    def text(self) -> str:
        """Return a sentence."""
        files = f"{self.kind} files" if self.kind else "photos"
        if math.isinf(self.log_odds):
            return f"{files} are {self.tone.value}, as stated"
        odds = f"{math.exp(min(self.log_odds, math.log(1e6))):.3g} : 1"
        seen = f"{self.targets} sizes of targets and {self.edges} edges of the reflection in {self.photos} photos"
        return f"{files} are {self.tone.value} ({odds}, from {seen if self.photos else 'the kind of file alone'})"


@dataclass(frozen=True, slots=True)
class Encodings:
    """How the photos of a measurement are encoded.

    kinds: Of each kind of file.
    outward_rad: How far the edges of the reflection may lie outward beside their mean of both encodings where that is
        not clear, 1 sigma; 0 where it is, or where nothing tells it [rad].
    """

    kinds: tuple[Encoding, ...]
    outward_rad: float = 0.0

    def of(self, name: str) -> Encoding | None:
        """Return how files like one are encoded."""
        return next((one for one in self.kinds if name.lower().endswith(one.kind)), None)

    def tone_of(self, name: str) -> Tone:
        """Return the encoding of a photo by its name."""
        one = self.of(name)
        return Tone.LINEAR if one is None else one.own.get(name, one.tone)

    def other_probability(self, name: str) -> float:
        """Return the probability that a photo has the other encoding; 0 where it is clear."""
        one = self.of(name)
        return one.other_probability if one is not None and one.is_open else 0.0

    def text(self) -> str:
        """Return it in words."""
        return "; ".join(one.text() for one in self.kinds)

    @property
    def doubts(self) -> tuple[Doubt, ...]:
        """What is not clear of it."""
        found = [_unclear(one, self.outward_rad) for one in self.kinds if one.is_open]
        return (*found, *(_differing(one) for one in self.kinds if one.own))


def _unclear(one: Encoding, outward_rad: float) -> Doubt:
    held = "slopes are twice as wrong"
    if outward_rad > 0:
        held = (
            "its edges lie elsewhere: they were put between both by their odds, and what that leaves open, "
            f"{1e6 * outward_rad:.2g} urad of each edge, is part of the sigmas"
        )
    return Doubt(
        "encoding_unclear",
        f"{one.text()}: that is not certain. With the wrong encoding the tube looks 1.4 % thicker or thinner and "
        f'{held}; state [images] encoding = "linear" or "srgb", or the targets\' diameter_mm',
        {"encoding_odds_factor": math.exp(one.log_odds), "edges_outward_rad": outward_rad},
    )


def between_encodings(
    edges: ReflectionEdges,
    files: Sequence[Path],
    views: Sequence[View],
    encodings: Encodings,
    expected: Expectation,
) -> tuple[ReflectionEdges, Encodings]:
    """Put edges between where both encodings have them, by the odds, where it is not clear which is right.

    edges: As found with the likelier encoding, in the poses of the views.
    files, views: All photos.
    Returns: Edges; and the encodings with what that leaves open.
    InputError: A photo cannot be read.

    The encoding is one unknown of two values. Their mean and variance stand for it: in the adjustment it is the
    displacement that all edges have outward in common, which the reflection itself tells in part.
    """
    probability = np.array([encodings.other_probability(file.name) for file in files])
    unclear = np.flatnonzero(probability > 0)
    if unclear.size == 0:
        return edges, encodings
    others = []
    for number in unclear[
        np.unique(np.linspace(0, unclear.size - 1, min(unclear.size, _BOTH)).round().astype(np.intp))
    ]:
        tone = Tone.LINEAR if encodings.tone_of(files[number].name) is Tone.SRGB else Tone.SRGB
        shot = Shot(linear_light(read_luma(files[number]), tone), int(number), views[number])
        others += reflection_edges([shot], expected)
    eyes, focal = np.array([one.eye_m for one in views]), expected.collector.focal_length_m
    apart = outward_between(edges, joined(others), eyes, focal)
    if apart.size < _ENOUGH_EDGES:
        return edges, encodings
    by_rad = float(np.median(apart))
    left = abs(by_rad) * float(np.sqrt(probability * (1 - probability)).max())
    return moved_outward(edges, by_rad * probability, eyes, focal), replace(encodings, outward_rad=left)


def _differing(one: Encoding) -> Doubt:
    names = sorted(one.own)
    more = f" and {len(names) - 5} more" if len(names) > 5 else ""
    return Doubt(
        "encodings_differ",
        f"{one.text()}, but {', '.join(names[:5])}{more} {'is' if len(names) == 1 else 'are'} not: each photo is taken "
        "as it looks itself. Were files of several programs put together?",
        {"photos_count": float(len(names))},
    )


def find_encodings(files: Sequence[Path], evidence_of: Callable[[Path], ToneEvidence | None]) -> Encodings:
    """Find how photos are encoded, each kind of file by itself.

    files: All photos, in the order in which they were taken.
    evidence_of: Looks at a photo; None where its pose is not known.
    Returns: Of each kind the likelier encoding; of photos that contradict the others clearly, their own.
    """
    kinds: dict[str, list[Path]] = {}
    for file in files:
        kinds.setdefault(file.suffix.lower(), []).append(file)
    return Encodings(tuple(_encoding(kind, own, evidence_of) for kind, own in kinds.items()))


def _encoding(kind: str, files: Sequence[Path], evidence_of: Callable[[Path], ToneEvidence | None]) -> Encoding:
    prior = -_JPEG_ODDS if kind in (".jpg", ".jpeg") else 0.0
    seen: dict[str, ToneEvidence] = {}
    before: float | None = None
    alone: dict[str, float] = {}
    odds, telling, check_at = prior, 0, _PHOTOS
    for count, file in enumerate(_in_turn(files), start=1):
        one = evidence_of(file)
        if one is not None:
            seen[file.name], alone[file.name] = one, log_odds_of_linear([one])
            odds = prior + log_odds_of_linear(list(seen.values()))
        agree = min(alone.values(), default=0.0) > -_CLEAR or max(alone.values(), default=0.0) < _CLEAR
        if count >= _PHOTOS and agree and abs(odds) > _CERTAIN:
            break
        telling += one is not None and one.tells_something
        if telling >= check_at:
            if before is not None and agree and abs(odds - before) < _SETTLED:
                break
            before, check_at = odds, 2 * telling
    tone = Tone.SRGB if odds < 0 else Tone.LINEAR
    differing = {
        name: Tone.LINEAR if own > 0 else Tone.SRGB
        for name, own in alone.items()
        if abs(own) > _CLEAR and (own > 0) is not (tone is Tone.LINEAR)
    }
    used = [one for one in seen.values() if one.tells_something]
    targets, edges = sum(one.sizes.shape[1] for one in used), sum(one.edges for one in used)
    return Encoding(kind, tone, abs(odds), len(used), targets, edges, differing)


def _in_turn(files: Sequence[Path]) -> Iterator[Path]:
    """Return photos in the order in which they are looked at: each further one far from those before."""
    first = some_of(len(files))
    # The golden section never comes back to a place.
    later = sorted(set(range(len(files))).difference(first), key=lambda k: k * 0.5 * (math.sqrt(5) - 1) % 1.0)
    return (files[k] for k in (*first, *later))
