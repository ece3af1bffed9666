"""Settings of the documentation site: `.ci/docs` builds it, and any warning fails it."""

import re
from typing import Any

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
autodoc_default_options = {"members": True}
# A signature shows the name of an alias, not what it stands for.
autodoc_type_aliases = {
    name: name for name in ("Floats", "Ints", "Bools", "ErrorLaw", "Adding")
}
python_maximum_signature_line_length = 88
napoleon_use_ivar = True
myst_enable_extensions = ["colon_fence"]
myst_fence_as_directive = ["math"]
myst_heading_anchors = 3
nb_merge_streams = True
nb_execution_mode = "off"  # `.ci/docs` executes the notebooks before it builds
html_theme = "furo"
html_title = "isac-track"


_FORWARD = re.compile(r"TypeAliasForwardRef\('(\w+)'\)")


def _plain_signature(*event: str | None) -> tuple[str | None, str | None]:
    """Return a signature and its result type with the bare names of aliases."""
    signature, result = event[-2:]
    return (
        signature and _FORWARD.sub(r"\1", signature),
        result and _FORWARD.sub(r"\1", result),
    )


def setup(app: Any) -> None:  # noqa: ANN401 - Sphinx's application
    """Connect what Sphinx calls while it builds."""
    app.connect("autodoc-process-signature", _plain_signature)
