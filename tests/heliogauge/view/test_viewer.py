"""The viewer in a real browser: from the table of a folder to a map with all its nodes, and to a difference."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from heliogauge.results.folder import write_slope_map
from tests.heliogauge.view.served_results import serve, slope_map, write_result


@pytest.fixture
def page(chromium: Any) -> Any:
    context = chromium.new_context(viewport={"width": 1400, "height": 900})
    made = context.new_page()
    made.complaints = []
    made.on("console", lambda message: message.type == "error" and made.complaints.append(message.text))
    made.on("pageerror", lambda error: made.complaints.append(str(error)))
    yield made
    context.close()
    assert made.complaints == []


def test_from_a_folder_to_the_difference_of_two(page: Any, tmp_path: Path) -> None:
    write_result(tmp_path / "all" / "before", "Mirror 7", slope_map(), 2e-3)
    write_result(tmp_path / "all" / "after", "Mirror 7", slope_map(1e-3, seed=2), 1e-3)
    for asker in serve(tmp_path / "all"):
        page.goto(f"http://127.0.0.1:{asker.port}{asker.base}")
        page.get_by_role("columnheader", name="SDx").get_by_role("button").click()
        assert page.locator("tbody tr").first.locator("td").nth(1).text_content() == "after"
        page.get_by_label("before", exact=True).select_option("before")
        page.get_by_label("after", exact=True).select_option("after")
        page.get_by_role("button", name="Show the difference").click()
        page.locator(".view.alive").first.wait_for()
        assert page.title() == "Mirror 7 (after) minus Mirror 7 (before)"
        # The title may be there before the map's own controls are.
        page.get_by_label("Layer").first.locator("option", has_text="Difference of dz/dx").wait_for(state="attached")


@pytest.mark.slow
def test_the_pointer_meets_a_column_of_nodes_that_a_report_leaves_out(page: Any, tmp_path: Path) -> None:
    """A report keeps every second of 600 columns; number 67 is not among them."""
    one = slope_map(nodes=600)
    slopes = one.slope_x.copy()
    slopes[:, 67] = 7e-3
    write_slope_map(tmp_path / "slope_map.nc", {"": replace(one, slope_x=slopes)})
    for asker in serve(tmp_path / "slope_map.nc"):
        page.goto(f"http://127.0.0.1:{asker.port}{asker.base}")
        page.locator(".view.alive").wait_for()
        frame = page.locator(".view-figure").first.bounding_box()
        readout = page.locator(".view-readout").first
        # The axes begin within the first 100 px; the column lies at a ninth of them.
        places = np.arange(60, 0.3 * frame["width"], 0.5)
        seen = []
        for across in places:
            page.mouse.move(frame["x"] + across, frame["y"] + frame["height"] / 3)
            seen.append(readout.text_content())
            if "7.000 ± 0.020 mrad" in seen[-1]:
                break
        assert "7.000 ± 0.020 mrad" in seen[-1]
