"""Targets whose print, or photo, is mirrored read as other codes of the same dictionary."""

import numpy as np
import pytest

from heliogauge.errors import InputError
from photogrammetry.targets.coded_targets import RingDictionary, ring_dictionary
from photogrammetry.targets.mirrored_codes import refuse_mirrored_codes

DICTIONARY = ring_dictionary("aicon-12")
LISTED = [str(name) for name in range(1, 13)]


def mirrored(names: list[str], dictionary: RingDictionary = DICTIONARY) -> list[str]:
    read = [dictionary.read(dictionary.code(name).sectors[::-1]).code for name in names]
    return [one.name for one in read if one is not None]


def test_a_mirrored_print_is_said() -> None:
    with pytest.raises(InputError, match="of 12 codes read 9 are in the list, of their mirror images 12 are"):
        refuse_mirrored_codes(mirrored(LISTED), LISTED, DICTIONARY)


@pytest.mark.parametrize("read", [LISTED, LISTED[:5], [], [*LISTED, "40", "41", "no code"], ["77", "90"]])
def test_codes_as_they_stand_are_no_mirror_images(read: list[str]) -> None:
    refuse_mirrored_codes(read, LISTED, DICTIONARY)


@pytest.mark.parametrize("seed", range(20))
def test_any_list_that_is_seen_is_believed(seed: int) -> None:
    rng = np.random.default_rng(seed)
    names = [str(name) for name in rng.choice(np.arange(1, 100), size=14, replace=False)]
    refuse_mirrored_codes(names, names[:10], DICTIONARY)
