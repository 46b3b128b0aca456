"""Photos whose targets contradict the others: of another object with the same codes, or of one that moved."""

from typing import NamedTuple

import numpy as np

from heliogauge.adjust.binomial_distribution import binomial_tail
from heliogauge.validate import FloatArray, IntArray
from photogrammetry.image_points import ImagePoints
from photogrammetry.start_values.network import LeftOut
from photogrammetry.start_values.resection import spans_an_area

_ASKED = "does it show another object with the same codes, or had this one moved?"


class ContradictingPhotos(NamedTuple):
    """Photos with more false image points than chance explains, or whose others confirm no pose.

    foreign: Those to leave out.
    doubtful: Those of which more image points agree, all over the object, than contradict: they stay.
    """

    foreign: tuple[LeftOut, ...]
    doubtful: tuple[LeftOut, ...]


def contradicting_photos(
    every: ImagePoints, agreeing: ImagePoints, points_m: FloatArray, false_rows: IntArray, significance: float
) -> ContradictingPhotos:
    """Find photos with false image points whose others do not confirm a pose, or that are too many for chance.

    every: All image points of the network.
    agreeing: Those that agree with it.
    points_m (n, 3): The targets of the agreeing ones [m].
    false_rows: Rows of `every` that contradict the network.
    significance: Probability of naming any sound photo of all.

    Foreign are photos whose agreeing targets lie on one line, which determines no pose: those along the rim of another
    trough may have the same distances. Foreign are also photos that more image points contradict than agree, and more
    than chance explains; the share of false ones is that of the other photos that are not left out.
    """
    shown = every.n_targets_in_photo
    false = np.bincount(every.photo_index[false_rows], minlength=len(every.photos))
    places = {
        name: points_m[agreeing.target_index[agreeing.photo_index == k]] for k, name in enumerate(agreeing.photos)
    }
    foreign: dict[int, LeftOut] = {}
    while True:
        found, doubtful = dict(foreign), []
        for photo in np.flatnonzero(false).tolist():
            if photo in foreign:
                continue
            name, hits, trials = every.photos[photo], int(false[photo]), int(shown[photo])
            own = places.get(name, np.zeros((0, 3)))
            own = own[np.isfinite(own).all(axis=1)]
            others = np.delete(np.arange(len(every.photos)), [photo, *foreign])
            # One false image point more than were found: a share of 0 cannot be known.
            chance = (int(false[others].sum()) + 1) / (int(shown[others].sum()) + 2)
            by_chance = binomial_tail(hits, trials, chance) > significance / len(every.photos)
            text = f"{hits} of its {trials} image points contradict the other photos"
            if not spans_an_area(own) or (hits >= len(own) and not by_chance):
                found[photo] = LeftOut(name, f"{text}, and the rest confirms no pose: {_ASKED}")
            elif not by_chance:
                why = "which chance does not explain; it is used, as more of them agree"
                doubtful.append(LeftOut(name, f"{text}, {why}: {_ASKED}"))
        if len(found) == len(foreign):
            return ContradictingPhotos(tuple(foreign[photo] for photo in sorted(foreign)), tuple(doubtful))
        foreign = found
