"""Sphinx configuration; the build uses nothing but the source tree and the installed packages."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from heliogauge import __version__
from heliogauge.instruments import every_kind
from heliogauge.measurement.key_tables import key_pages
from heliogauge.measurement.templates import write_template

sys.path.insert(0, str(Path(__file__).resolve().parent))
from face_pages import list_facts, write_reference

# The pages on measurement files show the templates that `heliogauge init` writes, not copies that could grow old.
write_template("deflectometry", Path(__file__).resolve().parent / "_build", force=True)
write_template("response", Path(__file__).resolve().parent / "_build" / "response", force=True)

# Every key of every kind, as the models have it that check the file.
(Path(__file__).resolve().parent / "_build" / "keys.md").write_text(key_pages(every_kind().values()), encoding="utf-8")

# The reference lists the public faces as they are.
write_reference(Path(__file__).resolve().parent / "api.md")

project = "heliogauge"
copyright = "the heliogauge contributors"
release = __version__
extensions = ["sphinx.ext.autodoc", "sphinx.ext.autosummary", "sphinx.ext.mathjax", "numpydoc", "myst_parser"]
exclude_patterns = ["_build"]
templates_path = ["_templates"]
myst_heading_anchors = 3
myst_enable_extensions = ["dollarmath"]
# The pages of the source tree that are included here link to each other by file name; those links work on disk.
suppress_warnings = ["myst.xref_missing"]

autosummary_generate = True
autosummary_ignore_module_all = False
autodoc_default_options = {"members": True, "show-inheritance": True}
autodoc_typehints = "none"
numpydoc_show_class_members = False
numpydoc_xref_param_type = False

html_theme = "alabaster"
html_theme_options = {"description": "Metrology of solar mirrors", "fixed_sidebar": True, "page_width": "1100px"}
html_show_sourcelink = False


def setup(app):
    """Let Sphinx show short docstrings as lists; those with numpydoc's sections stay as they are."""

    def show_facts(app, what, name, value, options, lines):
        if not any(set(line) == {"-"} for line in lines):
            lines[:] = list_facts(lines)

    app.connect("autodoc-process-docstring", show_facts, priority=100)
