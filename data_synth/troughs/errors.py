"""Drawn errors of a trough's mirror: tilted and bent panels, and waves over all of them."""

import itertools
from dataclasses import replace

import numpy as np

from data_synth.optics.surface_errors import Ripple, SurfaceErrors
from data_synth.troughs.mirror import PanelErrors, TroughMirror
from heliogauge.errors import InputError
from observer.trough import Collector


def random_mirror(
    collector: Collector,
    rng: np.random.Generator,
    *,
    transverse_rad: float = 3e-3,
    longitudinal_rad: float = 0.0,
    is_shaped: bool = False,
) -> TroughMirror:
    """Return a mirror with tilted and bent panels and waves over all of them.

    transverse_rad: RMS of theta_r over the aperture [rad].
    longitudinal_rad: RMS of the longitudinal slope error [rad].
    is_shaped: Whether the surface deviates as the slopes say. Its waves then run across and along, because a
        surface that waves in other directions has both slopes; each panel's mean height is the design's.
    """
    n = TroughMirror(collector).n_panels
    across, along = _waves(rng, 7), _waves(rng, 7)
    if is_shaped:
        across, along = _directed(across, 0.0), _directed(along, np.pi / 2)
    tilt_x, tilt_y, bend = rng.standard_normal((3, n)) * np.array([[1.0], [0.6], [1.3]])
    x, y = np.meshgrid(
        np.linspace(-0.5, 0.5, 301) * collector.aperture_width_m, np.linspace(-0.5, 0.5, 401) * collector.length_m
    )
    scale_x, scale_y = 1e-3 * transverse_rad / 3e-3, 1e-3 * (longitudinal_rad > 0)
    mirror = TroughMirror(collector)
    # theta_r is not quite linear in the slope; the third round changes nothing any more.
    for _ in range(3):
        focal = 1 / (1 / collector.focal_length_m + 2 * scale_x * bend)
        waves = (_scaled(across, scale_x), _scaled(along, scale_y))
        panels = PanelErrors(scale_x * tilt_x, scale_y * tilt_y, focal)
        if is_shaped:
            mirror = _at_mean_height(TroughMirror(collector, _joined(*waves), panels=panels, is_shaped=True))
        else:
            mirror = TroughMirror(collector, transverse=waves[0], longitudinal=waves[1], panels=panels)
        scale_x *= transverse_rad / float(np.sqrt(np.nanmean(mirror.theta_r_rad(x, y) ** 2)))
        if longitudinal_rad:
            scale_y *= longitudinal_rad / float(np.sqrt(np.nanmean(mirror.deviation(x, y)[2] ** 2)))
    return mirror


def with_panel_tilts(mirror: TroughMirror, sigma_rad: float, rng: np.random.Generator) -> TroughMirror:
    """Turn the panels of a mirror, as before anybody aligned them.

    sigma_rad: Standard deviation of the turns, as slopes across [rad].
    InputError: The mirror has no panels.
    """
    if mirror.panels is None:
        raise InputError("panel tilts: the mirror has no panels")
    tilt_x = mirror.panels.tilt_x + sigma_rad * rng.standard_normal(mirror.n_panels)
    return replace(mirror, panels=replace(mirror.panels, tilt_x=tilt_x))


def with_panel_heights(mirror: TroughMirror, sigma_m: float, rng: np.random.Generator) -> TroughMirror:
    """Mount the panels of a shaped mirror too high or too low.

    sigma_m: Standard deviation of the heights; measurement.toml states it [m].
    InputError: The mirror has no shape, or no panels.
    """
    panels = mirror.panels
    if not mirror.is_shaped or panels is None:
        raise InputError("panel heights: only a mirror that is shaped has them (shaped=True), with panels that err")
    higher = panels.heights + sigma_m * rng.standard_normal(panels.heights.size)
    collector = replace(mirror.collector, panel_height_sigma_m=sigma_m)
    return replace(mirror, collector=collector, panels=replace(panels, height_m=higher))


def with_mounting(mirror: TroughMirror, sigma_m: float, rng: np.random.Generator) -> TroughMirror:
    """Mount the panels off their places along the mirror's surface and along the trough.

    sigma_m: Standard deviation of each panel's shift in each of both directions [m].
    InputError: The mirror has no panels.
    """
    panels = mirror.panels
    if panels is None:
        raise InputError("mounting: this preset's mirror is one without panels that err")
    edges = mirror.collector.panel_edges_x_m
    middle = np.tile((edges[1:] + edges[:-1]) / 2, len(mirror.collector.panel_edges_y_m) - 1)
    slope = middle / (2 * mirror.collector.focal_length_m)
    shift = sigma_m * rng.standard_normal((panels.tilt_x.size, 2))
    shift[:, 0] /= np.hypot(1.0, slope)
    return replace(mirror, panels=replace(panels, shift_m=shift))


def _waves(rng: np.random.Generator, n: int) -> tuple[Ripple, ...]:
    """Draw waves of 0.5 to 3 m in all directions, of about slope 1 at 1 m and less where shorter."""
    waves = []
    for period in np.exp(rng.uniform(np.log(0.5), np.log(3.0), n)):
        amplitude = float(rng.uniform(0.7, 1.3) * np.sqrt(period))
        waves.append(Ripple(amplitude, float(period), float(rng.uniform(0, np.pi)), float(rng.uniform(0, 2 * np.pi))))
    return tuple(waves)


def _directed(waves: tuple[Ripple, ...], direction_rad: float) -> tuple[Ripple, ...]:
    return tuple(replace(wave, direction_rad=direction_rad) for wave in waves)


def _joined(first: SurfaceErrors, second: SurfaceErrors) -> SurfaceErrors:
    return SurfaceErrors((*first.terms, *second.terms))


def _at_mean_height(mirror: TroughMirror) -> TroughMirror:
    """Lift or lower each panel of a shaped mirror so that its mean height is the design's."""
    design = mirror.collector
    lift = []
    for first_y, last_y in itertools.pairwise(design.panel_edges_y_m):
        for first_x, last_x in itertools.pairwise(design.panel_edges_x_m):
            x, y = np.meshgrid(np.linspace(first_x, last_x, 61)[1:-1], np.linspace(first_y, last_y, 61)[1:-1])
            lift.append(-float(np.nanmean(mirror.deviation(x, y)[0])))
    panels = mirror.panels
    return mirror if panels is None else replace(mirror, panels=replace(panels, height_m=np.array(lift)))


def _scaled(waves: tuple[Ripple, ...], factor: float) -> SurfaceErrors:
    if not factor:
        return SurfaceErrors()
    return SurfaceErrors(tuple(replace(wave, slope_amplitude_rad=wave.slope_amplitude_rad * factor) for wave in waves))
