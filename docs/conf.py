"""Sphinx configuration; built with -n -W, so a broken reference fails the build. Nothing is fetched."""

from __future__ import annotations

import sys
import warnings
from pathlib import Path

HERE = Path(__file__).parent
sys.path.append(str(HERE / "_extensions"))

import numpydoc.xref  # noqa: E402

import ufirext  # noqa: E402

project = "ufirext"
author = "The ufirext developers"
copyright = f"2026, {author}"
release = version = ufirext.__version__

extensions = [
    "myst_parser",
    "numpydoc",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.intersphinx",
    "sphinx.ext.mathjax",
    "sphinx.ext.viewcode",
    "sphinx-mathjax-offline",  # MathJax ships with the pages; nothing is fetched when they are read
    "sphinx_copybutton",
    "sphinx_gallery.gen_gallery",
    "sphinxcontrib.bibtex",
    "local_links",
    "measured",
]
exclude_patterns = [
    "_build",
    "_extensions",
    "generated/results.md",
    "inventories",
    "gallery/*.ipynb",
    "sg_execution_times.rst",
]
templates_path = ["_templates"]


myst_enable_extensions = ["amsmath", "deflist", "dollarmath"]
myst_heading_anchors = 3
math_eqref_format = "({number})"
math_numfig = False

autosummary_generate = True
autodoc_typehints = "none"  # the docstrings say types, shapes and units
autodoc_preserve_defaults = True
maximum_signature_line_length = 88
numpydoc_show_class_members = False
numpydoc_xref_param_type = True  # types in docstrings lead to the library's own names, and to no others
numpydoc_xref_ignore = "all"
numpydoc_xref_aliases = {name: f"ufirext.{name}" for name in ufirext.__all__}
numpydoc.xref.DEFAULT_LINKS.clear()

bibtex_bibfiles = ["references.bib"]
bibtex_default_style = "plain"
bibtex_reference_style = "author_year"

copybutton_prompt_text = r">>> |\.\.\. |\$ "
copybutton_prompt_is_regexp = True

# Inventories in the plain first format of Sphinx: the few names that these pages link to, readable in a diff.
intersphinx_mapping = {
    name: (address, f"inventories/{name}.txt")
    for name, address in {
        "python": "https://docs.python.org/3/",
        "numpy": "https://numpy.org/doc/stable/",
        "scipy": "https://docs.scipy.org/doc/scipy/",
        "filterpy": "https://filterpy.readthedocs.io/en/latest/",
        "control": "https://python-control.readthedocs.io/en/stable/",
    }.items()
}

warnings.filterwarnings("ignore", message="FigureCanvasAgg is non-interactive", category=UserWarning)
sphinx_gallery_conf = {
    "examples_dirs": "../examples",
    "gallery_dirs": "gallery",
    "filename_pattern": r"\.py$",  # every one is executed
    "ignore_pattern": r"__init__|sort_boxes",  # what others import
    "within_subsection_order": "gallery_order.Order",
    "download_all_examples": False,
    "show_signature": False,
    "show_memory": False,
    "write_computation_times": False,
    "notebook_extensions": set(),
    "remove_config_comments": True,
    "plot_gallery": True,
    "abort_on_example_error": False,  # all failures are told, and fail the build, at its end
    "matplotlib_animations": False,
    "reference_url": {"ufirext": None},
    "doc_module": ("ufirext",),
    "backreferences_dir": "generated/backreferences",
    "inspect_global_variables": False,
}

html_theme = "furo"
html_title = f"ufirext {release}"
html_static_path = ["_static"]
html_css_files = ["ufirext.css"]
html_copy_source = False
html_show_sourcelink = False
