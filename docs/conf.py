"""Sphinx's configuration of the documentation; ``make docs`` builds it."""

from __future__ import annotations

import sys
from importlib.metadata import version as version_of
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent / "_ext"))

project = "NLOS lab"
copyright = "the authors of NLOS lab, GPL-3.0-or-later"
version = release = version_of("nlos-lab")

extensions = [
    "myst_nb",
    "numpydoc",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx_copybutton",
    "sphinx_design",
    "sphinxarg.ext",
    "from_code",
    "results_table",
    "mathml",
]
exclude_patterns = ["_ext", "**/.ipynb_checkpoints"]
nitpicky = True

# Pages
smartquotes = False  # it would turn the dashes of options into one long dash
highlight_language = "none"
myst_enable_extensions = ["colon_fence", "deflist", "dollarmath"]
myst_heading_anchors = 3
default_role = "code"  # docstrings name code between single backticks

# Notebooks are run at every build, and an exception in one fails it.
nb_execution_mode = "force"
nb_execution_raise_on_error = True
nb_execution_timeout = 900  # seconds for a cell, on a machine with other work
nb_merge_streams = True

# Public interface
add_module_names = False
toc_object_entries_show_parents = "hide"
autodoc_member_order = "bysource"
autodoc_typehints = "none"  # docstrings say types with shapes and units
autosummary_generate = False  # a page a package, in place of one a name
numpydoc_show_class_members = False
numpydoc_class_members_toctree = False

# Links from the pages to outside are tried by `make linkcheck`, which needs the network.
linkcheck_timeout = 20
linkcheck_retries = 2

copybutton_prompt_text = r"\$ |>>> |\.\.\. "
copybutton_prompt_is_regexp = True
copybutton_only_copy_prompt_lines = True

html_theme = "pydata_sphinx_theme"
html_title = f"{project} {release}"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_math_renderer = "mathml"
html_show_sourcelink = False
html_copy_source = False
html_sidebars = {"index": [], "tutorial": [], "glossary": [], "architecture": []}
html_theme_options = {
    "show_prev_next": False,
    "secondary_sidebar_items": ["page-toc"],
    "footer_start": ["copyright"],
    "footer_end": [],
    "navbar_end": ["theme-switcher"],
    "navigation_with_keys": False,
    "header_links_before_dropdown": 6,
    "show_toc_level": 2,
}
