"""A cell depends on the code of its section and of its plug-ins, and on nothing else."""

import sys

import pytest
from helpers.runs import change_code

from evaluation.plan.axes import expand_axes
from evaluation.plan.fingerprint import (
    RECONSTRUCTION,
    SHARING,
    consumer_key,
    plugin_modules,
    section_modules,
)
from evaluation.plan.settings import Settings
from evaluation.plan.source_digest import source_digest

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
    "lazy.py": "def f():\n    import_module('isac_track.loops')\n",
    "isac_track/loops.py": "X = 1\n",
    "for_types.py": (
        "if TYPE_CHECKING:\n    import stranger\nelse:\n    import helper_b\n"
    ),
    "when_run.py": (
        "if not TYPE_CHECKING:\n    import helper_b\nelse:\n    import stranger\n"
    ),
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
        (
            "solo",
            ["solo.py", "helper_a.py", "helper_b.py"],
            ["stranger.py", "kit/base.py"],
        ),
        (
            "kit.plugin",
            [
                "kit/plugin.py",
                "kit/__init__.py",
                "kit/base.py",
                "kit/deep/core.py",
                "kit/side.py",
            ],
            ["kit/unused.py", "solo.py"],
        ),
        ("broken", ["broken.py"], ["solo.py"]),
        ("circle", ["circle.py", "circle_2.py"], ["solo.py"]),
        ("lazy", ["lazy.py", "isac_track/loops.py"], ["solo.py"]),
        ("for_types", ["for_types.py", "helper_b.py"], ["stranger.py"]),
        ("when_run", ["when_run.py", "helper_b.py"], ["stranger.py"]),
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
    monkeypatch.setattr("sysconfig.get_paths", lambda *_: {"purelib": str(folder)})
    before = source_digest("solo"), source_digest("kit.plugin")
    (folder / "helper_a.py").write_text("X = 2\n")
    assert source_digest("solo") == before[0]
    (folder / "kit" / "base.py").write_text("X = 2\n")
    assert source_digest("kit.plugin") != before[1]


SECTIONS = (SHARING, RECONSTRUCTION, "rerelease")
SOURCES = {
    SECTIONS: (
        "isac_track.sensing",
        "isac_track.datasets.read_table",
        "evaluation.compute.frames",
        "evaluation.compute.guards",
        "evaluation.compute.sharing",
        "isac_track.privacy",
        "isac_track.conflict",
    ),
    (SHARING,): ("evaluation.compute.forecasts",),
    (RECONSTRUCTION, "rerelease"): (
        "isac_track.kalman._linear_loops",
        "evaluation.plan.constants",
    ),
    ("rerelease",): (
        "isac_track.linkability._loops",
        "attacks.tasks.build",
        "evaluation.compute.link_scores",
        "evaluation.compute.link_tables",
        "evaluation.compute.window_tables",
    ),
    (): (
        "evaluation.plan.presets",
        "evaluation.plan.adversaries",
        "evaluation.plan.axes",
        "evaluation.plan.consumer",
        "evaluation.plan.fitted_data",
        "evaluation.plan.linkage_axes",
        "evaluation.plan.linkers",
        "evaluation.plan.patrol_axes",
        "evaluation.plan.scene_axes",
        "evaluation.plan.track_axes",
        "evaluation.plan.units",
        "evaluation.plan.user_plugins",
        "evaluation.plan.workers",
        "isac_track.plugins",
        "isac_track.testing.engine",
        "attacks.testing",
        "evaluation.reporting.figures.heat",
        "evaluation.estimates.summary",
        "evaluation.pool.execute",
    ),
}


@pytest.mark.parametrize(
    ("module", "sections"),
    [(module, sections) for sections, modules in SOURCES.items() for module in modules],
)
def test_a_section_is_computed_by_what_it_imports(monkeypatch, module, sections):
    def digests():
        return {
            section: [source_digest(source) for source in section_modules(section)]
            for section in SECTIONS
        }

    before = digests()
    change_code(monkeypatch, module)
    after = digests()
    changed = {section for section in SECTIONS if before[section] != after[section]}
    assert changed == set(sections)


def test_a_plug_in_is_its_own_code_and_nobody_elses(monkeypatch):
    crossed = expand_axes(
        Settings(attacks=("savgol", "kalman_rts", "shape@savgol", "shape"))
    )
    consumers = (*crossed.scenes.consumers, *crossed.linkage.all_consumers)

    def keys():
        return {
            consumer.label: consumer_key(
                consumer,
                code=[source_digest(name) for name in plugin_modules(consumer.plugins)],
                keep_scores=False,
            )
            for consumer in consumers
        }

    before = keys()
    assert len(set(before.values())) == len(consumers)
    change_code(monkeypatch, "attacks.reconstruction._window_loops")
    after = keys()
    changed = {
        label.partition(" ")[0] for label in before if before[label] != after[label]
    }
    assert changed == {"savgol", "rerelease/shape@savgol"}


def test_raw_scores_are_another_thing_to_keep():
    crossed = expand_axes(Settings(attacks=("savgol", "shape")))
    for item in (*crossed.scenes.consumers, *crossed.linkage.all_consumers):
        keys = {consumer_key(item, code=(), keep_scores=keep) for keep in (True, False)}
        assert len(keys) == 1 + (item.kind in ("linkage", "control"))
