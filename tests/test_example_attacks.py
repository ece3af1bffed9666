"""The package of further attacks: made of stable names, and known where it is missed."""

import ast
import re
import tomllib
from importlib import import_module
from pathlib import Path

import pytest

from isac_track import plugins
from isac_track.errors import SettingsError

ROOT = Path(__file__).parent.parent
PACKAGE = ROOT / "examples" / "attacks"
SOURCES = sorted(PACKAGE.rglob("*.py"))
OURS = ("isac_track", "predictors", "attacks", "evaluation")
NAMES = ("fusion", "imm_rts", "posterior")


def stable_modules():
    """The modules of the table of stable names."""
    page = (ROOT / "docs" / "reference" / "api.md").read_text(encoding="utf-8")
    return set(re.findall(r"^\| \[`([\w.]+)`\]", page, re.MULTILINE))


def unstable_imports(source):
    """Names of the project that a source imports and that are not stable."""
    wrong, stable = [], stable_modules()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            wrong += [item.name for item in node.names if is_ours(item.name)]
        elif isinstance(node, ast.ImportFrom) and is_ours(node.module):
            public = ()
            if node.module in stable:
                public = import_module(node.module).__all__
            names = {item.name for item in node.names}.difference(public)
            wrong += {f"{node.module}.{name}" for name in names} - stable
    return wrong


def is_ours(module):
    return module.partition(".")[0] in OURS


@pytest.mark.parametrize("path", SOURCES, ids=lambda path: path.name)
def test_an_import_from_the_project_is_a_stable_name(path):
    assert unstable_imports(path.read_text(encoding="utf-8")) == []


@pytest.mark.parametrize(
    "source",
    [
        "import attacks.remembered",
        "from attacks.linkage.dtw import DTW",
        "from isac_track.types import squared_lengths",
        "def late():\n    from isac_track import plugins",
    ],
)
def test_a_planted_private_import_is_detected(source):
    assert len(unstable_imports(source)) == 1


def test_the_package_offers_what_the_hint_promises():
    text = (PACKAGE / "pyproject.toml").read_text(encoding="utf-8")
    points = tomllib.loads(text)["project"]["entry-points"]["isac_track.attacks"]
    assert tuple(sorted(points)) == NAMES
    for name, origin in points.items():
        module, _, attribute = origin.partition(":")
        source = PACKAGE.joinpath(*module.split(".")).with_suffix(".py")
        assert f"\nclass {attribute}:\n" in source.read_text(encoding="utf-8")
        if name not in plugins.names("attacks"):
            with pytest.raises(
                SettingsError, match=r"pip install \./examples/attacks$"
            ):
                plugins.parse("attacks", name)


def test_a_nearly_right_name_is_still_answered_with_the_nearest_built_in():
    with pytest.raises(SettingsError, match="did you mean 'kalman_rts'"):
        plugins.parse("attacks", "kalman_rst")
