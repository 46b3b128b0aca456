"""Codes read in photos against the list of targets: whether prints or photos are mirrored."""

from collections.abc import Collection

from heliogauge.errors import InputError
from photogrammetry.targets.coded_targets import RingDictionary

#: So many more listed targets must be read from the mirror images than from the codes as they stand. The vendors'
#: dictionaries hold the mirror image of nearly every code, and a list of neighbouring numbers that of most of its own.
_LEAST_MORE = 2


def refuse_mirrored_codes(read: Collection[str], listed: Collection[str], dictionary: RingDictionary) -> None:
    """Refuse photos whose codes are the mirror images of those listed.

    read: Names of the codes that were read.
    listed: Names of the targets in the list.
    InputError: The mirror images of the codes read are those of the list, the codes themselves are not.

    >>> from photogrammetry.targets.coded_targets import aicon_dictionary
    >>> refuse_mirrored_codes({"1", "13", "11", "16"}, {"1", "2", "3", "8"}, aicon_dictionary(12))
    Traceback (most recent call last):
        ...
    heliogauge.errors.InputError: targets: of 4 codes read 1 is in the list, of their mirror images 4 are; prints or
    photos are mirrored, or the dictionary counts the bits in the other sense ([targets] sense)
    """
    codes = set(read) & set(dictionary.names)
    turned = set()
    for name in codes:
        # Backwards, a target reads as it does in a mirror.
        mirrored = dictionary.read(dictionary.code(name).sectors[::-1]).code
        if mirrored is not None:
            turned.add(mirrored.name)
    straight, mirror = len(codes & set(listed)), len(turned & set(listed))
    if mirror >= straight + _LEAST_MORE:
        raise InputError(
            f"targets: of {len(codes)} codes read {straight} {'is' if straight == 1 else 'are'} in the list, of "
            f"their mirror images {mirror} are; prints or photos are mirrored, or the dictionary counts the bits in "
            "the other sense ([targets] sense)"
        )
