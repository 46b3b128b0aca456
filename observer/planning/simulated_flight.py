"""One whole measurement by numbers alone: edges and bearings as photos would give them, then the evaluation itself."""

from dataclasses import dataclass, replace

import numpy as np

from heliogauge.slopes.map import SlopeMap
from heliogauge.validate import FloatArray
from observer.absorber.position import solve_absorber
from observer.photo_edges.reflection_edges import ReflectionEdges
from observer.planning.photo_network import Believed
from observer.planning.simulated_bearings import measured_bearings
from observer.planning.simulated_edges import EdgeNoise, Scene, measured_edges, true_edges
from observer.product.slope_map import known_theta_r, slope_map_of
from observer.selection.solve_and_refuse import Reflector, solve_reflector
from observer.slopes.row_spline import Roughness
from observer.trough.absorber_path import AbsorberPath
from observer.trough.expectation import Expectation
from observer.trough.visibility import Visibility, visibility


@dataclass(frozen=True, slots=True)
class Evaluation:
    """How a measurement is evaluated.

    column_step_m: Distance of the nodes across the trough [m].
    station_step_m: Distance of the absorber's stations [m].
    along_rad: Standard deviation of the slope along the trough, as prior [rad].
    measures_absorber: Whether the absorber's place is measured in the photos; it is known otherwise.
    """

    column_step_m: float = 0.02
    station_step_m: float = 0.25
    along_rad: float = 2e-3
    measures_absorber: bool = True


@dataclass(frozen=True, slots=True, eq=False)
class Simulated:
    """What one simulated measurement gives, beside the truth.

    edges: Edges as measured.
    reflector: The evaluation's slope errors.
    slope_map: The same as the product of a measurement: what is too uncertain refused, what is not seen flagged.
    visible: What of the mirror the cameras can see.
    absorber: The evaluation's absorber, with covariance.
    true_error_x (r, nx): True errors of dz/dx at the nodes [rad].
    true_x_m, true_z_m (n,): True axis of the tube at the absorber's stations [m].
    """

    edges: ReflectionEdges
    reflector: Reflector
    slope_map: SlopeMap
    visible: Visibility
    absorber: AbsorberPath
    true_error_x: FloatArray
    true_x_m: FloatArray
    true_z_m: FloatArray

    @property
    def error_slope_x(self) -> FloatArray:
        """Estimated less true dz/dx, shape (r, nx); NaN where nothing was measured [rad]."""
        return np.asarray(self.slope_map.slope_error_x - self.true_error_x)

    @property
    def sigma_slope_x(self) -> FloatArray:
        """Stated standard deviation of dz/dx, shape (r, nx); NaN where nothing was measured [rad]."""
        return self.slope_map.sigma_slope()[0]


def error_theta_ra(simulated: Simulated, focal_length_m: float, true_absorber: AbsorberPath) -> FloatArray:
    """Return estimated less true reflector-absorber angle at the nodes.

    true_absorber: The tube's true axis.
    Returns (r, nx): Error of theta_ra = theta_r + theta_a; NaN where nothing was measured [rad].
    """
    x, y = np.meshgrid(simulated.slope_map.x_m, simulated.slope_map.y_m)
    z = x**2 / (4 * focal_length_m)
    beta = []
    for path in (simulated.absorber, true_absorber):
        axis_x, axis_z = path.at(y)
        beta.append(np.arctan2(axis_x - x, axis_z - z))
    turned = simulated.error_slope_x / (1 + (x / (2 * focal_length_m)) ** 2)
    return np.asarray(-turned - 0.5 * (beta[0] - beta[1]))


def simulate(
    scene: Scene, believed: Believed, noise: EdgeNoise, evaluation: Evaluation, rng: np.random.Generator
) -> Simulated:
    """Simulate one measurement and evaluate it by the instrument's own estimators.

    believed: Cameras and poses as the photo network finds them.
    noise: How well edges are found.
    EstimationError: The photos show too little of the reflection or of the absorber.
    """
    truth = scene.truth
    collector, y = truth.collector, truth.y_m
    absorber, photos = truth.absorber, believed.photos
    if evaluation.measures_absorber:
        bearings = measured_bearings(scene, believed.views, noise, rng)
        stations = collector.stations_m(evaluation.station_step_m)
        solution = solve_absorber(bearings, photos, AbsorberPath.designed(collector), stations, collector)
        absorber, photos = solution.path, replace(photos, with_tube=solution.with_poses)
    edges = measured_edges(scene, true_edges(scene, noise), believed.views, rng)
    expected = Expectation(collector, absorber, y, truth.slope_error_rad)
    prior = Roughness(1e-3, evaluation.along_rad)
    reflector = solve_reflector(edges, photos, expected, evaluation.column_step_m, prior)
    absorber = reflector.absorber
    nodes = (reflector.grid.x_m, y)
    visible = visibility(nodes, believed.photos.eyes_m, collector, absorber, known_theta_r(reflector, collector))
    slope_map = slope_map_of(reflector, collector, visible)
    grid_x, grid_y = np.meshgrid(*nodes)
    true_error, _ = scene.mirror.errors(grid_x.reshape(-1), grid_y.reshape(-1))
    true_x, true_z = truth.absorber.at(absorber.y_m)
    return Simulated(edges, reflector, slope_map, visible, absorber, true_error.reshape(grid_x.shape), true_x, true_z)
