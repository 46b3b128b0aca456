"""Thumbnails: small whatever the photo holds, written few, read only where they are harmless."""

import cv2
import numpy as np
import pytest

from heliogauge.images.thumbnails import LONGER_SIDE_PX, MOST_BYTES, make_thumbnail
from heliogauge.results.thumbnails import MOST_THUMBNAILS, read_thumbnails, write_thumbnails


@pytest.mark.parametrize(("dtype", "white"), [(np.uint8, 90), (np.uint16, 900), (np.float32, 4e4)])
def test_dark_photo_of_any_depth_fills_the_grey_values_and_stays_small(dtype, white) -> None:
    rng = np.random.default_rng(0)
    image = rng.uniform(0, white, (900, 1200)).astype(dtype)
    image[:, 600:] = white
    data = make_thumbnail(image)
    assert len(data) <= MOST_BYTES
    seen = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_GRAYSCALE)
    # Noise of the whole range does not fit into the bytes at the first size: the picture gets smaller, not dropped.
    assert seen.shape[1] in (LONGER_SIDE_PX, LONGER_SIDE_PX // 2)
    assert seen[:, -5:].mean() > 240 > seen[:, :5].mean() + 100


def test_no_more_thumbnails_than_a_report_takes_and_none_that_leaves_the_folder(tmp_path) -> None:
    data = make_thumbnail(np.zeros((40, 60), np.uint8))
    names = [f"{k:03}.jpg" for k in range(MOST_THUMBNAILS + 5)]
    write_thumbnails(tmp_path, dict.fromkeys(names, data))
    assert list(read_thumbnails(tmp_path, names)) == names[:MOST_THUMBNAILS]

    (tmp_path / "secret.jpg").write_bytes(data)
    (tmp_path / "photos" / "text.jpg").write_text("no picture")
    (tmp_path / "photos" / "link.jpg").symlink_to(tmp_path / "secret.jpg")
    assert read_thumbnails(tmp_path, ["../secret", "text", "link", "absent", "nul\0"]) == {}
