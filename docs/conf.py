"""Settings of the documentation site; ``make docs`` builds it without network, and a broken link is an error."""

from __future__ import annotations

import sys
from pathlib import Path

import pisplit

sys.path.insert(0, str(Path(__file__).resolve().parent))

project = "pisplit"
author = "the authors of pisplit"
version = release = pisplit.__version__
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "sphinx.ext.viewcode"]
extensions += ["docstrings", "pictures"]
html_theme = "furo"
html_title = f"pisplit {release}"
html_show_sourcelink = False
myst_heading_anchors = 4

# Types are those of the signatures; shapes, units and errors stand in the text.
autodoc_member_order = "bysource"
autodoc_default_options = {"members": True, "imported-members": True}
autodoc_typehints = "signature"
autodoc_typehints_format = "short"
autodoc_preserve_defaults = True
autodoc_type_aliases = {name: name for name in ("Array", "ArrayLike", "Index")}
autodoc_type_aliases |= {"Tension": "pisplit.models.rod.Tension"}  # an observable has the same name
python_use_unqualified_type_names = True
napoleon_numpy_docstring = False
