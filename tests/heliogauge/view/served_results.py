"""Small results, and a server of them that is asked without the corrections of a browser."""

import http.client
import threading
from collections.abc import Iterator, Mapping
from pathlib import Path
from urllib.parse import urlsplit

import numpy as np

from heliogauge.doubts import Doubt
from heliogauge.flags import SampleFlag
from heliogauge.results.folder import Summary, write_slope_map, write_summary
from heliogauge.slopes.map import SlopeMap, no_common_modes
from heliogauge.view.server.opened import open_place
from heliogauge.view.server.serving import Viewer
from heliogauge.view.server.site import Site

SIGMA_RAD = 2e-5


def slope_map(tilt_rad: float = 0.0, nodes: int = 40, seed: int = 1) -> SlopeMap:
    """A flat mirror with a tilt about y, noise of 20 microradians and a hole."""
    x_m = y_m = np.linspace(-0.5, 0.5, nodes)
    x, y = np.meshgrid(x_m, y_m)
    rng = np.random.default_rng(seed)
    hole = np.hypot(x - 0.2, y) < 0.1
    slopes = [np.where(hole, np.nan, tilt + rng.normal(0, SIGMA_RAD, x.shape)) for tilt in (tilt_rad, 0.0)]
    flags = np.where(hole, np.uint32(SampleFlag.SATURATED), np.uint32(0))
    sigma, zero = np.full(x.shape, SIGMA_RAD), np.zeros(x.shape)
    aperture = np.ones(x.shape, dtype=bool)
    words = ("flat", "facet", "nothing")
    return SlopeMap(
        x_m, y_m, *slopes, zero, zero, sigma, sigma, 1.0, no_common_modes(), np.nan * x, flags, aperture, *words
    )


def write_result(folder: Path, name: str, one: SlopeMap | None, sdx_rad: float = 1e-3) -> None:
    folder.mkdir(parents=True)
    if one is not None:
        write_slope_map(folder / "slope_map.nc", {"": one})
    numbers = {"sdx_rad": sdx_rad, "sigma_sdx_rad": 1e-5, "measured_share": 0.9}
    doubts = (Doubt("measured_share_low", "10 % was not measured"),)
    write_summary(folder / "summary.json", Summary("deflectometry", name, numbers, doubts=doubts))


class Asker:
    """Sends requests as they are written, without the corrections of a browser."""

    def __init__(self, viewer: Viewer) -> None:
        self.port, self.base = viewer.server_port, urlsplit(viewer.address).path

    def ask(
        self, target: str, method: str = "GET", headers: Mapping[str, str] | None = None
    ) -> tuple[int, str, http.client.HTTPMessage]:
        connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=60)
        connection.putrequest(method, target, skip_host=headers is not None, skip_accept_encoding=True)
        for name, value in (headers or {}).items():
            connection.putheader(name, value)
        connection.endheaders()
        response = connection.getresponse()
        body = response.read().decode("utf-8", "replace")
        connection.close()
        return response.status, body, response.headers

    def page(self, address: str) -> tuple[int, str]:
        return self.ask(self.base + address)[:2]


def serve(*places: Path) -> Iterator[Asker]:
    viewer = Viewer(Site([open_place(place) for place in places]))
    thread = threading.Thread(target=viewer.serve_forever, daemon=True)
    thread.start()
    yield Asker(viewer)
    viewer.shutdown()
    viewer.server_close()
    thread.join(10)
