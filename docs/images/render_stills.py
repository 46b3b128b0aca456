"""Put still pictures of a report side by side: ``python docs/images/render_stills.py RESULT OUT.svg WORDS...``.

WORDS are what the title of each picture begins with, such as "Sigma of lines of sight" "Radial distortion" of a camera,
"Network: x and z" "Image points in a cell" of a network, "Residuals of the beam against time" "Predicted uncertainty
over the sky" of a heliostat.
"""

import html
import re
import sys
from pathlib import Path
from urllib.parse import unquote

from heliogauge.reporting.build import build_report

_PICTURE = re.compile(r'<img alt="([^"]*)" src="data:image/svg\+xml,([^"]*)"')


def main(folder: str, out: str, *titles: str) -> None:
    """Write the pictures side by side as one."""
    page = build_report(Path(folder)).read_text(encoding="utf-8")
    found = {html.unescape(words): unquote(picture) for words, picture in _PICTURE.findall(page)}
    parts, x, height = [], 0, 0
    for title in titles:
        picture = next(picture for words, picture in found.items() if words.startswith(title))
        size = re.search(r"viewBox='0 0 (\d+) (\d+)'", picture)
        if size is None:
            raise SystemExit(f"{title}: no size")
        parts.append(picture.replace("<svg ", f"<svg x='{x}' ", 1))
        x, height = x + int(size[1]), max(height, int(size[2]))
    head = f"<svg xmlns='http://www.w3.org/2000/svg' viewBox='0 0 {x} {height}' width='{x}' height='{height}'>"
    white = "<rect width='100%' height='100%' fill='#fff'/>"
    Path(out).write_text(f"{head}{white}{''.join(parts)}</svg>\n", encoding="utf-8")


if __name__ == "__main__":
    main(*sys.argv[1:])
