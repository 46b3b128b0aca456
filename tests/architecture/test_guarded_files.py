"""Files are opened in one guarded way: `heliogauge.files` checks kind, size and content of what others wrote."""

import ast

import pytest

from tests.architecture.source_tree import all_modules

HOME = "heliogauge.files"
#: Modules that do open or decode something themselves, with the reason.
ALLOWED = {
    "heliogauge.images.photos": ("cv2.imdecode", "np.frombuffer"),  # bytes whose header was checked
    "heliogauge.images.thumbnails": ("cv2.imdecode", "np.frombuffer"),  # bytes whose header was checked
    "heliogauge.results.tables": ("np.frombuffer",),  # a text that was read
    "heliogauge.results.slope_map_file": ("h5py.File", "json.loads"),  # writes in memory; attributes of an open file
    "heliogauge.results.failure": ("cv2.imdecode", "np.frombuffer"),  # thumbnails that were made in this process
    "heliogauge.results.json_file": ("json.loads",),  # the name of a key that it writes
    "heliogauge.results.opened": ("pandas.read_csv",),  # bytes that were read
    "photogrammetry.exchange.colmap_files": ("np.frombuffer",),  # bytes that were read
    "calibration.camera.files.opencv_files": ("cv2.FileStorage",),  # a text that was read
    "calibration.heliostat.files.store_artist": ("h5py.File",),  # writes a file
    "calibration.heliostat.observations.rows": ("csv.reader",),  # one line of text
    "calibration.heliostat.files.store_heliostat": ("json.loads",),  # a text that was checked when it was read
}
#: Calls that open, decode or parse files. A method is looked for on any value.
CALLS = frozenset(
    {
        "open",
        "io.open",
        "os.open",
        "json.load",
        "json.loads",
        "tomllib.load",
        "tomllib.loads",
        "h5py.File",
        "h5py.is_hdf5",
        "xarray.open_dataset",
        "xarray.load_dataset",
        "xarray.open_datatree",
        "xarray.open_mfdataset",
        "xarray.open_dataarray",
        "cv2.imread",
        "cv2.imdecode",
        "cv2.imreadmulti",
        "cv2.VideoCapture",
        "cv2.FileStorage",
        "np.load",
        "np.genfromtxt",
        "np.loadtxt",
        "np.fromfile",
        "np.memmap",
        "np.frombuffer",
        "csv.reader",
        "csv.DictReader",
        "pandas.read_csv",
        "pandas.read_json",
        "pandas.read_hdf",
        "zipfile.ZipFile",
        "pickle.load",
        "pickle.loads",
        "runpy.run_path",
    }
)
METHODS = frozenset({"read_text", "read_bytes"})
#: Functions of libraries that open the containers of other programs by name, whatever the library is called.
CONTAINER_METHODS = frozenset(
    {
        "E57",
        "ImageFile",
        "VideoCapture",
        "Reconstruction",
        "load_dataset",
        "open_dataset",
        "load_mesh",
        "read_feather",
        "read_parquet",
        "read_point_cloud",
        "read_triangle_mesh",
        "read_triangle_model",
        "read_table",
        "read_hdf",
        "read_excel",
        "from_parquet",
    }
)
#: Functions of SQL that open files, and libraries that nothing but a door needs.
SQL_READERS = (
    "read_parquet(",
    "parquet_scan(",
    "read_csv(",
    "read_csv_auto(",
    "read_json(",
    "read_blob(",
    "read_text(",
)
CONTAINER_LIBRARIES = frozenset({"pye57", "h5netcdf"})
_SHORT = {"numpy": "np", "xr": "xarray", "pd": "pandas"}


def opened(tree: ast.Module) -> list[tuple[int, str]]:
    """Return line and name of each call that opens a file for reading."""
    found = []
    for node in ast.walk(tree):
        if not isinstance(node, ast.Call):
            continue
        name = ast.unparse(node.func)
        first, _, rest = name.partition(".")
        name = ".".join(filter(None, (_SHORT.get(first, first), rest)))
        method = name.rpartition(".")[2]
        # Files of the package itself are opened by importlib.resources.
        is_resource = "files(" in name
        modes = [one.value for one in [*node.args, *(k.value for k in node.keywords)] if isinstance(one, ast.Constant)]
        writes = any(isinstance(mode, str) and mode[:1] in ("w", "a", "x") for mode in modes)
        library = (
            node.args[0].value if method == "of_extra" and node.args and isinstance(node.args[0], ast.Constant) else ""
        )
        if method in CONTAINER_METHODS and "." in name and name not in CALLS:
            found.append((node.lineno, method))
        elif library in CONTAINER_LIBRARIES:
            found.append((node.lineno, f"of_extra({library})"))
        elif name in CALLS or ("." in name and method in METHODS and not is_resource):
            found.append((node.lineno, name if name in CALLS else method))
        elif method == "open" and "." in name and first != "webbrowser" and not writes and node.args:
            found.append((node.lineno, "open"))
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant) and isinstance(node.value, str):
            found += [(node.lineno, reader) for reader in SQL_READERS if reader in node.value]
    return found


def test_files_are_opened_in_the_guarded_room_only() -> None:
    breaches = [
        f"{module.path}:{line}: {name}: use heliogauge.files"
        for module in all_modules()
        if module.room != HOME and not module.name.startswith(HOME)
        for line, name in opened(module.tree)
        if name not in ALLOWED.get(module.name, ())
    ]
    assert not breaches, "\n".join(breaches)


def test_every_exception_is_used() -> None:
    unused = [
        f"{module.name}: {name}"
        for module in all_modules()
        for name in ALLOWED.get(module.name, ())
        if name not in {found for _, found in opened(module.tree)}
    ]
    assert not unused
    assert set(ALLOWED) <= {module.name for module in all_modules()}


def test_tables_are_written_in_one_place() -> None:
    """`heliogauge.results.tables` keeps texts of strangers from being formulas of a spreadsheet."""
    others = ("csv.writer", "csv.DictWriter", "to_csv", "savetxt")
    breaches = [
        f"{module.path}:{node.lineno}: use heliogauge.results.tables"
        for module in all_modules()
        for node in ast.walk(module.tree)
        if isinstance(node, ast.Call) and ast.unparse(node.func).endswith(others)
    ]
    assert not breaches, "\n".join(breaches)


@pytest.mark.parametrize(
    ("source", "names"),
    [
        ("json.loads(text)", ["json.loads"]),
        ("x = path.read_text(encoding='utf-8')", ["read_text"]),
        ("with open(path) as f: pass", ["open"]),
        ("with path.open('rb') as f: pass", ["open"]),
        ("with path.open('w') as f: pass", []),
        ("numpy.load(path)", ["np.load"]),
        ("xr.open_dataset(path)", ["xarray.open_dataset"]),
        ("files(home).joinpath(name).read_text()", []),
        ("read_text(path)", []),
        ("library.E57(str(file))", ["E57"]),
        ("of_extra('pye57')", ["of_extra(pye57)"]),
        ("of_extra('duckdb')", []),
        ("open3d.io.read_triangle_mesh(name)", ["read_triangle_mesh"]),
        ("connection.execute(f'SELECT * FROM read_parquet({files})')", ["read_parquet("]),
    ],
)
def test_the_search_itself(source: str, names: list[str]) -> None:
    assert [name for _, name in opened(ast.parse(source))] == names
