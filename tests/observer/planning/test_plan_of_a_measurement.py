"""A plan against the measurement that was then made: the same scene photographed and evaluated."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from data_synth.troughs.dataset import write_trough_dataset
from data_synth.troughs.presets import trough_scene
from heliogauge.results.slope_map_file import write_slope_map
from observer.keys import load_observer
from observer.pipeline import measure as pipeline
from observer.planning import plan as pipeline_plan
from observer.planning.keys import load_observer_plan


@pytest.mark.slow
def test_a_plan_states_what_the_measurement_then_states(tmp_path: Path) -> None:
    folder, earlier, plan = (tmp_path / name for name in ("photos", "earlier", "plan"))
    scene = trough_scene("small")
    write_trough_dataset(folder, scene)
    measured = pipeline.run(load_observer(folder))
    for one in (earlier, plan):
        one.mkdir()
    measured.write(earlier)
    # The plan looks at the true mirror: what was measured of it is smoother.
    slope_map = measured.slope_map
    x, y = np.meshgrid(slope_map.x_m, slope_map.y_m)
    true_x = scene.world.mirror.deviation(x, y)[1]
    truth = replace(slope_map, slope_x=np.where(slope_map.valid, slope_map.design_slope_x + true_x, np.nan))
    (earlier / "slope_map.nc").unlink()
    write_slope_map(earlier / "slope_map.nc", {"": truth})
    said = (folder / "measurement.toml").read_text()
    (plan / "targets.csv").write_text((folder / "targets.csv").read_text())
    edges, bundle = measured.seen.edges, measured.network.solved.bundle
    pixel_m = 12.0 / 1030.0
    target_px = float(np.sqrt(np.median(bundle.problem.observations.covariance_px2[:, 0, 0])))
    edge_px = float(np.median(edges.sigma_x_m)) / pixel_m
    # Behind glass the tube's middle is less sure than an edge, and all rows of a photo have a part of it in common.
    bearings = measured.seen.bearings
    tube_px = float(np.median(np.hypot(bearings.sigma_rad, bearings.shared_rad))) * 12.0 / pixel_m
    bars = "[[scale_bar]]" + said.partition("[[scale_bar]]")[2].partition("[evaluation]")[0]
    (plan / "measurement.toml").write_text(
        'kind = "observer-plan"\nname = "small"\n'
        + said[said.index("[collector]") : said.index("[images]")]
        + f"[targets]\nsigma_px = {target_px}\n{bars}\n"
        + '[[flight]]\nheight_m = 12.0\nreach_m = 2.9\nphotos = 24\n[mirror]\nlike = "../earlier"\n'
        + f"[noise]\nreflection_px = {edge_px}\nabsorber_px = {tube_px}\n"
    )
    planned = pipeline_plan.run(load_observer_plan(plan))
    sigmas = [one.sigma_slope()[0][one.valid] for one in (planned.simulated.slope_map, slope_map)]
    assert np.median(sigmas[0]) / np.median(sigmas[1]) == pytest.approx(1.0, abs=0.2)
    assert planned.simulated.slope_map.measured_share == pytest.approx(slope_map.measured_share, abs=0.06)
    places = [np.mean([np.trace(part[3:, 3:]) for part in one.covariance.poses]) for one in (planned.bundle, bundle)]
    assert np.sqrt(places[0] / places[1]) == pytest.approx(1.0, abs=0.1)
