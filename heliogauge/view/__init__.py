"""Interactive views of results, for reports and the viewer: values with words, no files.

A view is a frozen dataclass that holds numbers and words. It is a piece of a report notebook like any other:

- ``_repr_html_()`` gives its still pictures (`stills`, drawn by the caller, or drawn by the view itself on first use);
  notebooks, print and browsers without script show them.
- ``figure()`` gives a figure of matplotlib to be changed or saved; it needs the extra ``plots``.
- ``page_html(store=PAGE)`` gives its place in a page, the still pictures and the numbers included. A piece made of
  others passes `store` on. A page that holds views gets `page_assets(body)` once in its head: style sheet, scripts
  and the libraries that the views in this body need, nothing else.

The kinds:

- `maps.MapView`: quantities on a grid. ``slope_map_view(slope_map, "Mirror 7")`` makes one of all that a slope map
  holds; its ``removals[0].parts`` hold the `SlopeStatistics` of each removal, so a table beside it need not form them
  again. Any other grid: ``MapView(name, x_m, y_m, (MapLayer("dose", "Dose", "J", values),), flags, aperture)``.
- `photos.PhotoView`: photos with `PhotoMarks` (used ones with residual vectors, refused ones with the reason as label)
  and `PhotoLines`; ``mark="photo-7"`` lets links "#photo-7" open this photo.
- `scenes.SceneView`: points and lines in space (`SceneGroup`).
- `tables.TableView`: columns with texts, numbers to sort by, and links ("#photo-7", "facet-2/report.html").
- `charts.ChartView`: lines with sigma bands, points, bars, steps in printed units.

Sizes in a page: a map of 400 x 400 nodes takes 0.2 to 0.3 MB for each noisy layer, a photo of 1000 px 0.08 MB, the
libraries of `page_assets` less than 1 MB. Arrays are thinned for the page by the view; the viewer shows all nodes.

Colours of the page: the views read the CSS variables ``--paper --ink --faint --line --accent`` of the page, which
follow ``prefers-color-scheme`` and the attribute ``data-theme`` ("dark", "light") of the root element;
``<button data-theme-switch>`` anywhere in the page switches. For print the still pictures replace the views.

``.plot()`` of a result can show ``slope_map_view(...)`` directly: in Jupyter its still pictures appear.
"""
