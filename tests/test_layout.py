"""Data flows one way: which folder may import which, and no file imports itself by a detour."""

import ast
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
"""Each imports only from itself and from what stands below it; docs/architecture.md draws it."""
SIDE_BY_SIDE = {"attacks": {"predictors"}}
"""Neither imports the other."""


def layer_of(module):
    """The layer that a module belongs to: the longest name in ORDER that it starts with."""
    fitting = [
        name for name in ORDER if module == name or module.startswith(f"{name}.")
    ]
    return max(fitting, key=len, default=None)


@cache
def names_imported(source):
    """Every name that a source imports: at the top, within functions, for types only."""
    found = []
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            found += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, "imports are absolute"
            # `from package import module` names a module, `from module import thing`
            # does not.
            found += [f"{node.module}.{alias.name}" for alias in node.names]
    return found


def imports_of(source, *, modules):
    """Every module of the project that a source imports."""
    for name in names_imported(source):
        found = name if name in modules else name.rpartition(".")[0]
        if found in modules:
            yield found


def read_tree(root):
    """The source of every module of the four packages, by its name."""
    tree = {}
    for package in ("evaluation", "attacks", "predictors", "isac_track"):
        for path in sorted((root / package).rglob("*.py")):
            parts = path.relative_to(root).with_suffix("").parts
            name = ".".join(parts[:-1] if parts[-1] == "__init__" else parts)
            tree[name] = path.read_text(encoding="utf-8")
    return tree


def against_the_order(tree):
    """Every import from a layer that stands above, as `importer -> imported`."""
    wrong = []
    for module, source in tree.items():
        mine = layer_of(module)
        for other in imports_of(source, modules=tree.keys()):
            its = layer_of(other)
            is_above = ORDER.index(its) < ORDER.index(mine)
            # The package itself only says where its four names are.
            if (
                is_above or its in SIDE_BY_SIDE.get(mine, ())
            ) and module != "evaluation":
                wrong.append(f"{module} -> {other}")
    return sorted(set(wrong))


def circle(tree):
    """Modules that import each other, directly or by a detour; none if there is no circle."""
    graph = {
        module: set(imports_of(source, modules=tree.keys())) - {module, "evaluation"}
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


def test_no_import_goes_against_the_order(tree):
    assert len(tree) > 100
    assert against_the_order(tree) == []


def test_no_module_imports_itself_by_a_detour(tree):
    assert circle(tree) == set()


def test_a_planted_fault_of_either_kind_is_found(tree):
    first = {"predictors.first": "def late():\n    from evaluation.store import second"}
    second = {
        "evaluation.store.second": "if TYPE_CHECKING:\n    import predictors.first"
    }
    planted = tree | first | second
    assert against_the_order(planted) == ["predictors.first -> evaluation.store.second"]
    assert circle(planted) == {*first, *second}
