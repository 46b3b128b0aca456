"""``heliogauge synth``: measurement folders with known truth, for tests, demonstrations and test planning."""

from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from heliogauge.commands import Quiet, Verbose, parse_periods

app = typer.Typer(
    help="Make a measurement folder with known truth.",
    rich_markup_mode=None,
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)


@app.callback()
def synth() -> None:
    """Make a measurement folder with known truth."""


@app.command()
def fringes(
    out: Annotated[Path, typer.Argument(metavar="OUT", help="Folder to write; absent or empty.", show_default=False)],
    preset: Annotated[
        str,
        typer.Option(
            help="Scene: small, full, off-axis, off-axis-20, trough-panel, sphere, plane, curved-screen, ensemble."
        ),
    ] = "small",
    seed: Annotated[int, typer.Option(min=0, help="Seed of all noise; the same seed gives the same files.")] = 0,
    noise_dn: Annotated[float, typer.Option(min=0.0, help="Noise of each pixel, whatever its signal.")] = 1.0,
    shot_gain_dn: Annotated[float, typer.Option(min=0.0, help="DN per electron; 0: no shot noise.")] = 0.0,
    bits: Annotated[int, typer.Option(min=8, max=16, help="Bit depth of the images.")] = 8,
    gamma: Annotated[float, typer.Option(min=0.1, help="Exponent of the display; response.csv tells it.")] = 1.0,
    blur_px: Annotated[
        float | None, typer.Option(min=0.0, help="Gaussian blur of the lens; the preset's without.")
    ] = None,
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
    pose_known: Annotated[bool, typer.Option("--pose-known", help="Tell the mirror's pose exactly.")] = False,
    force: Annotated[bool, typer.Option("--force", help="Replace an earlier synthetic measurement.")] = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> None:
    """Draw fringe images of a screen seen in a mirror with known slope errors."""
    from data_synth.dataset import DatasetOptions, write_dataset
    from data_synth.faults import Fault
    from data_synth.knowledge import Knowledge
    from data_synth.presets import preset_scene
    from deflectometry.patterns import make_pattern
    from heliogauge.terminal import terminal_progress

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
    knowledge = Knowledge(pose_known=pose_known, response=gamma != 1.0)
    write_dataset(out, scene, DatasetOptions(seed, knowledge, force), terminal_progress(quiet=quiet, verbose=verbose))
    print(out)
