"""How the photos of a trough are encoded, from a few of them."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from heliogauge.images import read_luma
from heliogauge.validate import FloatArray
from observer.carried import View
from observer.reflection import Expectation, edge_profiles
from observer.tone import Tone, find_tone, linear_light

#: Photos that tell how all are encoded, in the inner part of a pass, where the reflection is on the mirror.
_PHOTOS = 3
_INNER = (0.2, 0.8)


def some_of(count: int) -> list[int]:
    """Return numbers of the photos that tell.

    Parameters
    ----------
    count : int
        Number of photos.

    Returns
    -------
    list of int
        Ascending.
    """
    return sorted({round(share * (count - 1)) for share in np.linspace(*_INNER, _PHOTOS)})


def tone_of(photos: Sequence[tuple[Path, View]], expected: Expectation) -> Tone:
    """Return how photos are encoded.

    Parameters
    ----------
    photos : sequence of (Path, (Camera, RigidTransform))
        Some of them, with camera and pose.
    expected : Expectation
        Collector, absorber and rows.

    Returns
    -------
    Tone
        The encoding under which edges of the reflection are even; linear where too few are seen.

    Raises
    ------
    InputError
        A photo cannot be read.
    """
    profiles: list[list[FloatArray]] = [[], []]
    for file, view in photos:
        image = read_luma(file)
        for tone, found in zip((Tone.LINEAR, Tone.SRGB), profiles, strict=True):
            found.append(edge_profiles(linear_light(image, tone), view, expected))
    return find_tone(*(np.concatenate(found) for found in profiles)).tone
