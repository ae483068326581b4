"""The documentation site: `make docs` builds it into out/docs, off-line, and any warning fails
it."""

import re
from pathlib import Path

import sfmkit

HERE = Path(__file__).parent

project = "sfmkit"
author = "the sfmkit authors"
version = release = sfmkit.__version__
html_title = f"sfmkit {version}"

extensions = [
    "myst_nb",
    "sphinx.ext.apidoc",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinx.ext.mathjax",
    "sphinx-mathjax-offline",
]
suppress_warnings = ["ref.python"]  # an attribute's name may be that of another class's
exclude_patterns = ["_build", "notebooks/solutions", "**/.ipynb_checkpoints", "api/modules.rst"]

html_theme = "furo"
html_static_path: list[str] = []
html_copy_source = False
html_show_copyright = False

myst_enable_extensions = ["amsmath", "dollarmath", "colon_fence"]
myst_heading_anchors = 3

# They are stored without outputs, and run anew for every site: a cache would not notice that the
# library has changed.
nb_execution_mode = "force"
nb_execution_timeout = 180
nb_execution_raise_on_error = True
nb_merge_streams = True

# The reference: a page for each public module, written anew at every build.
apidoc_modules = [
    {
        "path": str(HERE.parent / "sfmkit"),
        "destination": "api",
        "exclude_patterns": ["**/commands/**", "**/cli.py", "**/demo/**"],
        "separate_modules": True,
        "module_first": True,
        "automodule_options": {"members", "show-inheritance"},
    }
]
autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_default_options = {"ignore-module-all": True}
autodoc_preserve_defaults = True
napoleon_google_docstring = True
napoleon_numpy_docstring = False
napoleon_use_ivar = True  # attributes of a class once, where it describes them
add_module_names = False


def _plain(app, what, name, obj, options, lines: list[str]) -> None:
    """Docstrings use no emphasis and no substitutions: their stars and bars are mathematics, as in
    (*B, N, 2) or |t|."""
    for i, line in enumerate(lines):
        parts = re.split(r"(``.*?``)", line)
        lines[i] = "".join(
            p if p.startswith("``") else re.sub(r"([*|])", r"\\\1", p) for p in parts
        )


def _skip(app, what, name, obj, skip, options) -> bool | None:
    """The function `sfmkit.datasets.pair` has the name of a module, and a site cannot describe
    both."""
    return (
        True
        if getattr(obj, "__qualname__", "") == "pairs" and obj.__module__ == "sfmkit.datasets"
        else None
    )


def setup(app) -> None:
    app.connect("autodoc-process-docstring", _plain, priority=400)  # before the sections are read
    app.connect("autodoc-skip-member", _skip)
