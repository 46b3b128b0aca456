"""Targets followed from photo to photo, and matched without a code.

A photo's pose from listed targets (`provisional_pose`) starts a `Track`, which `follow` moves to the next photo.
"""

from typing import TYPE_CHECKING

from heliogauge.faces import lazy_face

if TYPE_CHECKING:
    from photogrammetry.matching.target_following import KnownTargets as KnownTargets
    from photogrammetry.matching.target_following import Track as Track
    from photogrammetry.matching.target_following import agrees_with_list as agrees_with_list
    from photogrammetry.matching.target_following import follow as follow
    from photogrammetry.matching.target_following import provisional_pose as provisional_pose
    from photogrammetry.matching.target_following import start_following as start_following

__getattr__, __dir__, __all__ = lazy_face(__name__)
