"""The results of any instrument as one view of their folder."""

import os
import shutil
import weakref
from collections.abc import Iterator, Mapping
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from heliogauge.doubts import Doubt
from heliogauge.errors import InputError
from heliogauge.results.folder import SUMMARY_FILE, ResultFolder, Summary, read_summary

if TYPE_CHECKING:
    import pandas
    import xarray


class Tables(Mapping[str, Any]):
    """The CSV tables of a folder by their names without ending, each read when it is asked for."""

    def __init__(self, folder: Path) -> None:
        self._files = {file.stem: file for file in sorted(folder.glob("*.csv"))}

    def __getitem__(self, name: str) -> "pandas.DataFrame":
        """Read a table."""
        if name not in self._files:
            raise InputError(f"table {name!r} is not among the results; there are: {', '.join(self._files) or 'none'}")
        import pandas

        return pandas.read_csv(self._files[name])

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
    """

    def __init__(self, folder: str | Path, *, temporary: bool = False) -> None:
        self.folder = Path(folder).expanduser().absolute()
        self.tables = Tables(self.folder)
        if temporary:
            # Tables outlive the view that they were taken from.
            weakref.finalize(self.tables, _remove, self.folder, os.getpid())
        if not (self.folder / SUMMARY_FILE).is_file():
            raise InputError(f"{self.folder}: {_what_instead(self.folder)}")
        self._summary: Summary = read_summary(self.folder / SUMMARY_FILE)
        self.kind, self.name = self._summary.kind, self._summary.name

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
        file = self.folder / "slope_map.nc"
        if not file.is_file():
            raise InputError(f"{self.folder}: results of the kind {self.kind!r} have no slope map (slope_map.nc)")
        import xarray

        return xarray.load_dataset(file, engine="h5netcdf")

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


def _what_instead(folder: Path) -> str:
    """Say why a folder is not one of results."""
    if not folder.is_dir():
        return "there is no such folder"
    if (folder / "measurement.toml").is_file():
        return "a measurement, not results; evaluate it with `hg.measure` or on the command line first"
    return f"no results, for there is no {SUMMARY_FILE} in it"
