"""Sphinx configuration; the build uses nothing but the source tree and the installed packages."""

import shutil
import sys
from importlib.util import find_spec
from pathlib import Path

DOCS = Path(__file__).resolve().parent
sys.path[:0] = [str(DOCS), str(DOCS.parent)]

from face_pages import list_facts, write_reference
from reference_pages import BUILT, write_reference_pages

from heliogauge import __version__
from heliogauge.instruments import every_kind
from heliogauge.measurement.templates import write_template

# What the code knows is written by the code: templates, keys, commands, doubts and public faces cannot grow old.
for kind in every_kind():
    write_template(kind, BUILT / "templates" / kind, force=True)
write_reference_pages()
write_reference(DOCS / "reference" / "api.md")

project = "heliogauge"
copyright = "the heliogauge developers"
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

# MathJax comes from an installed package: pages are read without a network. These parts of it are whole in themselves;
# the ready-made bundles look for speech rules elsewhere.
MATHJAX = ("startup.js", "core.js", "input/tex.js", "output/svg.js", "output/svg/fonts/tex.js")
mathjax_path = "mathjax/startup.js"
mathjax3_config = {"loader": {"load": ["core", "input/tex", "output/svg", "output/svg/fonts/tex"]}}

html_theme = "pydata_sphinx_theme"
html_title = "heliogauge"
html_theme_options = {
    "show_prev_next": False,
    "navigation_with_keys": False,
    "secondary_sidebar_items": ["page-toc"],
    "footer_start": ["copyright"],
    "footer_end": [],
}
html_static_path = ["_static"]
html_css_files = ["wide_tables.css"]
html_sidebars = {"index": []}
html_show_sourcelink = False


def setup(app):
    """Connect what Sphinx is to do beside its own steps."""
    # Short docstrings are shown as lists; those with numpydoc's sections stay as they are.
    app.connect("autodoc-process-docstring", show_facts, priority=100)
    app.connect("build-finished", copy_mathjax)


def show_facts(app, what, name, value, options, lines):
    """Turn short docstrings into lists."""
    if not any(set(line) == {"-"} for line in lines):
        lines[:] = list_facts(lines)


def copy_mathjax(app, failure):
    """Put MathJax beside the pages."""
    if failure is None and app.builder.format == "html":
        source = Path(find_spec("sphinx-mathjax-offline").submodule_search_locations[0]) / "static" / "mathjax"
        for name in MATHJAX:
            target = Path(app.outdir) / "_static" / "mathjax" / name
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(source / name, target)
