"""Targets in a rendered 24-megapixel photo: processor time against decoding the JPEG, found, missed, false."""

import time

import cv2
import numpy as np
from _measure import row, title

from data_synth.targets import image_truth, render_photo, target_scene
from photogrammetry.detection import SearchLimits, TargetSearch, find_candidates, measure_targets
from photogrammetry.targets import Polarity, ring_dictionary


def cpu_s(work, repeats=3):
    """Least processor time of a few runs, and the last result [s]."""
    best, result = np.inf, None
    for _ in range(repeats):
        start = time.process_time()
        result = work()
        best = min(best, time.process_time() - start)
    return best, result


def photo(preset: str, seed: int) -> None:
    scene = target_scene(preset, seed)
    view = scene.views[0]
    image = render_photo(scene, view, np.random.default_rng(seed))
    if image.dtype != np.uint8:
        image = (image // 257).astype(np.uint8)
    truth = image_truth(scene, view)
    dictionary = ring_dictionary(scene.dictionary or "aicon-12")
    colour = cv2.merge([image] * 3)
    _, jpeg = cv2.imencode(".jpg", colour, [cv2.IMWRITE_JPEG_QUALITY, 95])
    decode, _ = cpu_s(lambda: cv2.imdecode(jpeg, cv2.IMREAD_UNCHANGED))
    for words, polarities in (
        ("dark targets only", (Polarity.BLACK_ON_WHITE,)),
        ("dark and light ones", (Polarity.BLACK_ON_WHITE, Polarity.WHITE_ON_BLACK)),
    ):
        limits = SearchLimits(polarities=polarities)
        search, _ = cpu_s(lambda limits=limits: find_candidates(image, limits))
        whole, found = cpu_s(lambda limits=limits: measure_targets(image, "a", TargetSearch(dictionary, limits)))
        places = dict(zip(truth.names, truth.pixels_px, strict=True))
        names = [name for name in found.detections.names if not name.startswith("u")]
        right = [
            name
            for name, pixel in zip(found.detections.names, found.detections.pixels_px, strict=True)
            if name in places and np.hypot(*(pixel - places[name])) < 1
        ]
        coded = [name for name in truth.names if name.isdecimal()]
        title(f"{scene.name}: {image.shape[1]} x {image.shape[0]} px, {words}", ("measured", "asked", ""))
        row("decode the JPEG, in colour [s]", f"{decode:.3f}", "", "")
        row("find candidates [s]", f"{search:.3f}", "", "")
        row("find, read, centre [s]", f"{whole:.3f}", f"{2 * decode:.3f}", "")
        row("codes read of those in the photo", f"{len(right)} of {len(coded)}", "all", "")
        row("false codes", f"{len(names) - len(right)}", "0", "")


if __name__ == "__main__":
    cv2.setNumThreads(1)
    photo("single", 0)
    photo("busy", 0)
