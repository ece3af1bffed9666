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


_ARRAY = r"[~\w.]*ndarray\[tuple\[[~\w.]*Any, \.\.\.\], [~\w.]*dtype\[[~\w.]*{}\]\]"
_ALIASES = {
    r"TypeAliasForwardRef\('(\w+)'\)": r"\1",
    _ARRAY.format("float64"): "Floats",
    _ARRAY.format("int64"): "Ints",
    _ARRAY.format("bool"): "Bools",
}
"""What Sphinx writes for an alias of a type, and the name of the alias."""


def _plain(text: str | None) -> str | None:
    """Return a signature with the names of aliases instead of what they stand for."""
    for written, name in _ALIASES.items():
        text = text and re.sub(written, name, text)
    return text


def _plain_signature(*event: str | None) -> tuple[str | None, str | None]:
    """Return the signature and the type of the result of an object, in plain names."""
    signature, result = event[-2:]
    return _plain(signature), _plain(result)


def setup(app: Any) -> None:  # noqa: ANN401 - Sphinx's application
    """Connect what Sphinx calls while it builds."""
    app.connect("autodoc-process-signature", _plain_signature)
