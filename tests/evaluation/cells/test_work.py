"""What levels have in common is computed once, and is what computing each would give."""

from dataclasses import fields, replace

import numpy as np
import pytest
from helpers.cells import STAGES, Spy, World, parsed, plugin, sessions_of

from attacks.tasks.controls import CONTROLS
from attacks.tasks.task_list import TASKS
from evaluation.cells import work as work_module
from evaluation.cells.sharing import guarded, handed, release_digest, sees_release_alone
from evaluation.cells.work import Block, LinkWork, cells
from evaluation.experiment.axes import axes
from evaluation.experiment.settings import Settings
from isac_track.scenes import cut, track_order
from isac_track.types import Release

ALIKE = ("fid:1", "fid:1.001", "fixed:0.75")
"""Their releases are the same bit for bit: so near 1, eta lets nothing through."""


@pytest.fixture(params=["scenes", "task"])
def piece(request, tracks):
    known, task = cut(tracks, settings=STAGES, seed=0), TASKS["rerelease"]
    if request.param == "scenes":
        consumers = axes(Settings(attacks=("identity", "kalman_rts"), tasks=())).consumers
    else:
        attacks = ("shape", "histogram", "histogram@kalman_rts")
        consumers = axes(Settings(attacks=attacks, tasks=(task.name,))).readers(task)
    levels = tuple((parsed("mechanisms", spec), consumers) for spec in (*ALIKE, "fixed:0.3"))
    if request.param == "task":
        return LinkWork(sessions_of(task.name), (), levels), known
    order = track_order(n_tracks=len(known), n_scenes=6, agents=4, seed=0)
    return Block(0, 0, order, levels), known


def test_levels_that_are_shared_alike_are_computed_once_and_the_same(piece, monkeypatch):
    work, tracks = piece
    once = list(cells(work, tracks=tracks, stages=STAGES, seed=0))
    monkeypatch.setattr(work_module, "sees_release_alone", lambda _: False)
    monkeypatch.setattr(work_module.linkage, "sees_times_alone", lambda *_: False)
    each = list(cells(work, tracks=tracks, stages=STAGES, seed=0))
    first = {one.label: tables for _, by, one, tables in once if by.spec == ALIKE[0]}
    n_shared = 0
    for (*_, by, one, tables), (*_, apart) in zip(once, each, strict=True):
        assert tables.keys() == apart.keys()
        for name, table in tables.items():
            assert table.to_pandas().equals(apart[name].to_pandas())
        is_first = by.spec == ALIKE[0]
        same = tables is first[one.label] and not is_first
        times_only = one.kind == "control" and CONTROLS[one.control].sees_times_only
        is_alike = by.spec in ALIKE[1:] and sees_release_alone(one)
        assert same == (is_alike or (times_only and not is_first))
        n_shared += same
    assert n_shared > 4


def test_who_may_draw_from_a_stream_of_the_level_or_knows_it_is_computed_for_each():
    settings = Settings(
        predictors=("least_squares", "kalman_cv:aware=true"),
        attacks=("identity", "shape", "histogram", "histogram@radial_rts"),
        tasks=("rerelease",),
    )
    crossed = axes(settings)
    consumers = (*crossed.consumers, *crossed.readers(TASKS["rerelease"]))
    alone = {one.label for one in consumers if sees_release_alone(one)}
    assert {"shared", "least_squares", "rerelease/windows", "rerelease/shape (blind)"} <= alone
    assert not any("aware" in label or "identity" in label or "control" in label for label in alone)
    for one in consumers:
        if "MECHANISM" in {what.name for what in one.granted}:
            assert one.label not in alone


def test_what_a_stranger_wrote_is_computed_for_each():
    crossed = axes(Settings(attacks=("shape",), tasks=("rerelease",)))
    (blind, *_) = (one for one in crossed.readers(TASKS["rerelease"]) if one.kind == "linkage")
    assert sees_release_alone(blind)
    for origin in ("mine:Shape", "attackers.shape:Shape"):
        theirs = replace(blind, plugin=replace(blind.plugin, origin=origin))
        assert not sees_release_alone(theirs)
        assert not sees_release_alone(replace(blind, behind=theirs.plugin))


def test_a_pseudonym_alone_makes_no_other_release():
    t, offsets = np.arange(4.0), np.array([0, 2, 4])
    one = Release(t, np.zeros((4, 2)), np.ones(4), offsets, ("a", "b"))
    assert release_digest(one) == release_digest(replace(one, pseudonym=("c", "d")))
    others = {"t": t + 1e-9, "xy": one.xy + 1e-12, "sigma": None, "offsets": np.array([0, 1, 4])}
    for name, changed in others.items():
        assert release_digest(replace(one, **{name: changed})) != release_digest(one), name


def test_a_plug_in_of_somebody_else_is_handed_a_copy_and_ours_the_very_object(tracks):
    batch = World(tracks, n_scenes=1).sensed
    for origin in ("isac_track.sharing:Raw", "attacks.linkage:Shape", "predictors.kalman:Kalman"):
        assert handed(batch, replace(plugin(Spy()), origin=origin)) is batch
    for origin in ("mine:Raw", "attackers.shape:Shape", "isac_tracks:Raw"):
        theirs = handed(batch, replace(plugin(Spy()), origin=origin))
        for item in fields(batch):
            ours, value = getattr(batch, item.name), getattr(theirs, item.name)
            assert np.array_equal(value, ours)
            if isinstance(ours, np.ndarray):
                assert not np.shares_memory(value, ours)
                assert not value.flags.writeable


def test_what_a_plug_in_sets_of_numpy_ends_with_its_call():
    guarded("it", lambda: np.seterr(all="raise"))
    assert np.geterr()["under"] == "ignore"
