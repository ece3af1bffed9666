"""Data flows in a single direction: folders import only lower ones, without circles."""

import ast
import re
from functools import cache
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

import isac_track

ROOT = Path(isac_track.__file__).parent.parent
COMMANDS = "evaluation"
ORDER = (
    COMMANDS,
    "evaluation.api",
    "evaluation.reporting",
    "evaluation.verdict",
    "evaluation.estimates",
    "evaluation.pool",
    "evaluation.store",
    "evaluation.compute",
    "evaluation.plan",
    "attacks",
    "predictors",
    "isac_track",
)
"""A layer imports only from itself and those below it; see docs/explanation/architecture.md."""
SIDE_BY_SIDE = {"attacks": {"predictors"}}
"""Layers that import nothing from each other."""

INTRODUCED = (
    "evaluation/reporting",
    "evaluation/verdict",
    "evaluation/estimates",
    "evaluation/pool",
    "evaluation/store",
    "evaluation/compute",
    "evaluation/plan",
    "attacks/tasks",
    "isac_track/patrols",
    "isac_track/tracking",
    "isac_track/mechanisms",
)
"""Folders whose docstring introduces each of their files."""


def find_layer(module):
    """The layer of a module: the longest name in ORDER that it starts with."""
    fitting = [
        name for name in ORDER if module == name or module.startswith(f"{name}.")
    ]
    return max(fitting, key=len, default=None)


@cache
def imported_names(source):
    """Every name that a source imports: at the top, in functions, for types only."""
    names = []
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            names += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, "imports are absolute"
            # `from package import module` names a module, `from module import thing`
            # does not.
            names += [f"{node.module}.{alias.name}" for alias in node.names]
    return names


def project_imports(source, *, modules):
    """Every module of the project that a source imports."""
    for name in imported_names(source):
        module = name if name in modules else name.rpartition(".")[0]
        if module in modules:
            yield module


def read_tree(root):
    """The source of every module of the four packages, by its name."""
    tree = {}
    for package in ("evaluation", "attacks", "predictors", "isac_track"):
        for path in sorted((root / package).rglob("*.py")):
            parts = path.relative_to(root).with_suffix("").parts
            name = ".".join(parts[:-1] if parts[-1] == "__init__" else parts)
            tree[name] = path.read_text(encoding="utf-8")
    return tree


def upward_imports(tree):
    """Imports from a layer above or beside, as `importer -> imported`."""
    wrong = []
    for module, source in tree.items():
        layer = find_layer(module)
        for other in project_imports(source, modules=tree.keys()):
            other_layer = find_layer(other)
            is_above = ORDER.index(other_layer) < ORDER.index(layer)
            is_beside = other_layer in SIDE_BY_SIDE.get(layer, ())
            # The package itself only names the modules of its four names.
            if (is_above or is_beside) and module != "evaluation":
                wrong.append(f"{module} -> {other}")
    return sorted(set(wrong))


def find_circle(tree):
    """Modules that import each other, directly or by others; none without a circle."""
    graph = {
        module: set(project_imports(source, modules=tree.keys()))
        - {module, "evaluation"}
        for module, source in tree.items()
        if module != "evaluation"
    }
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        return set(error.args[1])
    return set()


@pytest.fixture(scope="module")
def tree():
    return read_tree(ROOT)


def test_no_import_goes_upward_imports(tree):
    assert len(tree) > 100
    assert upward_imports(tree) == []


def test_no_module_imports_itself_by_a_detour(tree):
    assert find_circle(tree) == set()


def test_a_planted_fault_of_either_kind_is_detected(tree):
    first = {"predictors.first": "def late():\n    from evaluation.store import second"}
    second = {
        "evaluation.store.second": "if TYPE_CHECKING:\n    import predictors.first"
    }
    planted = tree | first | second
    assert upward_imports(planted) == ["predictors.first -> evaluation.store.second"]
    assert find_circle(planted) == {*first, *second}


@pytest.mark.parametrize("folder", INTRODUCED)
def test_the_docstring_of_a_folder_introduces_each_of_its_files(folder):
    package = ROOT / folder
    docstring = ast.get_docstring(ast.parse((package / "__init__.py").read_text()))
    introduced = set(re.findall(r"`(\w+)(?:\.\w+)?`", docstring))
    files = {path.stem for path in package.glob("*.py")} - {"__init__"}
    assert files - introduced == set()
