"""Measurement folders for each instrument from a preset and a seed alone: what ``heliogauge.synth`` asks for."""

from pathlib import Path

from data_synth.acceptance import write_tests_folder
from data_synth.fringes import DatasetOptions, preset_scene, write_dataset
from data_synth.fringes.tower import SIGMA_PLACE_MM, tower_knowledge, tower_scene
from data_synth.heliostats import (
    BenchOptions,
    HeliostatChoice,
    HeliostatOptions,
    heliostat_scene,
    write_beam_dataset,
    write_heliostat_dataset,
)
from data_synth.lasers import write_laser_scan, write_line_sweep, write_surface_scan
from data_synth.reflections import write_overlay
from data_synth.screens import ScreenChoice, write_screen_dataset
from data_synth.sky import gazing_preset, write_gazing
from data_synth.stars import write_stars
from data_synth.targets import (
    PhotoOptions,
    board_scene,
    board_table,
    camera_content,
    target_scene,
    write_target_dataset,
)
from data_synth.targets.dataset import photogrammetry_content
from data_synth.troughs import TroughChoice, TroughOptions, trough_scene, write_trough_dataset
from heliogauge.running.progress import Progress, SilentProgress


def deflectometry(
    folder: Path, *, preset: str = "small", seed: int = 0, force: bool = False, progress: Progress | None = None
) -> None:
    """Draw fringe images of a screen seen in a mirror, or scan one or its surface with a laser."""
    if preset == "laser-scan":
        write_laser_scan(folder, seed=seed, force=force)
        return
    if preset == "line-sweep":
        write_line_sweep(folder, seed=seed, force=force)
        return
    if preset == "stars":
        write_stars(folder, seed=seed, force=force)
        return
    if preset == "overlay":
        write_overlay(folder, seed=seed, force=force)
        return
    if preset in ("gazing", "gazing-close"):
        write_gazing(folder, gazing_preset(preset, seed), seed, force=force)
        return
    if preset == "tower":
        write_dataset(
            folder,
            tower_scene(),
            DatasetOptions(seed, tower_knowledge(sigma_place_mm=SIGMA_PLACE_MM), force=force),
            progress,
        )
        return
    if preset in ("screen-dots", "screen-rims"):
        choice = ScreenChoice("dots" if preset == "screen-dots" else "rims", seed)
        write_screen_dataset(folder, choice, force=force, progress=progress)
        return
    if preset == "surface-scan":
        write_surface_scan(folder, seed=seed, force=force)
        return
    write_dataset(folder, preset_scene(preset), DatasetOptions(seed, force=force), progress)


def photogrammetry(
    folder: Path, *, preset: str = "small", seed: int = 0, force: bool = False, progress: Progress | None = None
) -> None:
    """Photograph coded targets and dots on a panel."""
    scene = target_scene(preset, seed)
    write_target_dataset(folder, scene, photogrammetry_content(scene), PhotoOptions(seed, force=force), progress)


def camera(
    folder: Path, *, preset: str = "chessboard", seed: int = 0, force: bool = False, progress: Progress | None = None
) -> None:
    """Photograph a calibration board."""
    scene = board_scene(preset, seed)
    content = camera_content(scene, board_table(preset))
    write_target_dataset(folder, scene, content, PhotoOptions(seed, force=force), progress)


def observer(
    folder: Path, *, preset: str = "small", seed: int = 0, force: bool = False, progress: Progress | None = None
) -> None:
    """Photograph a parabolic trough as a drone does."""
    write_trough_dataset(folder, trough_scene(preset, TroughChoice(seed)), TroughOptions(seed, force=force), progress)


def beam(
    folder: Path, *, preset: str = "small", seed: int = 0, force: bool = False, progress: Progress | None = None
) -> None:
    """Photograph the beam of a heliostat at several suns; a preset is small, facets (25 of them), or a fault."""
    facets = (5, 5) if preset == "facets" else (2, 2)
    faults = () if preset in ("small", "facets") else (preset,)
    with (progress or SilentProgress()).stage("photograph beams"):
        write_beam_dataset(folder, BenchOptions(facets, faults=faults, seed=seed, force=force))


def heliostat(
    folder: Path, *, preset: str = "small", seed: int = 0, force: bool = False, progress: Progress | None = None
) -> None:
    """Let heliostats throw the sun on a tower's targets."""
    if preset == "tests":
        write_tests_folder(folder, seed=seed, force=force)
        return
    scene = heliostat_scene(preset, HeliostatChoice(seed))
    write_heliostat_dataset(folder, scene, HeliostatOptions(seed, force), progress)
