"""Description of a trough: collector, absorber path, glass, visibility, the observation equation. Estimates nothing."""

from typing import TYPE_CHECKING

from heliogauge.faces import lazy_face

if TYPE_CHECKING:
    from observer.trough.absorber_path import AbsorberPath as AbsorberPath
    from observer.trough.collector import Collector as Collector
    from observer.trough.collector import GlassTube as GlassTube
    from observer.trough.collector import ls2 as ls2
    from observer.trough.collector import ls3 as ls3
    from observer.trough.expectation import Expectation as Expectation
    from observer.trough.typical_mirror import TypicalMirror as TypicalMirror
    from observer.trough.visibility import seeable_shares as seeable_shares

__getattr__, __dir__, __all__ = lazy_face(__name__)
