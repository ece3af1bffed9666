"""Names say what a value is: words that hide it are refused in the sources."""

import ast
from pathlib import Path

import pytest

import isac_track

ROOT = Path(isac_track.__file__).parent.parent
PACKAGES = ("isac_track", "attacks", "predictors", "evaluation")
REFUSED = {
    "one",
    "of",
    "found",
    "what",
    "who",
    "told",
    "kept",
    "mine",
    "alike",
    "gone",
}
"""The words of the style page: none is a name, or a part of a name that hides it."""
# Within a longer name these may be plain: `one_to_one`, `sum_of_squares`.
PLAIN_WITHIN = {"one", "of", "what"}


def hides_meaning(name):
    """Whether a name is a refused word, or begins or ends as `told_of` and `one_row`."""
    parts = name.lower().strip("_").split("_")
    if len(parts) == 1:
        return parts[0] in REFUSED
    is_dangling = "of" in (parts[0], parts[-1])
    is_counted = parts[0] == "one" and parts[1:] not in (["to", "one"], ["hot"])
    return is_dangling or is_counted or bool((REFUSED - PLAIN_WITHIN) & set(parts))


def bound_names(tree):
    """Yield each name that a source binds, with its line."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            yield node.id, node.lineno
        elif isinstance(node, ast.arg):
            yield node.arg, node.lineno
        elif isinstance(node, ast.FunctionDef | ast.ClassDef | ast.AsyncFunctionDef):
            yield node.name, node.lineno


@pytest.mark.parametrize(
    "name",
    ["one", "found", "told_of", "of_100", "levels_of", "one_row", "_kept", "who_knows"],
)
def test_a_name_that_hides_its_meaning_is_noticed(name):
    assert hides_meaning(name)


@pytest.mark.parametrize("name", ["one_to_one", "sum_of_squares", "whole", "level"])
def test_plain_names_pass(name):
    assert not hides_meaning(name)


def test_names_in_the_sources_say_what_they_are():
    hidden = [
        f"{path.relative_to(ROOT)}:{line} {name}"
        for package in PACKAGES
        for path in sorted((ROOT / package).rglob("*.py"))
        for name, line in bound_names(ast.parse(path.read_text("utf-8")))
        if hides_meaning(name)
    ]
    assert not hidden
