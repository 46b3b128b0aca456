"""Fringe deflectometry: images of fringes seen in a mirror to a slope map with its uncertainty.

`run` evaluates a measurement folder that `load_deflectometry` has read. The rooms follow the data: what stands where
(`setup`), faulty frames (`frames`), phase and display point of each pixel (`fringes`), the mirror's pose, its shape and
maps, the stages in a row (`pipeline`), and several poses of one mirror in one adjustment (`poses`); `exchange` reads
measurements made with OpenCSP, `write_patterns` makes the frames to display.
"""

from typing import TYPE_CHECKING

from heliogauge.faces import lazy_face

if TYPE_CHECKING:
    from deflectometry import exchange as exchange
    from deflectometry import frames as frames
    from deflectometry import fringes as fringes
    from deflectometry import pipeline as pipeline
    from deflectometry import setup as setup
    from deflectometry.keys import load_deflectometry as load_deflectometry
    from deflectometry.pipeline.choices import Options as Options
    from deflectometry.pipeline.measure import run as run
    from deflectometry.pipeline.result import Result as Result
    from deflectometry.pipeline.write_patterns import write_patterns as write_patterns

__getattr__, __dir__, __all__ = lazy_face(__name__)
