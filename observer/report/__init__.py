"""Views and sections of the reports of troughs."""

from typing import TYPE_CHECKING

from heliogauge.faces import lazy_face

if TYPE_CHECKING:
    from observer.report.maps import mirror_view as mirror_view
    from observer.report.pictures import photo_view as photo_view
    from observer.report.results import open_trough as open_trough

__getattr__, __dir__, __all__ = lazy_face(__name__)
