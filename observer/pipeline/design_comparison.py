"""The collector as stated beside what photos and result show: every contradiction becomes a sentence."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from heliogauge.images.photos import read_luma
from heliogauge.results.tables import PointTable
from heliogauge.slopes.map import SlopeMap
from observer.doubts.design_checks import (
    diameter_doubt,
    diameter_of_absorber,
    focal_length_doubt,
    focal_length_of_mirror,
    outline_doubts,
    overexposure_doubt,
)
from observer.photo_edges.outline import clipped_share, photos_from_above, plates_of, rims_in_photo, spans_of
from observer.photo_edges.views import View
from observer.selection.solve_and_refuse import Reflector
from observer.trough.absorber_path import AbsorberPath
from observer.trough.collector import Collector


def design_doubts(
    files: Sequence[Path],
    views: Sequence[View],
    targets: PointTable,
    reflector: Reflector,
    slope_map: SlopeMap,
    absorber: AbsorberPath,
    collector: Collector,
    *,
    with_sizes: bool = True,
) -> tuple[str, ...]:
    """Compare width, length, focal length and tube diameter as stated with what the photos show.

    files, views: The network's photos, of which seven are read.
    targets: Of the network.
    slope_map: The mirror in the common form.
    absorber: The tube's axis.
    with_sizes: Whether focal length and tube are judged; not by a wrong camera or by a few photos, which contradict
        right ones.
    Returns: What does not fit; and whether the mirror is overexposed.
    InputError: A photo cannot be read.
    """
    plates = plates_of(targets.ids, targets.xyz_m)
    eyes = np.array([one.eye_m for one in views])
    rims, clipped = [], []
    for number in photos_from_above(eyes):
        image = read_luma(files[number])
        rims.append(rims_in_photo(image, views[number], collector, plates))
        clipped.append(clipped_share(image, views[number], collector))
    said = [overexposure_doubt(float(np.median(clipped)))]
    if with_sizes:
        said += [
            focal_length_doubt(focal_length_of_mirror(slope_map, collector), absorber, collector),
            diameter_doubt(diameter_of_absorber(reflector, collector), collector),
        ]
    said += outline_doubts(*spans_of(np.array(rims)), collector)
    return tuple(text for text in said if text is not None)
