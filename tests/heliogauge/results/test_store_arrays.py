"""Arrays with coordinates: what is read is what was written, by us and by others."""

import numpy as np
import pytest

from heliogauge.errors import InputError
from heliogauge.results.arrays import LabelledArray, read_arrays, write_arrays


def arrays() -> list[LabelledArray]:
    grid = np.arange(6.0).reshape(2, 3) * 1e-3
    grid[1, 1] = np.nan
    return [
        LabelledArray("y", ["y"], np.array([0.5, 1.5]), "m", "along"),
        LabelledArray("x", ["x"], np.array([-1.0, 0.0, 1.0]), "m", "across"),
        LabelledArray("theta", ["y", "x"], grid, "rad", "angle"),
        LabelledArray("seen", ["x"], np.array([1, 0, 1], dtype=np.uint8), "1", "whether"),
    ]


def test_round_trip(tmp_path) -> None:
    write_arrays(tmp_path / "a.nc", arrays(), {"sign": "positive towards +x", "edges": [1.0, 2.0]})
    found, attributes = read_arrays(tmp_path / "a.nc", ["theta"])
    for array in arrays():
        np.testing.assert_array_equal(found[array.name], array.values)
        assert found[array.name].dtype == array.values.dtype
    assert attributes["sign"] == "positive towards +x"
    assert attributes["edges"] == [1.0, 2.0]


def test_xarray_reads_names_units_and_missing_values(tmp_path) -> None:
    xarray = pytest.importorskip("xarray")
    write_arrays(tmp_path / "a.nc", arrays())
    with xarray.open_dataset(tmp_path / "a.nc", engine="h5netcdf") as data:
        assert data["theta"].dims == ("y", "x")
        assert data["theta"].attrs["units"] == "rad"
        assert float(data["theta"].sel(x=1.0, y=0.5)) == 0.002
        assert np.isnan(data["theta"].values[1, 1])


def test_axes_that_do_not_fit_and_missing_variables_are_refused(tmp_path) -> None:
    wrong = [*arrays()[:2], LabelledArray("theta", ["x", "y"], np.zeros((2, 3)), "rad", "angle")]
    with pytest.raises(InputError, match=r"theta has shape \(2, 3\), its axes x, y have \(3, 2\)"):
        write_arrays(tmp_path / "a.nc", wrong)
    write_arrays(tmp_path / "a.nc", arrays()[:2])
    with pytest.raises(InputError, match="the variables theta are missing"):
        read_arrays(tmp_path / "a.nc", ["theta"])
