"""The examples of the stable modules run, and each public name has a docstring."""

import doctest
import inspect
from importlib import import_module

import pytest

MODULES = (
    *("types", "protocols", "sharing", "privacy", "conflict", "linkability"),
    *("intervals", "rng", "testing"),
)
STABLE = {
    **{f"isac_track.{name}": None for name in MODULES},
    "isac_track.kalman": None,
    "attacks.building_blocks": None,
    "attacks.testing": ("kit_test", "run_checks"),
    "evaluation": ("Results", "Settings", "load", "run"),
}
"""By module: the names that are stable; None stands for all of `__all__`."""
LEAST_EXAMPLES = 12
OPTIONS = doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE


def public_objects():
    """Every stable function and class, by its full name."""
    for module_name, stable in STABLE.items():
        module = import_module(module_name)
        for name in stable or module.__all__:
            value = getattr(module, name)
            if inspect.isfunction(value) or inspect.isclass(value):
                yield f"{module_name}.{name}", value


def examples():
    """Every docstring with an example that runs."""
    finder = doctest.DocTestFinder()
    for name, value in public_objects():
        home = import_module(value.__module__)
        for test in finder.find(value, name, module=home, globs={}):
            if any(doctest.SKIP not in each.options for each in test.examples):
                yield test


EXAMPLES = list(examples())


def test_the_central_functions_have_examples():
    assert len({test.name for test in EXAMPLES}) >= LEAST_EXAMPLES


@pytest.mark.parametrize("example", EXAMPLES, ids=lambda test: test.name)
def test_an_example_prints_what_it_says(example):
    report = []
    doctest.DocTestRunner(optionflags=OPTIONS).run(example, out=report.append)
    assert report == []


@pytest.mark.parametrize("module_name", STABLE)
def test_public_names_exist(module_name):
    module = import_module(module_name)
    names = module.__all__
    assert len(set(names)) == len(names)
    assert [name for name in names if not hasattr(module, name)] == []
    assert set(STABLE[module_name] or names) <= set(names)


def test_public_functions_and_classes_have_docstrings():
    # A dataclass without a docstring gets its signature for one.
    bare = [
        name
        for name, value in public_objects()
        if not value.__doc__ or value.__doc__.startswith(f"{value.__name__}(")
    ]
    assert bare == []
