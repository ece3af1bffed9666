"""Tables that levels share are computed once, and equal those computed for each."""

from dataclasses import fields, replace

import numpy as np
import pytest
from helpers.cells import STAGES, Spy, World, make_task_windows, parsed, plugin

from attacks.tasks.controls import CONTROLS
from attacks.tasks.task_list import TASKS
from evaluation.compute import work as work_module
from evaluation.compute.guards import copy_for_user_plugin, guarded
from evaluation.compute.work import LinkWork, compute_cells
from evaluation.plan.axes import expand_axes
from evaluation.plan.settings import Settings
from isac_track.scenes import cut


@pytest.fixture
def piece(tracks):
    known, task = cut(tracks, settings=STAGES, seed=0), TASKS["rerelease"]
    attacks = ("shape", "histogram", "histogram@kalman_rts")
    crossed = expand_axes(Settings(attacks=attacks, tasks=(task.name,)))
    consumers = crossed.linkage.consumers(task)
    levels = tuple(
        (parsed("mechanisms", spec), consumers) for spec in ("fid:1", "fixed:0.3")
    )
    return LinkWork(make_task_windows(task.name), (), levels), known


def test_controls_of_times_alone_are_computed_once_and_the_same(piece, monkeypatch):
    work, tracks = piece
    once = list(compute_cells(work, tracks=tracks, stages=STAGES, seed=0))
    monkeypatch.setattr(work_module.linkage, "is_same_at_all_levels", lambda *_: False)
    each = list(compute_cells(work, tracks=tracks, stages=STAGES, seed=0))
    first = {
        consumer.label: tables
        for _, level, consumer, tables in once
        if level.spec == "fid:1"
    }
    n_shared = 0
    for (*_, level, consumer, tables), (*_, apart) in zip(once, each, strict=True):
        assert tables.keys() == apart.keys()
        for name, table in tables.items():
            assert table.to_pandas().equals(apart[name].to_pandas())
        same = tables is first[consumer.label] and level.spec != "fid:1"
        times_only = (
            consumer.kind == "control" and CONTROLS[consumer.control].sees_times_only
        )
        assert same == (times_only and level.spec != "fid:1")
        n_shared += same
    assert n_shared > 1


def test_a_plug_in_of_somebody_else_is_handed_a_copy_and_ours_the_very_object(tracks):
    batch = World(tracks, n_scenes=1).sensed
    for origin in (
        "isac_track.sharing:Raw",
        "attacks.linkage:Shape",
        "predictors.kalman:Kalman",
    ):
        assert (
            copy_for_user_plugin(batch, replace(plugin(Spy()), origin=origin)) is batch
        )
    for origin in ("mine:Raw", "attackers.shape:Shape", "isac_tracks:Raw"):
        theirs = copy_for_user_plugin(batch, replace(plugin(Spy()), origin=origin))
        for item in fields(batch):
            ours, value = getattr(batch, item.name), getattr(theirs, item.name)
            assert np.array_equal(value, ours)
            if isinstance(ours, np.ndarray):
                assert not np.shares_memory(value, ours)
                assert not value.flags.writeable


def test_what_a_plug_in_sets_of_numpy_ends_with_its_call():
    guarded("it", lambda: np.seterr(all="raise"))
    assert np.geterr()["under"] == "ignore"
