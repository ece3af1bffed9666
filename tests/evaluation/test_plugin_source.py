"""A plug-in's source is its module and what it imports from beside itself; nothing else is."""

import sys

import pytest

from evaluation.experiment.fingerprint import source_digest

FILES = {
    "solo.py": "import os\nimport numpy\nfrom helper_a import f\n",
    "helper_a.py": "def f():\n    import helper_b\n",
    "helper_b.py": "FACTOR = 1\n",
    "stranger.py": "FACTOR = 1\n",
    "kit/__init__.py": "from kit import base\n",
    "kit/base.py": "from .deep import core as c\n",
    "kit/deep/__init__.py": "",
    "kit/deep/core.py": "from .. import side\n",
    "kit/side.py": "X = 1\n",
    "kit/unused.py": "X = 1\n",
    "kit/plugin.py": "import kit.deep\n",
    "broken.py": "def (\n",
    "circle.py": "import circle, circle_2\n",
    "circle_2.py": "import circle\n",
}


@pytest.fixture
def folder(tmp_path, monkeypatch):
    for name, text in FILES.items():
        path = tmp_path / name
        path.parent.mkdir(exist_ok=True, parents=True)
        path.write_text(text)
    monkeypatch.syspath_prepend(str(tmp_path))
    yield tmp_path
    for name in [name for name in sys.modules if name.partition(".")[0] == "kit"]:
        del sys.modules[name]


@pytest.mark.parametrize(
    ("module", "changes", "stays"),
    [
        ("solo", ["solo.py", "helper_a.py", "helper_b.py"], ["stranger.py", "kit/base.py"]),
        (
            "kit.plugin",
            ["kit/plugin.py", "kit/__init__.py", "kit/base.py", "kit/deep/core.py", "kit/side.py"],
            ["kit/unused.py", "solo.py"],
        ),
        ("broken", ["broken.py"], ["solo.py"]),
        ("circle", ["circle.py", "circle_2.py"], ["solo.py"]),
    ],
)
def test_what_it_is_made_of(folder, module, changes, stays):
    before = source_digest(module)
    assert source_digest(module) == before
    for names, is_part in ((changes, True), (stays, False)):
        for name in names:
            path = folder / name
            text = path.read_text()
            path.write_text(f"{text}# changed\n")
            assert (source_digest(module) != before) is is_part, name
            path.write_text(text)


def test_reading_imports_runs_nothing(folder):
    (folder / "helper_a.py").write_text("raise SystemExit(1)\n")
    source_digest("solo")
    assert "helper_a" not in sys.modules


def test_an_installed_module_is_its_own_package_alone(folder, monkeypatch):
    monkeypatch.setattr("sysconfig.get_paths", lambda: {"purelib": str(folder)})
    before = source_digest("solo"), source_digest("kit.plugin")
    (folder / "helper_a.py").write_text("X = 2\n")
    assert source_digest("solo") == before[0]
    (folder / "kit" / "base.py").write_text("X = 2\n")
    assert source_digest("kit.plugin") != before[1]


def test_what_has_no_file_is_nothing(monkeypatch):
    monkeypatch.setattr(sys.modules["__main__"], "__spec__", None)  # as of a script
    assert source_digest("sys") == source_digest("builtins") == source_digest("__main__")
