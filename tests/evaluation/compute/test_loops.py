"""The loops that are compiled ahead of the cells are those that the cells call."""

import pytest

from evaluation.api import run
from evaluation.compute import loops
from evaluation.compute.loops import (
    COMPILED,
    COMPILING,
    LOADED,
    list_loops,
    prepare_loop_in_steps,
)
from evaluation.plan.axes import expand_axes
from evaluation.plan.settings import Settings
from isac_track import compiling


def crossed_cells(crossed):
    """Every level of some axes with each of its consumers, those of tasks included."""
    return [
        (level, item)
        for level in crossed.mechanisms
        for item in (*crossed.scenes.consumers, *crossed.linkage.all_consumers)
    ]


def test_a_quick_run_calls_no_loop_that_is_not_compiled_ahead(
    csv_recording, tmp_path, monkeypatch
):
    called, call = set(), compiling.Loop.__call__

    def noted(loop, *arguments):
        called.add(f"{loop.function.__module__}:{loop.function.__name__}")
        return call(loop, *arguments)

    monkeypatch.setattr(compiling.Loop, "__call__", noted)
    levels = ("raw", "fid:1", "ou:0.4")
    settings = Settings(
        dataset=str(csv_recording), scenes=8, mechanisms=levels, tasks=(), jobs=1
    )
    run(settings, out=tmp_path / "run", progress=False, pictures=False)
    assert called <= {*list_loops(crossed_cells(expand_axes(settings)))}


def test_the_slowest_to_compile_begin():
    names = [
        name.partition(":")[2]
        for name in list_loops(crossed_cells(expand_axes(Settings())))
    ]
    assert names[:3] == ["read_scores", "ratios", "described"]
    assert len(set(names)) == len(names)


def test_every_listed_loop_is_there():
    listed = {loops.GAIN, *loops._DESCRIPTORS, *loops._SCORECARD}
    listed |= {*loops._SLOW_ERROR_MECHANISM, *loops._SLOW_ERROR_ATTACK}
    by_reader = (loops._PLUGIN_LOOPS, loops._BEHIND_SLOW_ERROR, loops._BY_KIND)
    for some in (names for table in by_reader for names in table.values()):
        listed.update(some)
    for name in listed:
        module, _, loop = name.partition(":")
        result = compiling.loops_in(compiling.import_module(module))
        assert loop in {item.function.__name__ for item in result}, name


@pytest.mark.parametrize(
    ("is_cached", "fills_cache", "states"),
    [
        (True, False, [LOADED]),
        (False, True, [COMPILING, COMPILED]),
        (False, False, [COMPILING, LOADED]),
    ],
)
def test_a_loop_says_whether_it_is_compiled(
    is_cached, fills_cache, states, monkeypatch
):
    monkeypatch.setattr(compiling, "is_cached", lambda _: is_cached)
    monkeypatch.setattr(
        compiling, "prepare_loop", lambda _, *, quietly: fills_cache and quietly
    )
    assert [*prepare_loop_in_steps(loops.GAIN)] == states


def test_a_loop_that_cannot_be_compiled_is_left_to_the_cell_that_calls_it():
    assert [*prepare_loop_in_steps("isac_track._gain_loop:nothing")] == [LOADED]
