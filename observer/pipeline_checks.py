"""Photos and results against what measurement.toml says of the collector: every contradiction becomes a sentence."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from heliogauge.images import read_luma
from heliogauge.slope_map import SlopeMap
from observer.absorber_path import AbsorberPath
from observer.carried import View
from observer.design import Collector
from observer.design_checks import (
    diameter_doubt,
    diameter_of_absorber,
    focal_length_doubt,
    focal_length_of_mirror,
    outline_doubts,
    overexposure_doubt,
)
from observer.outline import clipped_share, photos_from_above, rims_in_photo, spans_of
from observer.reflector import Reflector


def design_doubts(
    photos: tuple[Sequence[Path], Sequence[View]],
    reflector: Reflector,
    slope_map: SlopeMap,
    absorber: AbsorberPath,
    collector: Collector,
) -> tuple[str, ...]:
    """Compare width, length, focal length and tube diameter as stated with what the photos show.

    Parameters
    ----------
    photos : (sequence of Path, sequence of (Camera, RigidTransform))
        Files and views of the network's photos; seven of them are read.
    reflector : Reflector
        The mirror.
    slope_map : SlopeMap
        The mirror in the common form.
    absorber : AbsorberPath
        The tube's axis.
    collector : Collector
        The design.

    Returns
    -------
    tuple of str
        What does not fit; and whether the mirror is overexposed.

    Raises
    ------
    InputError
        A photo cannot be read.
    """
    files, views = photos
    eyes = np.array([pose.inverse().translation_m for _, pose in views])
    rims, clipped = [], []
    for number in photos_from_above(eyes):
        image = read_luma(files[number])
        rims.append(rims_in_photo(image, views[number], collector))
        clipped.append(clipped_share(image, views[number], collector))
    said = (
        overexposure_doubt(float(np.median(clipped))),
        focal_length_doubt(focal_length_of_mirror(slope_map, collector), absorber, collector),
        diameter_doubt(diameter_of_absorber(reflector, collector), collector),
        *outline_doubts(*spans_of(np.array(rims)), collector),
    )
    return tuple(text for text in said if text is not None)
