"""Passages, circumstances, hidden frames, and scores that leave people out."""

from dataclasses import replace

import numpy as np
import pytest
from returning_crowds import returning_crowd

from attacks.linkage.gait import Gait
from attacks.tasks.passage_circumstances import CIRCUMSTANCES
from attacks.tasks.passage_releases import share_passages
from attacks.tasks.passage_scores import mated_passages, score_passages
from attacks.tasks.passages import find_passages
from attacks.tasks.return_study import crossing, study_returns
from isac_track.errors import DataError, SettingsError
from isac_track.intervals import Estimate
from isac_track.linkability.returns import Returning
from isac_track.types import Knowledge

SMALL = ((8, 2, 3.6), (10, 2, 4.5), (9, 1, 6.0))


def crowd(seed=0, **options):
    chosen = {"traits": 3.0, "is_order_kept": False, "sessions": SMALL, "n_people": 14}
    return returning_crowd(seed, **(chosen | options))


@pytest.fixture(scope="module")
def walks():
    return find_passages(crowd())


def test_short_passages_are_left_out_and_long_ones_cut():
    tracks = crowd()
    lasts_s = np.array([walk.t[-1] - walk.t[0] for walk in tracks])
    cut = find_passages(tracks, least_s=4.0, longest_s=5.0)
    assert len(cut) == (lasts_s >= 4.0).sum()
    spans_s = cut.t[cut.offsets[1:] - 1] - cut.t[cut.offsets[:-1]]
    assert spans_s.max() <= 5.0
    assert spans_s.max() > 4.9


def test_people_without_sessions_or_returns_are_refused():
    with pytest.raises(DataError, match="a person and a session"):
        find_passages(replace(crowd(), person=None))
    with pytest.raises(DataError, match="nobody walks in two"):
        find_passages(crowd(sessions=SMALL[:1]))
    with pytest.raises(DataError, match="of a single person"):
        find_passages(crowd(sessions=((1, 1, 3.6), (1, 1, 4.5)), n_people=1))


def test_circumstances_tell_the_queue(walks):
    assert set(walks.closeness) == set(CIRCUMSTANCES)
    place = walks.closeness["queue place"]
    same = walks.person[:, None] == walks.person
    here = walks.session[:, None] == walks.session
    assert not place[same & here].any()
    assert (place[~same & here] < 0).all()
    neighbours = walks.closeness["neighbours"]
    # The next passage of a session has the same neighbours, except at the ends.
    again = same & here & ~np.eye(len(walks), dtype=bool)
    assert neighbours[again].mean() > 1.5
    assert neighbours[~same & here].mean() < 0.5


def test_a_release_hides_frame_and_clock_and_depends_on_the_seed_alone(walks):
    release = share_passages(walks, error="0", seed=1)
    assert np.array_equal(release.xy, share_passages(walks, error="0", seed=1).xy)
    for row in range(len(walks)):
        part = slice(walks.offsets[row], walks.offsets[row + 1])
        assert np.diff(release.t[part]) == pytest.approx(np.diff(walks.t[part]))
        steps, shared = (np.diff(xy[part], axis=0) for xy in (walks.xy, release.xy))
        assert np.hypot(*shared.T) == pytest.approx(np.hypot(*steps.T), abs=1e-9)
    ahead = [walk.xy[-1] - walk.xy[0] for walk in release]
    turn = np.angle([x + 1j * y for x, y in ahead])
    assert np.abs(np.exp(1j * turn).mean()) < 0.4
    assert not set(release.pseudonym) & set(walks.source)


def test_errors_have_the_size_that_they_say(walks):
    clean = share_passages(walks, error="0")
    noisy = share_passages(walks, error="0.1")
    # A passage is shifted by the error of its first sample, which no frame shows.
    parts = np.split(noisy.xy - clean.xy, walks.offsets[1:-1])
    added = np.concatenate([part - part.mean(axis=0) for part in parts])
    assert np.sqrt((added**2).mean()) == pytest.approx(0.1, rel=0.05)
    raw = share_passages(walks, error="raw")
    assert len(raw) == len(walks)
    assert 8 < raw.t.size / walks.t.size * 25 < 16
    for wrong in ("-1", "nan", "much"):
        with pytest.raises(SettingsError, match="raw"):
            share_passages(walks, error=wrong)


class Spy:
    """A linker that notes on whom it learns: the lengths of their passages."""

    kind = "linkage"
    requires = frozenset({Knowledge.TRAIN})
    uses = frozenset()

    def fit(self, context):
        learnt = {walk.t.size for walk in context.train.probe}
        learnt |= {walk.t.size for walk in context.train.gallery}

        def link(probe, gallery):
            seen = any(walk.t.size in learnt for walk in probe)
            return np.full((len(probe), len(gallery)), float(seen))

        return link


def test_nobody_is_linked_by_what_was_learnt_on_them():
    # Lengths of passages are unique to each person here.
    tracks = crowd()
    sizes = 60 + np.unique(tracks.person, return_inverse=True)[1]
    parts = list(tracks)
    cut = [np.arange(size) for size in sizes]
    short = replace(
        tracks,
        t=np.concatenate([p.t[c] for p, c in zip(parts, cut, strict=True)]),
        xy=np.concatenate([p.xy[c] for p, c in zip(parts, cut, strict=True)]),
        offsets=np.append(0, np.cumsum(sizes)),
    )
    walks = find_passages(short, least_s=1.0)
    scored = score_passages(
        Spy(),
        share_passages(walks, error="0"),
        Returning(walks.person, walks.session, walks.returning),
        seed=0,
    )
    assert scored.shape == (walks.returning.size + 1, len(walks), len(walks))
    assert not scored.any()


def test_training_pairs_are_of_a_person_in_two_sessions(walks):
    release = share_passages(walks, error="0")
    may_train_on = walks.person != walks.returning[0]
    returning = Returning(walks.person, walks.session, walks.returning)
    train = mated_passages(release, returning, may_train_on)
    names = {name: row for row, name in enumerate(release.pseudonym)}
    first = [names[name] for name in train.probe.pseudonym]
    second = [names[name] for name in train.gallery.pseudonym]
    assert (walks.person[first] == walks.person[second]).all()
    assert (walks.session[first] < walks.session[second]).all()
    assert walks.returning[0] not in walks.person[first]
    assert set(walks.person[first]) == set(walks.returning[1:])


def test_a_study_is_repeatable_and_no_name_of_a_person_matters(walks):
    release = share_passages(walks, error="0")
    options = {"linkers": {"gait": Gait()}, "enrolled": (None,)}
    first = study_returns(walks, release, **options)
    renamed = replace(walks, people=tuple(f"F{k}" for k in range(len(walks.people))))
    again = study_returns(renamed, release, **options)
    assert first.primary.rank1.value == again.primary.rank1.value
    assert first.regression == again.regression
    assert first.decision == again.decision
    assert first.decision.decision == "not decided"
    assert "too few" in first.decision.why
    assert first.same_session.control.value > 0.9
    with pytest.raises(ValueError, match="no session"):
        study_returns(walks, release, confirming="run 9", **options)


def test_people_are_drawn_whole_where_scores_would_be_too_many(walks):
    most = (walks.returning.size + 1) * len(walks) ** 2 // 3
    drawn = find_passages(crowd(), most_scores=most)
    assert drawn.not_drawn > 0
    assert len(set(drawn.person)) + drawn.not_drawn == len(set(walks.person))
    assert (drawn.returning.size + 1) * len(drawn) ** 2 <= most
    rows = [walks.source.index(name) for name in drawn.source]
    assert (np.isin(walks.person, drawn.person).nonzero()[0] == rows).all()
    assert np.array_equal(drawn.person, walks.person[rows])
    for name in ("queue place", "neighbours"):
        part = walks.closeness[name][np.ix_(rows, rows)]
        assert np.array_equal(drawn.closeness[name], part)
    last = slice(walks.offsets[rows[-1]], walks.offsets[rows[-1] + 1])
    assert np.array_equal(drawn.xy[drawn.offsets[-2] :], walks.xy[last])
    assert set(find_passages(crowd(), most_scores=most, seed=1).source) != set(
        drawn.source
    )
    everybody = find_passages(crowd(), most_scores=10**9)
    assert everybody.source == walks.source
    assert everybody.not_drawn == 0


def test_a_draw_without_anybody_to_link_says_so():
    with pytest.raises(DataError, match=r"among those drawn.*nobody walks in two"):
        find_passages(crowd(), most_scores=1)
    tracks = crowd(sessions=((2, 1, 3.6), (2, 1, 4.5)), n_people=2)
    with pytest.raises(DataError, match=r"among those drawn.*a single person"):
        find_passages(tracks, most_scores=2 * 2**2)
    # Where nobody comes back the draw has nothing to do with it.
    with pytest.raises(DataError, match=r"^nobody walks in two"):
        find_passages(crowd(sessions=SMALL[:1]), most_scores=1)


def test_the_error_at_which_linkage_crosses_chance():
    errors_m = np.array([0.0, 0.05, 0.1])
    cells = [Estimate(0.4, low, 0.6) for low in (0.3, 0.2, 0.02)]
    chance = [0.05] * 3
    assert crossing(errors_m, cells, chance) == 0.1
    assert crossing(errors_m, cells[:2] * 2, [0.05] * 4) == np.inf
    assert crossing(errors_m, cells[2:] * 3, chance) == 0.0
