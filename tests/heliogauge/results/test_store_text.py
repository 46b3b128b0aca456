"""Text of CSV and JSON files: what Python's own modules read back, whatever is in a cell."""

import csv
import json

import numpy as np
import pytest

from heliogauge.results.json_file import write_json
from heliogauge.results.tables import write_table_csv


def test_cells_are_those_of_the_csv_module(tmp_path):
    names = ["plain", 'quo"te', "com,ma", "two\nlines", "", "käse"]
    floats = [1.5, float("nan"), -0.0, 1e-300, 0.1 + 0.2, float("inf")]
    columns = {
        "name, unit": names,
        "x_m": np.array(floats),
        "n": np.arange(6),
        "is_on": np.array([True, False] * 3),
        "mixed": [None, 1, 1.0, "a,b", float("nan"), True],
    }
    columns["mixed"] = np.array(columns["mixed"], dtype=object)
    write_table_csv(tmp_path / "ours.csv", columns)
    lists = [np.asarray(column).tolist() for column in columns.values()]
    with (tmp_path / "theirs.csv").open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(columns)
        writer.writerows(["" if cell != cell else cell for cell in row] for row in zip(*lists, strict=True))
    assert (tmp_path / "ours.csv").read_bytes() == (tmp_path / "theirs.csv").read_bytes()


@pytest.mark.parametrize("column", [[], ["", "a"], [float("nan"), 1.0], [1, 2]])
def test_one_column_has_no_empty_lines(tmp_path, column):
    write_table_csv(tmp_path / "one.csv", {"only": column})
    with (tmp_path / "one.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.reader(file))
    assert rows == [["only"], *[["" if cell != cell else str(cell)] for cell in column]]


def test_json_is_read_back_and_keeps_lists_on_a_line(tmp_path):
    content = {
        "a": 1,
        "b": {"c": [1.5, None, True, "ä"], "d": {}, "e": {"f": [[1, 2], [3, 4]]}},
        "g": [],
        "h": [{"i": 1}, 2, {"j": {"k": ()}}],
        "l": np.array([[1.0, 2.0]]),
        "m": np.int64(3),
        2.5: "float",
        None: "nothing",
        True: "bool",
    }
    write_json(tmp_path / "one.json", content)
    text = (tmp_path / "one.json").read_text(encoding="utf-8")
    plain = content | {"l": [[1.0, 2.0]], "m": 3}
    assert json.loads(text) == json.loads(json.dumps(plain))
    assert '  "c": [1.5, null, true, "ä"],\n' in text
    assert text.startswith('{\n "a": 1,\n "b": {\n  "c"')
