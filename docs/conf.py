"""Settings of the documentation site: `.ci/docs` builds it, and any warning fails it."""

from isac_track import __version__

project = "isac-track"
author = "The isac-track authors"
project_copyright = "2026, the isac-track authors"
version = release = __version__
extensions = [
    "myst_nb",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinx_copybutton",
]
exclude_patterns = ["_build"]
default_role = "literal"  # a single backtick in a docstring is code
autodoc_typehints = "signature"
autodoc_member_order = "bysource"
autodoc_default_options = {"members": True, "show-inheritance": False}
myst_enable_extensions = ["colon_fence"]
myst_fence_as_directive = ["math"]
myst_heading_anchors = 3
nb_execution_mode = "off"  # `.ci/docs` executes the notebooks before it builds
html_theme = "furo"
html_title = "isac-track"
