"""The channel of linkage tasks: one process a walk and session, however it is cut."""

from itertools import pairwise

import numpy as np
import pytest
from helpers.cells import STAGES
from helpers.walkers import walkers

from attacks.tasks.build import make_task_windows
from attacks.tasks.controls import CONTROLS
from attacks.tasks.task_list import TASKS
from evaluation.compute.link_setup import sense_task
from isac_track.resample import walk

HANDOVERS = ("handover-1s", "handover-2s", "handover-5s")
CLEAR = {  # Of the error nothing but distance and large-scale gain is left.
    "sensing.beam_fluctuation_db": 0.0,
    "sensing.n_paths": 1,
    "sensing.sigma_cap_m": 1e6,
    "sensing.decorrelation_m": np.inf,
}


def sensed(name, **changes):
    stages = STAGES.changed(changes)
    task_windows = make_task_windows(
        TASKS[name], tracks=walkers(), stages=stages, seed=0
    )
    return task_windows, sense_task(
        task_windows, groups=(), stages=stages, seed=0
    ).sensed


def levels(name):
    """By side: the log of each window's noise without the distance, and its person."""
    task_windows, sides = sensed(name, **CLEAR)
    station_m = np.array([STAGES.sensing.bs_x_m, STAGES.sensing.bs_y_m])
    windows_by_side = zip(
        sides, (task_windows.probe, task_windows.gallery), strict=True
    )
    whose = []
    for side, windows in windows_by_side:
        far_m = np.hypot(*(windows.xy - station_m).T)
        level = np.log(side.sigma_raw) - STAGES.sensing.path_loss_exponent * np.log(
            far_m
        )
        own = {task_windows.source[item]: set() for item in windows.person.tolist()}
        for row, (lo, hi) in zip(
            windows.person.tolist(), pairwise(windows.offsets), strict=True
        ):
            own[task_windows.source[row]] |= set(np.round(level[lo:hi], 9).tolist())
        whose.append(own)
    return whose


@pytest.mark.parametrize("name", ["split", *HANDOVERS])
def test_a_gain_that_never_forgets_is_one_of_a_walk_on_both_sides_and_at_every_instant(
    name,
):
    probe, gallery = levels(name)
    both = probe.keys() & gallery.keys()
    assert len(both) > 20
    for item in both:
        assert len(probe[item] | gallery[item]) == 1
    assert len(set.union(*probe.values())) == len(probe)
    # What the walk keeps is evidence.
    assert not CONTROLS["noise_level"].audits(TASKS[name])


@pytest.mark.parametrize("name", ["rerelease", "new_traversal"])
def test_at_another_time_it_is_drawn_anew(name):
    probe, gallery = levels(name)
    assert probe.keys() == gallery.keys()
    for person, own in probe.items():
        assert len(own) == len(gallery[person]) == 1
        assert not own & gallery[person]
    assert CONTROLS["noise_level"].audits(TASKS[name])


def test_no_draw_depends_on_the_gap():
    """Before the gap all is the same; after it, each instant of a walk has one value."""
    windows = []
    for name in HANDOVERS:
        task_windows, sides = sensed(name)
        keys = zip(
            task_windows.probe.person.tolist(),
            task_windows.probe.search.tolist(),
            strict=True,
        )
        each = {
            (
                task_windows.source[row],
                task_windows.search_names[number],
            ): side.xy.tobytes()
            for (row, number), side in zip(keys, sides[0], strict=True)
        }
        windows.append(each)
    common = windows[0].keys() & windows[1].keys() & windows[2].keys()
    assert len(common) > 20
    for key in common:
        assert windows[0][key] == windows[1][key] == windows[2][key]


@pytest.mark.parametrize("name", ["rerelease", "split", "handover-2s"])
def test_how_far_somebody_walked_does_not_depend_on_where_a_window_is_cut(name):
    tracks = walkers()
    task_windows, _ = sensed(name)
    row = {source: place for place, source in enumerate(tracks.source)}
    for windows in (task_windows.probe, task_windows.gallery):
        for number, place in enumerate(windows.person[:6].tolist()):
            whole = tracks[row[task_windows.source[place]]]
            part = slice(*windows.offsets[number : number + 2])
            # The length of the way on a clock a hundred times as fine.
            t = np.linspace(whole.t[0], whole.t[-1], 30_000)
            steps_m = np.hypot(*np.diff(walk(whole)(t), axis=0).T)
            way_m = np.interp(windows.t[part], t, np.append(0.0, np.cumsum(steps_m)))
            assert windows.walked_m[part] == pytest.approx(way_m, rel=0.01, abs=0.02)
