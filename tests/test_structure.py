"""The layout of the package: few modules at the top, no import circles, no upward imports."""

from __future__ import annotations

import subprocess
import sys
from graphlib import TopologicalSorter
from pathlib import Path

import grimp
import pytest

import sfmkit

ROOT = Path(__file__).parents[1]
PACKAGE = Path(sfmkit.__file__).parent


@pytest.fixture(scope="module")
def graph():
    return grimp.build_graph("sfmkit", exclude_type_checking_imports=True, cache_dir=None)


def test_few_modules_lie_directly_in_the_package():
    assert len(list(PACKAGE.glob("*.py"))) <= 10


def test_no_modules_import_each_other_in_a_circle(graph):
    """Imports inside functions count too."""
    imports = {
        module: graph.find_modules_directly_imported_by(module) - {"sfmkit"}
        for module in graph.modules
        if module != "sfmkit"
    }
    TopologicalSorter(imports).prepare()  # raises CycleError


def test_the_layers_of_pyproject_hold():
    command = [Path(sys.executable).with_name("lint-imports"), "--no-cache"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout


def test_no_package_uses_the_underscore_names_of_another():
    """Read from the source: names and modules that start with one underscore."""
    import ast

    found = []
    for path in sorted(PACKAGE.rglob("*.py")):
        package = path.relative_to(PACKAGE).parts[0]
        for node in ast.walk(ast.parse(path.read_text())):
            if not isinstance(node, ast.ImportFrom) or node.level < 2:
                continue
            parts = (node.module or "").split(".")
            other = node.level == len(path.relative_to(PACKAGE).parts) and parts[0] != package
            private = [n for n in [*parts[1:], *(a.name for a in node.names)] if _is_private(n)]
            if other and private:
                found.append(f"{path.relative_to(PACKAGE)}:{node.lineno} {node.module} {private}")
    assert not found, "\n".join(found)


def _is_private(name: str) -> bool:
    return name.startswith("_") and not name.startswith("__")


@pytest.mark.parametrize(
    "package", sorted(p.parent for p in PACKAGE.rglob("__init__.py")), ids=lambda p: p.name
)
def test_every_package_has_an_explicit_all(package):
    if package.name.startswith("_"):
        return
    assert "__all__" in (package / "__init__.py").read_text()
