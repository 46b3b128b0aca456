"""Targets followed from photo to photo, and matched without a code.

A photo's pose from listed targets (`provisional_pose`) starts a `Track`, which `follow` moves to the next photo.
`assign_targets` and `assign_near` name dots by the list, without a pose and near one.
"""

from typing import TYPE_CHECKING

from heliogauge.faces import lazy_face

if TYPE_CHECKING:
    from photogrammetry.matching.assignment import assign_near as assign_near
    from photogrammetry.matching.assignment import assign_targets as assign_targets
    from photogrammetry.matching.target_following import KnownTargets as KnownTargets
    from photogrammetry.matching.target_following import Track as Track
    from photogrammetry.matching.target_following import agrees_with_list as agrees_with_list
    from photogrammetry.matching.target_following import follow as follow
    from photogrammetry.matching.target_following import provisional_pose as provisional_pose
    from photogrammetry.matching.target_following import start_following as start_following
    from photogrammetry.matching.uncoded_names import ListedTargets as ListedTargets

__getattr__, __dir__, __all__ = lazy_face(__name__)
