"""The Observer: photos of the absorber's reflection in a parabolic trough to slope errors and absorber position.

`run` evaluates a measurement; the rooms describe a trough (`trough`), say what a measured one collects (`light`),
simulate flights (`planning`), compare flights (`product`) and draw results (`report`).
"""

from typing import TYPE_CHECKING

from heliogauge.faces import lazy_face

if TYPE_CHECKING:
    from observer import light as light
    from observer import planning as planning
    from observer import product as product
    from observer import report as report
    from observer import trough as trough
    from observer.keys import load_observer as load_observer
    from observer.pipeline.measure import Options as Options
    from observer.pipeline.measure import run as run
    from observer.pipeline.result import Result as Result

__getattr__, __dir__, __all__ = lazy_face(__name__)
