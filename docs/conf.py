"""Configuration of the documentation; `make docs` builds it in out/docs without a network."""

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
suppress_warnings = ["ref.python"]  # attributes of different classes can have the same name
exclude_patterns = ["_build", "notebooks/solutions", "**/.ipynb_checkpoints", "api/modules.rst"]

html_theme = "furo"
html_static_path: list[str] = []
html_copy_source = False
html_show_copyright = False

myst_enable_extensions = ["amsmath", "dollarmath", "colon_fence"]
myst_heading_anchors = 3

# The notebooks are stored without outputs and executed for every build: a cache would not detect
# changes of the library.
nb_execution_mode = "force"
nb_execution_timeout = 180
nb_execution_raise_on_error = True
nb_merge_streams = True
# Widgets load JavaScript from the web; the explorables also have an HTML form, which does not.
nb_mime_priority_overrides = [("html", "text/html", 5)]

# The reference: one page per public module, generated at every build.
apidoc_modules = [
    {
        "path": str(HERE.parent / "sfmkit"),
        "destination": "api",
        "exclude_patterns": ["**/cli/**", "**/datasets/demo/**"],
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
napoleon_use_ivar = True  # list attributes once, in the docstring of their class
add_module_names = False


def _plain(app, what, name, obj, options, lines: list[str]) -> None:
    """Escape stars and bars, which are mathematics in docstrings, as in (*B, N, 2) or |t|."""
    for i, line in enumerate(lines):
        parts = re.split(r"(``.*?``)", line)
        lines[i] = "".join(
            p if p.startswith("``") else re.sub(r"([*|])", r"\\\1", p) for p in parts
        )


def _skip(app, what, name, obj, skip, options) -> bool | None:
    """Skip `sfmkit.datasets.pairs`: a site cannot describe a function and a module of one name."""
    return (
        True
        if getattr(obj, "__qualname__", "") == "pairs" and obj.__module__ == "sfmkit.datasets"
        else None
    )


def setup(app) -> None:
    app.connect("autodoc-process-docstring", _plain, priority=400)  # before napoleon
    app.connect("autodoc-skip-member", _skip)
