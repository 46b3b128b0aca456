"""The results of any instrument as one view of their folder."""

import html
import io
import os
import shutil
import weakref
from collections.abc import Iterator, Mapping
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from heliogauge.doubts import Doubt
from heliogauge.errors import InputError
from heliogauge.files.extras import of_extra
from heliogauge.files.faults import explain_faults
from heliogauge.files.hdf5 import read_netcdf
from heliogauge.files.own_folder import refuse_links_out
from heliogauge.files.regular import read_regular
from heliogauge.formula_cells import plain_cell
from heliogauge.results.folder import SUMMARY_FILE, ResultFolder, Summary, read_summary, what_instead
from heliogauge.short_repr import shortened

if TYPE_CHECKING:
    import pandas
    import xarray
    from matplotlib.figure import Figure

    from heliogauge.view.maps import MapLayer

SLOPE_MAP_FILE = "slope_map.nc"
_NEEDED = "a folder of results as heliogauge wrote it"
#: Numbers and doubts that a notebook shows at once; the others are in `Result.summary` and `Result.doubts`.
_MOST_NUMBERS, _MOST_DOUBTS = 12, 5


class Tables(Mapping[str, Any]):
    """The CSV tables of a folder by their names without ending, each read when it is asked for."""

    def __init__(self, folder: Path) -> None:
        self._files = {file.stem: file for file in sorted(folder.glob("*.csv"))}

    def __getitem__(self, name: str) -> "pandas.DataFrame":
        """Read a table."""
        if name not in self._files:
            raise InputError(f"table {name!r} is not among the results; there are: {', '.join(self._files) or 'none'}")
        pandas = of_extra("pandas")
        content = read_regular(self._files[name], "a CSV file")
        try:
            table = pandas.read_csv(io.BytesIO(content))
        except (ValueError, OverflowError, RecursionError) as error:
            raise InputError(f"{self._files[name]}: cannot be read as CSV ({str(error)[:200]})") from error
        if b"'" in content:
            texts = table.select_dtypes(exclude="number").columns
            table[texts] = table[texts].map(lambda cell: plain_cell(cell) if isinstance(cell, str) else cell)
            table.columns = [plain_cell(str(column)) for column in table.columns]
        return table

    def __contains__(self, name: object) -> bool:
        """Return whether there is a table of this name, without reading it."""
        return name in self._files

    def get(self, name: str, default: Any = None) -> Any:
        """Read a table, or return the default where there is none."""
        if name not in self:
            return default
        return self[name]

    def __iter__(self) -> Iterator[str]:
        """Go through the names."""
        return iter(self._files)

    def __len__(self) -> int:
        """Count the tables."""
        return len(self._files)

    def __repr__(self) -> str:
        """List the names."""
        return f"<tables {', '.join(self._files) or 'none'}>"


class Parts(Mapping[str, "Result"]):
    """Results within results by their names: heliostats of a field, measurements of many folders."""

    def __init__(self, folder: Path) -> None:
        places = sorted(folder.iterdir()) if folder.is_dir() else []
        self._folders = {
            place.name: place
            for place in places
            if not place.name.startswith(".") and not place.is_symlink() and (place / SUMMARY_FILE).is_file()
        }

    def __getitem__(self, name: str) -> "Result":
        """Open one of them."""
        if name not in self._folders:
            raise InputError(f"result {name!r} is not among these; there are: {', '.join(self._folders) or 'none'}")
        return Result(self._folders[name])

    def __contains__(self, name: object) -> bool:
        """Return whether there is a result of this name, without opening it."""
        return name in self._folders

    def __iter__(self) -> Iterator[str]:
        """Go through the names."""
        return iter(self._folders)

    def __len__(self) -> int:
        """Count them."""
        return len(self._folders)

    def __repr__(self) -> str:
        """List the names."""
        return f"<results {shortened(', '.join(self._folders), 100) or 'none'}>"


class Result:
    """Results of a measurement of any kind, as they stand in a folder.

    Parameters
    ----------
    folder : str or Path
        Folder of results.
    temporary : bool, optional
        Remove the folder when this view is gone.

    Attributes
    ----------
    folder : Path
        Where the files are.
    kind : str
        Kind of result, such as "deflectometry".
    name : str
        Name of what was measured.
    tables : mapping of str to pandas.DataFrame
        The CSV tables, by their names without ending.
    parts : mapping of str to Result
        Results within these: the heliostats of a field, the measurements of many folders.

    Notes
    -----
    In a notebook a result shows its headline numbers with their standard deviations, its doubts and its picture.
    """

    def __init__(self, folder: str | Path, *, temporary: bool = False) -> None:
        self.folder = Path(folder).expanduser().absolute()
        self.tables = Tables(self.folder)
        if temporary:
            # Tables outlive the view that they were taken from.
            weakref.finalize(self.tables, _remove, self.folder, os.getpid())
        if not (self.folder / SUMMARY_FILE).is_file():
            raise InputError(f"{self.folder}: {what_instead(self.folder)}")
        refuse_links_out(self.folder)
        self._summary: Summary = read_summary(self.folder / SUMMARY_FILE)
        self.kind, self.name = self._summary.kind, self._summary.name
        self.parts = Parts(self.folder)

    @property
    def summary(self) -> dict[str, float | int | None]:
        """Headline numbers, units in their names, with their standard deviations; None: not determined."""
        return dict(self._summary.numbers)

    @property
    def doubts(self) -> tuple[Doubt, ...]:
        """What makes the result doubtful."""
        return self._summary.doubts

    @cached_property
    def slope_map(self) -> "xarray.Dataset":
        """The slope map; of several facets the assembled one."""
        if not self._has_map():
            raise InputError(f"{self.folder}: results of the kind {self.kind!r} have no slope map ({SLOPE_MAP_FILE})")
        return read_netcdf(self.folder / SLOPE_MAP_FILE)

    @cached_property
    def angles(self) -> "xarray.Dataset":
        """Angles from the design's to the measured normal in x and y [rad], with sigma; more of them from troughs.

        The same for all instruments: ``angle_x`` is positive where the mirror rises too much towards +x, as the slope
        error is, and SDx is its RMS. Troughs add theta_r, theta_a and theta_ra of the Observer, whose sign is theirs.
        """
        with explain_faults(self.folder, _NEEDED):
            return self._angles()

    def _angles(self) -> "xarray.Dataset":
        import numpy as np

        from heliogauge.slopes.normal_angles import d_angles_d_slopes, normal_angles

        library = of_extra("xarray")
        slopes = self.slope_map
        names = ("slope_x", "slope_y", "design_slope_x", "design_slope_y")
        measured_x, measured_y, design_x, design_y = (slopes[name].values.astype(np.float64) for name in names)
        turn = d_angles_d_slopes(design_x, design_y)
        variances = [slopes[f"sigma_slope_{axis}"].values.astype(np.float64) ** 2 for axis in "xy"]
        # A trough flown in one pass has slopes across only: there the normal turns across alone.
        across_only = np.isnan(measured_y)
        angles = normal_angles(measured_x, np.where(across_only, design_y, measured_y), design_x, design_y)
        angles[1][across_only] = np.nan
        fields: dict[str, Any] = {}
        for place, axis in enumerate("xy"):
            # The two slopes of a node have independent noise; what they share is small beside it.
            along = np.where(across_only & (place == 0), 0.0, variances[1])
            sigma = np.sqrt(turn[place, 0] ** 2 * variances[0] + turn[place, 1] ** 2 * along)
            words = f"angle from the design's to the measured normal, component in {axis}"
            fields[f"angle_{axis}"] = (("y", "x"), angles[place], {"units": "rad", "long_name": words})
            about = {"units": "rad", "long_name": f"standard deviation of angle_{axis}"}
            fields[f"sigma_angle_{axis}"] = (("y", "x"), sigma, about)
        kept = {name: slopes.attrs[name] for name in ("name", "design", "frame", "removed") if name in slopes.attrs}
        result: xarray.Dataset = library.Dataset(fields, coords={"x": slopes["x"], "y": slopes["y"]}, attrs=kept)
        result["flag"] = slopes["flag"]
        own = self.folder / "angles.nc"
        if own.is_file():
            more = read_netcdf(own)
            result = result.assign({name: (("y", "x"), one.values, one.attrs) for name, one in more.items()})
            result.attrs |= more.attrs
        return result

    @property
    def height(self) -> "xarray.DataArray":
        """Height of the surface over the frame of the slope map [m]; NaN where it was not measured."""
        if "height" not in self.slope_map:
            raise InputError(f"{self.folder}: no heights were found from these slopes (slope_map.nc has none)")
        return self.slope_map["height"]

    def plot(self, quantity: str | None = None) -> "Figure":
        """Draw a result.

        Parameters
        ----------
        quantity : str, optional
            What of a slope map: "slope_error", "slope_error_x", "slope_x", "sigma_slope_x", "height" and the like, or
            of the `angles`: "angle_x", "theta_r". Without it the slope error (of a trough with slopes across only
            that in x), and the main picture of a result without a slope map.

        Returns
        -------
        matplotlib.figure.Figure
            A figure, to be changed or saved: ``result.plot("height").savefig("height.png")``.

        Raises
        ------
        InputError
            A quantity that the result does not have, or a kind without a picture.
        """
        view = self._picture()
        if not hasattr(view, "figure"):
            raise InputError(f"{self.folder}: results of the kind {self.kind!r} have no picture; see `tables`")
        from heliogauge.view.maps import MapView

        if isinstance(view, MapView):
            keys = [layer.key for layer in view.layers]
            if quantity is None and "slope_error" in keys:
                quantity = "slope_error"
            if quantity is not None and quantity not in keys and self._has_map():
                view = replace(view, layers=(*view.layers, *self._angle_layers()))
            drawn: Figure = view.figure(quantity)
            return drawn
        if quantity is not None:
            raise InputError(f"quantity {quantity!r}: results of the kind {self.kind!r} have one picture only")
        figure: Figure = view.figure()
        return figure

    def _angle_layers(self) -> "Iterator[MapLayer]":
        from heliogauge.view.maps import MapLayer

        for name, angle in self.angles.items():
            if angle.attrs.get("units") == "rad" and bool(angle.notnull().any()):
                is_sigma, title = str(name).startswith("sigma_"), str(angle.attrs["long_name"])
                unit, factor = ("\u00b5rad", 1e6) if is_sigma else ("mrad", 1e3)
                low = 0.0 if is_sigma else None
                title = title[0].upper() + title[1:]
                yield MapLayer(str(name), title, unit, angle.values, factor, diverging=not is_sigma, low=low)

    def _has_map(self) -> bool:
        return (self.folder / SLOPE_MAP_FILE).is_file()

    def _picture(self) -> Any:
        """Return the view that shows the result best; None where its kind has none."""
        with explain_faults(self.folder, _NEEDED):
            return self._view()

    def _view(self) -> Any:
        if self._has_map():
            from heliogauge.results.slope_map_file import read_slope_map
            from heliogauge.view.maps import slope_map_view

            return slope_map_view(read_slope_map(self.folder / SLOPE_MAP_FILE), self.name)
        from heliogauge.instruments import instruments
        from heliogauge.reporting.build import first_picture

        has_report = any(self.kind in one.reports for one in instruments())
        return first_picture(self.folder) if has_report else None

    def _repr_html_(self) -> str:
        """Show headline numbers with sigma, doubts and the picture."""
        shown = self._main_numbers()
        rows = "".join(
            f'<tr><td style="text-align:left"><code>{html.escape(key)}</code></td><td>{html.escape(text)}</td></tr>'
            for key, text in shown[:_MOST_NUMBERS]
        )
        more = len(shown) - _MOST_NUMBERS
        note = f"<p>{more} more numbers in <code>.summary</code></p>" if more > 0 else ""
        return (
            f"<div><h4>{html.escape(self.name)}</h4><p>{html.escape(self.kind)} result; heliogauge "
            f"{html.escape(self._summary.version)}</p>{self._doubts_html()}<table><tbody>{rows}</tbody></table>{note}"
            f"{self._picture_html()}</div>"
        )

    def _main_numbers(self) -> list[tuple[str, str]]:
        from heliogauge.reporting.notation import number_text
        from heliogauge.results.folder import unit_of

        numbers, reasons = self._summary.numbers, self._summary.not_determined
        shown = []
        for key, value in numbers.items():
            if key.startswith("sigma_") and key.removeprefix("sigma_") in numbers:
                continue
            name, unit = unit_of(key)
            sigma = numbers.get(f"sigma_{key}")
            text = f"not determined: {reasons.get(key, '')}" if value is None else number_text(value, sigma, unit, name)
            shown.append((key, text))
        return shown

    def _doubts_html(self) -> str:
        if not self.doubts:
            return ""
        first = [(html.escape(one.severity), html.escape(one.text)) for one in self.doubts[:_MOST_DOUBTS]]
        items = "".join(f"<li><b>{severity}</b>: {text}</li>" for severity, text in first)
        more = len(self.doubts) - _MOST_DOUBTS
        return f"<ul>{items}{f'<li>{more} more in <code>.doubts</code></li>' if more > 0 else ''}</ul>"

    def _picture_html(self) -> str:
        try:
            view = self._picture()
        except InputError as error:
            # A result that is shown in a notebook must not fail for a picture.
            return f"<p>no picture: {html.escape(str(error))}</p>"
        return "" if view is None else str(view._repr_html_())

    def save(self, out: str | Path, *, force: bool = False) -> Path:
        """Copy the folder of results.

        Parameters
        ----------
        out : str or Path
            Where it shall stand; whole or not there.
        force : bool
            Replace earlier results.

        Returns
        -------
        Path
            The new folder.

        Raises
        ------
        InputError
            Something stands there already, or it cannot be written.
        """
        out = Path(out)
        with ResultFolder(out, force=force) as working:
            shutil.copytree(self.folder, working, dirs_exist_ok=True)
        return out

    def report(self) -> Path:
        """Make report.html in the folder of results, again if it is there.

        Returns
        -------
        Path
            The file.

        Raises
        ------
        InputError
            Results of this kind have no report, or a file is missing or damaged.
        """
        from heliogauge.reporting.build import build_report

        return build_report(self.folder)

    def __repr__(self) -> str:
        """Show name, the first numbers with their sigmas, and doubts."""
        numbers = self._summary.numbers
        main = [(key, value) for key, value in numbers.items() if value is not None and not key.startswith("sigma_")]
        shown = []
        for key, value in main[:4]:
            sigma = numbers.get(f"sigma_{key}")
            shown.append(f"  {key} = {value:.6g}" + ("" if sigma is None else f" +- {sigma:.2g}"))
        shown += [f"  {one.severity}: {one.text}" for one in self.doubts[:3]]
        more = [f"  ... and {len(self.doubts) - 3} more doubts"] if len(self.doubts) > 3 else []
        return "\n".join([f"<{self.kind} result of {self.name!r}>", *shown, *more])


def _remove(folder: Path, process: int) -> None:
    """Remove a temporary folder, but not from a copy of the process that made it."""
    if os.getpid() == process:
        shutil.rmtree(folder, ignore_errors=True)
