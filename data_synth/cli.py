"""``heliogauge INSTRUMENT synth``: measurement folders with known truth, for tests, demonstrations and test planning.

Each function is the ``synth`` of the instrument whose name it has.
"""

import math
from collections.abc import Collection
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Literal

import typer

from heliogauge.errors import InputError
from heliogauge.running.commands import NewFolder, Quiet, Verbose, parse_periods

FringePreset = Literal[
    "small",
    "full",
    "large",
    "off-axis",
    "off-axis-20",
    "trough-panel",
    "sphere",
    "plane",
    "curved-screen",
    "ensemble",
    "tower",
    "laser-scan",
    "line-sweep",
    "gazing",
    "gazing-close",
    "stars",
    "overlay",
    "screen-dots",
    "screen-rims",
    "surface-scan",
]
TargetPreset = Literal["small", "panel", "single", "retro", "busy", "markers", "natural"]
BoardPreset = Literal["chessboard", "charuco", "circles", "circles-asymmetric", "targets"]
TroughPreset = Literal[
    "small",
    "flight",
    "ls2",
    "ls2-long",
    "ls2-two-passes",
    "displaced",
    "sag",
    "clouds",
    "ground",
    "mast",
    "turning",
    "far",
    "fixture",
    "absorber",
    "panel",
]
HeliostatPreset = Literal[
    "small", "field", "juelich", "faulty", "stellenbosch", "drone", "images", "images-lens", "tests"
]

Replace = Annotated[bool, typer.Option("--force", help="Replace an earlier synthetic measurement.")]
Scale = Annotated[float, typer.Option(min=0.05, max=4.0, help="Pixels per pixel of the preset's camera.")]
NoiseDn = Annotated[float | None, typer.Option(min=0.0, help="Noise of each pixel; default: from the preset.")]
BlurPx = Annotated[float | None, typer.Option(min=0.0, help="Gaussian blur of the lens; default: from the preset.")]
JpegQuality = Annotated[int | None, typer.Option(min=1, max=100, help="Write JPEG of this quality instead of PNG.")]


#: Options that every preset has a use for.
_ALWAYS = ("folder", "preset", "seed", "force", "quiet", "verbose")
#: What presets of fringes that are drawn by themselves take besides: nothing.
_DRAWN_ALONE = (
    *("tower", "laser-scan", "line-sweep", "gazing", "gazing-close", "stars", "overlay"),
    *("screen-dots", "screen-rims", "surface-scan"),
)
# Of one photo of dots, and of fringes; what belongs to several photos or poses says so itself.
_OF_DOTS = ("noise_dn", "shot_gain_dn", "bits", "blur_px", "dots", "frames", "pose_known", "gamma", "fault", "poses")
_NOT_OF_TARGETS = {
    "retro": ("light_on_dark",),
    "markers": ("dictionary", "light_on_dark", "mirrored", "ring_radii", "hole", "cross"),
}
_OF_PHOTOS = (
    *("noise_dn", "blur_px", "defocus_px_m", "sharpening", "moire_pitch_px"),
    *("bits", "jpeg_quality", "colour"),
)
_NOT_OF_TROUGHS = {
    "displaced": ("shaped",),
    "far": ("dictionary",),
    "fixture": ("photos",),
    "absorber": ("photos",),
}
_NOT_OF_HELIOSTATS = {
    "drone": ("spot_sigma_mm", "wind_mrad", "outliers"),
    "images": ("spot_sigma_mm", "outliers"),
    "images-lens": ("spot_sigma_mm", "outliers"),
    "tests": ("heliostats", "observations", "spot_sigma_mm", "wind_mrad", "outliers", "fault"),
}


def refuse_idle(context: typer.Context, what: str, idle: Collection[str]) -> None:
    """Refuse an option that was given although what is drawn does not depend on it.

    what: What is drawn.
    idle: Options that have no effect on it.
    InputError: Names the first such option.
    """
    for name in context.params:
        source = context.get_parameter_source(name)
        if name in idle and source is not None and source.name == "COMMANDLINE":
            raise InputError(f"{what} has no use for --{name.replace('_', '-')}; leave it out")


def deflectometry(
    context: typer.Context,
    folder: NewFolder,
    preset: Annotated[FringePreset, typer.Option(help="Scene.")] = "small",
    seed: Annotated[int, typer.Option(min=0, help="Seed of all noise; the same seed gives the same files.")] = 0,
    noise_dn: Annotated[float, typer.Option(min=0.0, help="Noise of each pixel, whatever its signal.")] = 1.0,
    shot_gain_dn: Annotated[float, typer.Option(min=0.0, help="DN per electron; 0: no shot noise.")] = 0.0,
    bits: Annotated[int, typer.Option(min=8, max=16, help="Bit depth of the images.")] = 8,
    gamma: Annotated[float, typer.Option(min=0.1, help="Exponent of the display; written to response.csv.")] = 1.0,
    blur_px: BlurPx = None,
    periods: Annotated[
        str, typer.Option(help="Periods over the screen, both directions, with commas.")
    ] = "0.9,3.9,15.9,63.9",
    steps: Annotated[int, typer.Option(min=3, help="Frames of each period, 360 deg / steps apart.")] = 4,
    fault: Annotated[
        list[str] | None,
        typer.Option(
            help="Spoil it: repeated:N, stale:N, swapped:N, corrupt:N (frame N), wrong-step, saturated:FACTOR, "
            "gamma:EXPONENT, drift:SHARE. May be given several times."
        ),
    ] = None,
    dots: Annotated[
        Literal["light", "marked", "unmarked"] | None,
        typer.Option(
            help="One photo of a field of dots instead of fringes: with a light at dot (0, 0), marked by dots of two "
            "sizes, or all alike."
        ),
    ] = None,
    frames: Annotated[
        int, typer.Option(min=1, help="With --dots: so many photos of a mirror that sways in wind, 10 in a second.")
    ] = 1,
    pose_known: Annotated[bool, typer.Option("--pose-known", help="State the mirror's pose exactly.")] = False,
    poses: Annotated[
        int,
        typer.Option(
            min=1, max=8, help="Several poses of the mirror before camera and screen that are not exactly known."
        ),
    ] = 1,
    width_error_percent: Annotated[
        float, typer.Option(help="With several poses: the screen's stated width is off by so much, whatever its sigma.")
    ] = 0.0,
    force: Replace = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> None:
    """Draw fringe images of a screen seen in a mirror with known slope errors, or scan it with a laser."""
    from data_synth.fringes.dataset import DatasetOptions, PoseOptions, write_dataset, write_poses
    from data_synth.fringes.faults import Fault
    from data_synth.fringes.knowledge import Knowledge
    from data_synth.fringes.presets import preset_scene
    from deflectometry.setup import make_pattern
    from heliogauge.running.terminal import terminal_progress

    if preset in _DRAWN_ALONE:
        refuse_idle(context, f"preset {preset!r}", set(context.params).difference(_ALWAYS))
    if dots is not None:
        refuse_idle(context, "a photo of dots", set(context.params).difference(_ALWAYS, _OF_DOTS))
    if preset in ("laser-scan", "line-sweep", "surface-scan"):
        from data_synth.preset_folders import deflectometry as write_preset

        write_preset(folder, preset=preset, seed=seed, force=force)
        if not quiet:
            print(folder)
        return
    if preset == "stars":
        from data_synth.stars import write_stars

        write_stars(folder, seed=seed, force=force)
        if not quiet:
            print(folder)
        return
    if preset == "overlay":
        from data_synth.reflections import write_overlay

        write_overlay(folder, seed=seed, force=force)
        if not quiet:
            print(folder)
        return
    if preset in ("gazing", "gazing-close"):
        from data_synth.sky import gazing_preset, write_gazing

        write_gazing(folder, gazing_preset(preset, seed), seed, force=force)
        if not quiet:
            print(folder)
        return
    if preset == "tower":
        from data_synth.fringes.tower import SIGMA_PLACE_MM, tower_knowledge, tower_scene

        write_dataset(
            folder, tower_scene(), DatasetOptions(seed, tower_knowledge(sigma_place_mm=SIGMA_PLACE_MM), force=force)
        )
        if not quiet:
            print(folder)
        return
    if preset in ("screen-dots", "screen-rims"):
        from data_synth.screens import ScreenChoice, write_screen_dataset

        write_screen_dataset(folder, ScreenChoice("dots" if preset == "screen-dots" else "rims", seed), force=force)
        if not quiet:
            print(folder)
        return
    knowledge = Knowledge(pose_known=pose_known, response=gamma != 1.0)
    if dots is not None:
        from data_synth.dots import dot_scene, wind_turns, write_dot_dataset, write_dot_series

        if poses > 1 or gamma != 1.0 or fault:
            raise InputError("--dots: one photo has neither poses nor a display, nor the faults of frames")
        drawn = dot_scene(preset, dots)
        sensor = replace(drawn.scene.sensor, bits=bits, read_noise_dn=noise_dn, shot_gain_dn=shot_gain_dn)
        drawn = replace(drawn, scene=replace(drawn.scene, sensor=sensor))
        drawn = drawn if blur_px is None else replace(drawn, blur_sigma_px=blur_px)
        options = DatasetOptions(seed, knowledge, force=force)
        if frames > 1:
            write_dot_series(folder, drawn, wind_turns(frames, 10.0), 10.0, options)
        else:
            write_dot_dataset(folder, drawn, options)
        if not quiet:
            print(folder)
        return
    if frames > 1:
        raise InputError("--frames: goes with --dots")
    numbers = parse_periods(periods)
    scene = preset_scene(preset)
    scene = replace(
        scene,
        pattern=make_pattern(numbers, numbers, steps),
        sensor=replace(scene.sensor, bits=bits, read_noise_dn=noise_dn, shot_gain_dn=shot_gain_dn),
        lighting=replace(scene.lighting, gamma=gamma),
        blur_sigma_px=scene.blur_sigma_px if blur_px is None else blur_px,
        faults=tuple(Fault.parse(text) for text in fault or ()),
    )
    progress = terminal_progress(quiet=quiet, verbose=verbose)
    if poses > 1:
        if pose_known or gamma != 1.0:
            raise InputError("--poses: the mirror's poses are found from its outline, and the display is linear then")
        write_poses(folder, scene, PoseOptions(poses, seed, 1e-2 * width_error_percent, force), progress)
    elif width_error_percent:
        raise InputError("--width-error-percent goes with --poses 2 or more")
    else:
        write_dataset(folder, scene, DatasetOptions(seed, knowledge, force=force), progress)
    if not quiet:
        print(folder)


def photogrammetry(
    context: typer.Context,
    folder: NewFolder,
    preset: Annotated[
        TargetPreset,
        typer.Option(
            help="Scene: small (8 photos, 40 codes, 12 dots), panel (40 photos, 300 codes, 8 m), single (one photo of "
            "24 megapixel), retro, busy, markers (ArUco), natural (textured tiles)."
        ),
    ] = "small",
    seed: Annotated[int, typer.Option(min=0, help="Seed of poses and noise; the same seed gives the same files.")] = 0,
    scale: Scale = 1.0,
    photos: Annotated[int | None, typer.Option(min=1, help="Only the first so many photos.")] = None,
    points_only: Annotated[
        bool, typer.Option("--points-only", help="Write image_points.csv instead of photos: quick, also for panel.")
    ] = False,
    sigma_px: Annotated[float, typer.Option(min=0.0, help="Noise of those image points.")] = 0.02,
    dictionary: Annotated[
        str | None, typer.Option(help="Ring codes: aicon-N or metashape-N; default: from the preset.")
    ] = None,
    light_on_dark: Annotated[bool, typer.Option("--light-on-dark", help="Print white on black.")] = False,
    mirrored: Annotated[bool, typer.Option("--mirrored", help="Print the wrong way round.")] = False,
    ring_radii: Annotated[
        tuple[float, float] | None,
        typer.Option(help="Inner and outer radius of the code rings, in radii of the dot; default: 2 3."),
    ] = None,
    hole: Annotated[float, typer.Option(min=0, max=0.9, help="Radius of a hole in each dot, in radii of the dot.")] = 0,
    cross: Annotated[float, typer.Option(min=0, max=0.9, help="Half length of a cross in each dot, in its radii.")] = 0,
    noise_dn: NoiseDn = None,
    blur_px: BlurPx = None,
    defocus_px_m: Annotated[
        float, typer.Option(min=0, help="Shallow depth of field: blur per difference of 1/distance from the focus.")
    ] = 0,
    sharpening: Annotated[float, typer.Option(min=0, help="Share of the sharpening that gives halos; 1 to 2.")] = 0,
    moire_pitch_px: Annotated[
        float | None, typer.Option(min=0.3, help="The targets are on a display whose pixels have this distance.")
    ] = None,
    bits: Annotated[int, typer.Option(min=8, max=16, help="Bit depth of the photos.")] = 8,
    jpeg_quality: JpegQuality = None,
    colour: Annotated[
        bool, typer.Option("--colour", help="Under warm light, JPEG in colour with halved resolution of the colours.")
    ] = False,
    force: Replace = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> None:
    """Photograph coded targets and dots on a panel, with scale bars, from known places."""
    from data_synth.targets.dataset import PhotoOptions, photogrammetry_content, write_target_dataset
    from data_synth.targets.presets import PrintChoice, target_scene
    from heliogauge.running.terminal import terminal_progress
    from photogrammetry.targets import RingRadii

    refuse_idle(context, f"preset {preset!r}", _NOT_OF_TARGETS.get(preset, ()))
    if points_only:
        refuse_idle(context, "a table of points (--points-only)", _OF_PHOTOS)
    else:
        refuse_idle(context, "a set of photos (without --points-only)", ("sigma_px",))
    radii = None if ring_radii is None else RingRadii(*ring_radii)
    prints = PrintChoice(dictionary, light_on_dark, mirrored, radii, hole, cross)
    scene = target_scene(preset, seed, prints).scaled(scale)
    scene = scene.with_sensor(bits=bits, read_noise_dn=noise_dn, blur_sigma_px=blur_px)
    scene = replace(scene, views=scene.views[:photos]).as_photographed(
        sharpening=sharpening, moire_pitch_px=moire_pitch_px, defocus_px_m=defocus_px_m
    )
    options = PhotoOptions(
        seed, sigma_px if points_only else None, (jpeg_quality or 92) if colour else jpeg_quality, force, colour
    )
    progress = terminal_progress(quiet=quiet, verbose=verbose)
    write_target_dataset(folder, scene, photogrammetry_content(scene), options, progress)
    if not quiet:
        print(folder)


def camera(
    folder: NewFolder,
    preset: Annotated[BoardPreset, typer.Option(help="Board.")] = "chessboard",
    photos: Annotated[int, typer.Option(min=1, help="Number of photos.")] = 12,
    flat: Annotated[bool, typer.Option("--flat", help="A flat and square print; real ones are neither.")] = False,
    seed: Annotated[int, typer.Option(min=0, help="Seed of poses and noise; the same seed gives the same files.")] = 0,
    scale: Scale = 1.0,
    noise_dn: NoiseDn = None,
    blur_px: BlurPx = None,
    bits: Annotated[int, typer.Option(min=8, max=16, help="Bit depth of the photos.")] = 8,
    jpeg_quality: JpegQuality = None,
    force: Replace = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> None:
    """Photograph a calibration board that is bent and sheared as real ones are."""
    from data_synth.targets.boards import board_scene, board_table
    from data_synth.targets.dataset import PhotoOptions, camera_content, write_target_dataset
    from heliogauge.running.terminal import terminal_progress

    scene = board_scene(preset, seed, n_photos=photos, flat=flat).scaled(scale)
    scene = scene.with_sensor(bits=bits, read_noise_dn=noise_dn, blur_sigma_px=blur_px)
    options = PhotoOptions(seed, None, jpeg_quality, force)
    progress = terminal_progress(quiet=quiet, verbose=verbose)
    write_target_dataset(folder, scene, camera_content(scene, board_table(preset)), options, progress)
    if not quiet:
        print(folder)


def observer(
    context: typer.Context,
    folder: NewFolder,
    preset: Annotated[
        TroughPreset,
        typer.Option(
            help="Scene: small (24 photos of a short piece), flight (two such pieces in one flight), ls2 (100 photos "
            "of 2 megapixel), ls2-long (longitudinal errors too), ls2-two-passes, displaced, sag, clouds, ground, "
            "mast, turning (before a fixed camera), absorber (two photos from the sides), panel (in the laboratory)."
        ),
    ] = "small",
    seed: Annotated[
        int, typer.Option(min=0, help="Seed of errors, paths and noise; the same seed gives the same files.")
    ] = 0,
    photos: Annotated[
        int | None, typer.Option(min=2, help="Number of photos over the same path; default: from the preset.")
    ] = None,
    scale: Scale = 1.0,
    dictionary: Annotated[
        str,
        typer.Option(
            help="Targets: aicon-N, metashape-N, square markers (DICT_4X4_100), circles; several in turn: joined by +; "
            "none."
        ),
    ] = "aicon-12",
    orientation_deg: Annotated[
        float | None,
        typer.Option(help="Turn of the collector from zenith, right-handed about +y; default: from the preset."),
    ] = None,
    slopes: Annotated[
        Path | None, typer.Option(help="Slope map (NetCDF) whose errors replace those of the preset.")
    ] = None,
    ground_targets: Annotated[
        int, typer.Option(min=0, help="Targets on the ground beside both rims, of unknown coordinates.")
    ] = 0,
    shaped: Annotated[
        bool, typer.Option("--shaped", help="Let the mirror's surface deviate, not its normals alone, as a real one's.")
    ] = False,
    panel_height_mm: Annotated[
        float, typer.Option(min=0.0, help="Mount panels of a shaped mirror too high or low: standard deviation.")
    ] = 0.0,
    rolling_shutter_ms: Annotated[
        float, typer.Option(min=0.0, help="Read the rows in this time while flying at 2 m/s; 0: all at once.")
    ] = 0.0,
    rtk_mm: Annotated[
        float, typer.Option(min=0.0, help="Write the drone's own positions with this standard deviation; 0: none.")
    ] = 0.0,
    gimbal_deg: Annotated[
        float,
        typer.Option(min=0.0, help="Write the camera's turns beside them, with this standard deviation; 0: none."),
    ] = 0.0,
    mounting_mm: Annotated[
        float, typer.Option(min=0.0, help="Mount panels off their places along the mirror: standard deviation.")
    ] = 0.0,
    tilt_mrad: Annotated[
        float, typer.Option(min=1e-4, help="Noise of the inclinometer's readings (preset far): standard deviation.")
    ] = 0.2,
    noise_dn: NoiseDn = None,
    blur_px: BlurPx = None,
    jpeg_quality: JpegQuality = None,
    force: Replace = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> None:
    """Photograph a parabolic trough with known slope errors and absorber, as a drone does."""
    from data_synth.troughs.dataset import TroughOptions, read_slope_errors, write_trough_dataset
    from data_synth.troughs.presets import TroughChoice, trough_scene
    from heliogauge.running.terminal import terminal_progress

    idle = (*_NOT_OF_TROUGHS.get(preset, ()), *(() if preset == "far" else ("tilt_mrad",)))
    refuse_idle(context, f"preset {preset!r}", idle)
    choice = TroughChoice(
        seed,
        photos,
        dictionary,
        orientation_deg,
        ground_targets,
        shaped,
        1e-3 * panel_height_mm,
        1e-3 * mounting_mm,
    )
    scene = trough_scene(preset, choice).scaled(scale)
    scene = scene.with_optics(read_noise_dn=noise_dn, blur_sigma_px=blur_px)
    if slopes is not None:
        scene = scene.with_slopes(read_slope_errors(slopes))
    if rolling_shutter_ms:
        scene = scene.with_rolling_shutter(1e-3 * rolling_shutter_ms)
    progress = terminal_progress(quiet=quiet, verbose=verbose)
    options = TroughOptions(
        seed,
        jpeg_quality,
        force,
        1e-3 * rtk_mm if rtk_mm else None,
        math.radians(gimbal_deg) or None,
        1e-3 * tilt_mrad,
    )
    write_trough_dataset(folder, scene, options, progress)
    if not quiet:
        print(folder)


def beam(
    folder: NewFolder,
    facets: Annotated[tuple[int, int], typer.Option(metavar="N M", help="Facets along width and height.")] = (2, 2),
    suns: Annotated[int, typer.Option(min=1, help="Times of the day, from 9 to 16 h.")] = 3,
    repeats: Annotated[int, typer.Option(min=1, help="Photos at each.")] = 1,
    canting_mrad: Annotated[float, typer.Option(min=0.0, help="Canting errors, 1 sigma of each component.")] = 0.8,
    slope_mrad: Annotated[float, typer.Option(min=0.0, help="Slope errors finer than facets, 1 sigma.")] = 0.8,
    fault: Annotated[
        list[str] | None,
        typer.Option(
            help="Spoil the photos: haze, shadow, moved-shadow, panels, clouds, blooming, overexposed, underexposed, "
            "second-beam, cut, night, local-time, other-target. May be given several times."
        ),
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Seed of errors and noise; the same seed gives the same files.")] = 0,
    force: Replace = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> None:
    """Photograph the beam of a heliostat with known canting errors on a target at several suns."""
    from data_synth.heliostats.beam_photos import BenchOptions, write_beam_dataset
    from heliogauge.running.terminal import terminal_progress

    options = BenchOptions(
        facets, suns, repeats, 1e-3 * canting_mrad, 1e-3 * slope_mrad, tuple(fault or ()), seed, force
    )
    write_beam_dataset(folder, options, terminal_progress(quiet=quiet, verbose=verbose))
    if not quiet:
        print(folder)


def heliostat(
    context: typer.Context,
    folder: NewFolder,
    preset: Annotated[
        HeliostatPreset,
        typer.Option(
            help="Plant: small (4 heliostats of 60 beams), field (100 of 100), juelich (20 with linear actuators, "
            "three targets), faulty (24, half of them with one fault each), stellenbosch (one with a worm gear, four "
            "days), drone (sightings from 32 to 70 m), images (photos of 32 beams), images-lens (a distorting "
            "lens), tests (all tests of one for its data sheet)."
        ),
    ] = "small",
    seed: Annotated[
        int, typer.Option(min=0, help="Seed of errors, times and noise; the same seed gives the same files.")
    ] = 0,
    heliostats: Annotated[int | None, typer.Option(min=1, help="How many; default: from the preset.")] = None,
    observations: Annotated[
        int | None, typer.Option(min=1, help="About so many of each heliostat; default: from the preset.")
    ] = None,
    spot_sigma_mm: Annotated[
        float | None, typer.Option(min=0.0, help="Noise of a spot, right and up; default: from the preset.")
    ] = None,
    wind_mrad: Annotated[
        float | None, typer.Option(min=0.0, help="The normal in the wind, about each axis; default: from the preset.")
    ] = None,
    outliers: Annotated[
        float | None, typer.Option(min=0.0, max=1.0, help="Share of spots that are wrong by half a metre.")
    ] = None,
    fault: Annotated[
        list[str] | None,
        typer.Option(
            help="Spoil the next heliostat, or FAULT:NAME: wrong-actuator, moved, change-point, drift, backlash, "
            "outliers, wrong-target, south-azimuth, local-time, stuck-reading, duplicates, few. May be given several "
            "times."
        ),
    ] = None,
    force: Replace = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> None:
    """Let heliostats with known errors throw the sun on a tower's targets, and measure their beams."""
    from data_synth.heliostats.dataset import HeliostatOptions, write_heliostat_dataset
    from data_synth.heliostats.presets import HeliostatChoice, heliostat_scene
    from heliogauge.running.terminal import terminal_progress

    refuse_idle(context, f"preset {preset!r}", _NOT_OF_HELIOSTATS.get(preset, ()))
    if preset == "tests":
        from data_synth.acceptance.dataset import write_tests_folder

        write_tests_folder(folder, seed=seed, force=force)
        if not quiet:
            typer.echo(f"heliostat AB12 under test; truth in {folder / 'truth.json'}")
        return
    scene = heliostat_scene(preset, HeliostatChoice(seed, heliostats, observations))
    spot_m = None if spot_sigma_mm is None else (1e-3 * spot_sigma_mm, 1e-3 * spot_sigma_mm)
    wind_rad = None if wind_mrad is None else 1e-3 * wind_mrad
    scene = scene.with_disturbances(spot_m=spot_m, wind_rad=wind_rad, outliers=outliers).with_faults(tuple(fault or ()))
    progress = terminal_progress(quiet=quiet, verbose=verbose)
    write_heliostat_dataset(folder, scene, HeliostatOptions(seed, force), progress)
    if not quiet:
        print(folder)
