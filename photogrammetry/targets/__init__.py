"""Coded targets: their description, dictionaries of ring codes, the sheets to print.

A `RingDictionary` holds the codes that may occur; those that come with the program are made by `ring_dictionary`, all
others are read by `load_dictionary`.
"""

from typing import TYPE_CHECKING

from heliogauge.faces import lazy_face

if TYPE_CHECKING:
    from photogrammetry.targets.coded_targets import RingDictionary as RingDictionary
    from photogrammetry.targets.coded_targets import ring_dictionary as ring_dictionary
    from photogrammetry.targets.mirrored_codes import refuse_mirrored_codes as refuse_mirrored_codes
    from photogrammetry.targets.ring_codes import Polarity as Polarity
    from photogrammetry.targets.ring_codes import RingCode as RingCode
    from photogrammetry.targets.ring_codes import RingRadii as RingRadii
    from photogrammetry.targets.store_ring_codes import load_dictionary as load_dictionary

__getattr__, __dir__, __all__ = lazy_face(__name__)
