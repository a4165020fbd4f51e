"""Sphinx configuration; built with -n -W, so a broken reference fails the build."""

from __future__ import annotations

import ufirext

project = "ufirext"
author = "The ufirext developers"
copyright = f"2026, {author}"
release = version = ufirext.__version__

extensions = [
    "myst_parser",
    "numpydoc",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.mathjax",
    "sphinx.ext.viewcode",
    "sphinx-mathjax-offline",  # MathJax ships with the pages; nothing is fetched when they are read
]
myst_enable_extensions = ["amsmath", "deflist", "dollarmath"]
myst_heading_anchors = 3
exclude_patterns = ["_build"]
templates_path = ["_templates"]

autosummary_generate = True
autodoc_typehints = "none"  # the docstrings say types, shapes and units
autodoc_preserve_defaults = True
maximum_signature_line_length = 88
numpydoc_show_class_members = False

html_theme = "furo"
html_title = f"ufirext {release}"
