"""One flight over many modules as a folder, drawn in minutes."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from data_synth.fringes.dataset import SYNTHETIC, TRUTH_ARRAYS_FILE, TRUTH_FILE
from data_synth.troughs.dataset import TroughOptions, trough_to_json, truth_arrays, write_knowledge, write_photo
from data_synth.troughs.field import NeighbourScene, field_of
from data_synth.troughs.wide_field.repeated_pass import RepeatedPass, module_scenes, place_of
from heliogauge.geometry.rigid import RigidTransform
from heliogauge.results.json_file import write_json
from heliogauge.results.whole_folder import WholeFolder
from heliogauge.running.progress import Progress, SilentProgress


def write_wide_field(folder: Path, modules: int, photos: int, progress: Progress | None = None) -> None:
    """Write one flight over many modules as a measurement folder that is whole or not there.

    folder: Where to write; must be absent or empty.
    modules: Their number.
    photos: Photos of each.
    InputError: The folder holds something, cannot be written to, or there are too few codes.

    Mirrors and cameras' paths are alike, so that one pass is traced for all of them; targets, their places and the
    noise of each photo are not. No photo shows two modules.
    """
    progress, options = progress or SilentProgress(), TroughOptions(jpeg_quality=95)
    scenes = module_scenes(modules, photos)
    with WholeFolder(folder, SYNTHETIC) as working:
        with progress.stage("trace one pass"):
            above = RepeatedPass(scenes[0])
        rows, views = [], []
        with progress.stage("draw targets", modules) as stage:
            for number, scene in enumerate(scenes):
                camera, rng, place = above.over(scene), np.random.default_rng([number, 12]), place_of(number)
                for view in scene.views:
                    name = f"photo_{number:03}_{view.name.removeprefix('photo_')}"
                    write_photo(working / f"{name}.jpg", camera.take(view, rng), options.jpeg_quality)
                    pose = view.cam_from_trough @ RigidTransform(np.eye(3), -place)
                    views.append(replace(view, name=name, cam_from_trough=pose))
                rows.append(NeighbourScene(f"module-{number:03}", place, scene))
                stage.advance()
        with progress.stage("write truth"):
            whole = field_of("a wide field", rows, tuple(views))
            write_knowledge(working, whole, ".jpg", options)
            write_json(working / TRUTH_FILE, {**trough_to_json(whole, ".jpg"), "seed": options.seed})
            np.savez_compressed(working / TRUTH_ARRAYS_FILE, allow_pickle=False, **truth_arrays(whole))
