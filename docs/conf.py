"""Settings of the manual: `python -m sphinx -W docs site`.

Pages are Markdown, and their code is run as they are read (`extension/executed_pages.py`); the
reference is made from docstrings. A block that fails and a link that leads nowhere are errors.
"""

import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE.parent), str(HERE / "extension")]

import casid  # noqa: E402

project = "casid"
author = "the casid developers"
copyright = "2026, the casid developers"
release = version = casid.__version__
extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "docstrings",  # before napoleon
    "example_links",
    "sphinx.ext.napoleon",
    "sphinx.ext.viewcode",
    "executed_pages",
]
source_suffix = {".md": "markdown"}
exclude_patterns = ["extension"]
myst_heading_anchors = 3

html_theme = "pydata_sphinx_theme"
html_title = f"casid {version}"
html_favicon = str(HERE / "_static" / "icon.svg")
html_static_path = ["_static"]
html_css_files = ["manual.css"]
html_js_files = ["manual.js"]
html_context = {"default_mode": "auto"}  # of light and dark, as the reader's system has it
html_show_sourcelink = False
html_copy_source = False
html_theme_options = {
    "logo": {"text": "casid"},
    "show_prev_next": True,
    "navigation_with_keys": True,
    "show_nav_level": 2,
    "navigation_depth": 3,
    "header_links_before_dropdown": 6,
    "secondary_sidebar_items": ["page-toc"],
    "footer_start": ["copyright"],
    "footer_end": [],
}
html_sidebars = {"index": []}

default_role = "code"
autodoc_member_order = "bysource"
autodoc_preserve_defaults = True
python_use_unqualified_type_names = True
napoleon_use_rtype = False
suppress_warnings = ["ref.python"]  # a name of several attributes in an annotation: no link
