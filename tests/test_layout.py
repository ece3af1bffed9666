"""Data flows one way: which package may import which."""

import ast
from pathlib import Path

import pytest

import isac_track

ROOT = Path(isac_track.__file__).parent.parent
MAY_IMPORT = {
    "isac_track": set(),
    "predictors": {"isac_track"},
    "attacks": {"isac_track"},
    "evaluation": {"isac_track", "predictors", "attacks"},
}


def imported_packages(path):
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from (alias.name.partition(".")[0] for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.level == 0:
            yield node.module.partition(".")[0]


@pytest.mark.parametrize("package", MAY_IMPORT)
def test_a_package_imports_only_what_lies_upstream(package):
    files = sorted((ROOT / package).rglob("*.py"))
    assert files
    forbidden = MAY_IMPORT.keys() - MAY_IMPORT[package] - {package}
    wrong = {
        f"{path.name}: {name}"
        for path in files
        for name in imported_packages(path)
        if name in forbidden
    }
    assert wrong == set()
