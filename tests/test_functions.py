"""A function fits a screen, and a memo says at its door what it holds."""

import ast
import re
from pathlib import Path

import isac_track

ROOT = Path(isac_track.__file__).parent.parent
PACKAGES = ("isac_track", "attacks", "predictors", "evaluation")
MOST_LINES = 60
REASONS = {
    "evaluation/design.py:_parser": "an option after another",
    "evaluation/api/running.py:run": "an option after another, and their words",
    "isac_track/datasets/crowd/model.py:_advance": "a step reads as its equations",
}
"""Functions that may be longer. Compiled loops may: each call in them costs."""


def body_lines(function):
    """The lines of a function, its arguments among them, without its docstring."""
    lines = function.end_lineno - function.lineno + 1
    first = function.body[0]
    if ast.get_docstring(function) is not None:
        lines -= first.end_lineno - first.lineno + 1
    return lines


def long_functions():
    """Functions over the limit outside compiled loops, by file and name."""
    for package in PACKAGES:
        for path in sorted((ROOT / package).rglob("*.py")):
            if "_loop" in path.name:
                continue
            for node in ast.walk(ast.parse(path.read_text("utf-8"))):
                is_function = isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)
                if is_function and body_lines(node) > MOST_LINES:
                    yield f"{path.relative_to(ROOT)}:{node.name}"


def test_a_function_that_is_too_long_is_noticed():
    source = "def first():\n" + 4 * "    pass\n" + "def second():\n    '''Say.'''\n"
    first, second = ast.parse(source).body
    assert (body_lines(first), body_lines(second)) == (5, 1)


def test_no_body_is_longer_than_a_screen_without_a_reason():
    assert set(long_functions()) == REASONS.keys()


def memos_without_a_door():
    """Functions with a memo and no comment above it, by file and name."""
    for package in PACKAGES:
        for path in sorted((ROOT / package).rglob("*.py")):
            lines = path.read_text("utf-8").splitlines()
            for node in ast.walk(ast.parse("\n".join(lines))):
                for decorator in getattr(node, "decorator_list", ()):
                    if re.match(r"(lru_)?cache\b", ast.unparse(decorator)):
                        above = lines[node.decorator_list[0].lineno - 2]
                        beside = lines[decorator.lineno - 1]
                        if "#" not in above + beside:
                            yield f"{path.relative_to(ROOT)}:{node.name}"


def test_every_memo_says_at_its_door_what_it_holds():
    assert not list(memos_without_a_door())
