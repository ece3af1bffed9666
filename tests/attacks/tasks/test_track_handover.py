"""Windows of tracks around rotations: people who cross, hide, come and go."""

import numpy as np
import pytest
from helpers.patrols import patrol_past, straight_walks

from attacks.tasks.task_list import TASKS
from attacks.tasks.track_handover import MISSING, track_handover
from isac_track.config import LinkageSettings
from isac_track.tracking.detections import CLUTTER
from isac_track.tracking.sharing import SharedTracks
from isac_track.types import Release

TASK = TASKS["handover-1s"]
SETTINGS = LinkageSettings(
    handover_period_s=6.0, handover_window_s=3.0, handover_least_s=1.0
)
# Rotations are at 6, 12, 18, 24 and 30 s; the silence lasts 1 s.
WALKS = straight_walks(
    (0, 40, (0, 0), (0.2, 0)),
    (0, 40, (8, 0), (-0.2, 0)),
    (0, 40, (0, 5), (0.2, 0)),
    (0, 40, (8, 5), (-0.2, 0)),
    (15, 40, (0, 9), (0.1, 0)),
    (0, 20, (9, 9), (0.1, 0)),
)
AT_S = (6.0, 12.0, 18.0, 24.0, 30.0)


@pytest.fixture(scope="module")
def patrol():
    return patrol_past(WALKS, (4, 4))


def rows_of(patrol, person, first_s=0.0, last_s=40.0):
    row = np.arange(*patrol.people.offsets[person : person + 2])
    t = patrol.people.t[row]
    return row[(t >= first_s - 1e-9) & (t <= last_s + 1e-9)]


def shared(patrol, tracks, *, person=None):
    """Tracks of the true samples with these numbers; a person each may be named."""
    sample = np.concatenate([np.array(row) for row in tracks])
    offsets, people = np.cumsum([0, *map(len, tracks)]), patrol.people
    scan = patrol.scan[sample]
    behind = np.searchsorted(people.offsets, sample, side="right") - 1
    return SharedTracks(
        release=Release(
            t=people.t[sample],
            xy=people.xy[sample],
            sigma=np.full(sample.size, 0.01),
            offsets=offsets,
            pseudonym=tuple(map(str, range(len(tracks)))),
        ),
        variance=np.full(sample.size, 1e-4),
        scan=scan,
        confirmed=scan[offsets[:-1]],
        last=scan[offsets[1:] - 1],
        person=behind if person is None else person(behind, people.t[sample]),
    )


def whole(patrol):
    return [rows_of(patrol, person) for person in range(6)]


def handover(patrol, tracks):
    return track_handover(TASK, patrol, tracks, settings=SETTINGS, seed=0)


def linkable(result):
    """Whether each person can be linked at each rotation, by (rotation, person)."""
    trials = result.trials
    places = zip(trials.rotation.tolist(), trials.person.tolist(), strict=True)
    return dict(zip(places, trials.is_linkable.tolist(), strict=True))


def test_perfect_tracks_are_linkable_where_people_are_on_both_sides(patrol):
    result = handover(patrol, shared(patrol, whole(patrol)))
    # The fifth comes at 15 s, the sixth goes at 20 s.
    expected = {
        (number, person)
        for number, at_s in enumerate(AT_S)
        for person in range(6)
        if not (person == 4 and at_s < 16) and not (person == 5 and at_s > 18)
    }
    assert linkable(result) == dict.fromkeys(sorted(expected), True)
    task_windows = result.task_windows
    probe, gallery = result.releases
    for row in range(len(task_windows.probe)):
        t = probe.t[probe.offsets[row] : probe.offsets[row + 1]]
        at_s = AT_S[int(task_windows.search_names[task_windows.probe.search[row]])]
        assert at_s - 3.0 - 1e-6 <= t.min()
        assert t.max() <= at_s + 1e-6
        mate = task_windows.mate[row]
        t = gallery.t[gallery.offsets[mate] : gallery.offsets[mate + 1]]
        assert at_s + 1.0 - 1e-6 <= t.min()
        assert t.max() <= at_s + 4.0 + 1e-6
        assert task_windows.gallery.person[mate] == task_windows.probe.person[row]
        assert task_windows.gallery.search[mate] == task_windows.probe.search[row]
    np.testing.assert_array_equal(task_windows.probe.xy, probe.xy)


def test_two_people_who_swap_in_the_silence_are_linked_to_the_other_track(patrol):
    swapped = [
        np.concatenate([rows_of(patrol, a, 0, 18.5), rows_of(patrol, b, 18.55, 40)])
        for a, b in ((0, 1), (1, 0))
    ]
    result = handover(patrol, shared(patrol, [*swapped, *whole(patrol)[2:]]))
    assert all(linkable(result).values())
    # The track goes on with somebody else; the mate is where the person is.
    task_windows = result.task_windows
    for row in np.flatnonzero(task_windows.probe.person < 2):
        assert (
            task_windows.gallery.person[task_windows.mate[row]]
            == task_windows.probe.person[row]
        )


def test_a_window_that_two_people_share_evenly_has_no_owner(patrol):
    def mixed(person, t):
        # In the 3 s before 18 s the first two tracks hold either person half the time.
        is_mixed = (t > 15.0) & (t <= 18.0) & (person < 2)
        odd = np.rint(t / 0.1).astype(int) % 2 == 1
        return np.where(is_mixed & odd, 1 - person, person)

    result = handover(patrol, shared(patrol, whole(patrol), person=mixed))
    can = linkable(result)
    lost = {place for place, is_linkable in can.items() if not is_linkable}
    assert lost <= {(2, 0), (2, 1)}
    # Counted, though nobody can link them: the denominator is that of perfect tracks.
    assert (
        can.keys() == linkable(handover(patrol, shared(patrol, whole(patrol)))).keys()
    )


def test_an_occluded_or_dead_track_counts_as_a_lost_trial(patrol):
    tracks = whole(patrol)
    # The third person is hidden from 5 to 9 s and comes back as another track; the
    # track of the fourth dies at 23.5 s.
    tracks[2] = rows_of(patrol, 2, 0, 5.0)
    tracks[3] = rows_of(patrol, 3, 0, 23.5)
    tracks.append(rows_of(patrol, 2, 9.0, 40.0))
    can = linkable(handover(patrol, shared(patrol, tracks)))
    lost = {place for place, is_linkable in can.items() if not is_linkable}
    assert lost == {(0, 2), (3, 3), (4, 3)}


def test_of_several_windows_of_a_person_the_one_with_most_samples_is_linked(patrol):
    row = rows_of(patrol, 2)
    tracks = [*whole(patrol), row[1::3]]
    tracks[2] = np.setdiff1d(row, row[1::3])
    result = handover(patrol, shared(patrol, tracks))
    assert all(linkable(result).values())
    sizes = np.diff(result.releases[0].offsets)
    person = result.task_windows.probe.person
    for number in np.unique(result.task_windows.probe.search):
        is_own = (result.task_windows.probe.search == number) & (person == 2)
        mated = is_own & (result.task_windows.mate != MISSING)
        assert is_own.sum() == 2
        assert sizes[mated].item() == sizes[is_own].max()


def test_tracks_of_nobody_are_candidates_without_a_mate(patrol):
    def nobody(person, _t):
        return np.where(person == 3, CLUTTER, person)

    result = handover(patrol, shared(patrol, whole(patrol), person=nobody))
    assert not any(ok for (_, person), ok in linkable(result).items() if person == 3)
    task_windows = result.task_windows
    nobody_row = len(patrol.people)
    assert (task_windows.gallery.person == nobody_row).sum() == len(AT_S)
    assert (task_windows.mate[task_windows.probe.person == nobody_row] == MISSING).all()
    assert not task_windows.trained_on[:, nobody_row].any()


def test_without_tracks_all_trials_are_lost(patrol):
    tracks = shared(patrol, [rows_of(patrol, 0, 0.0, 3.0)])
    result = handover(patrol, tracks)
    assert result.task_windows is None
    assert result.trials.person.size > 20
    assert not result.trials.is_linkable.any()
