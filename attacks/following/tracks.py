"""Follow people through the tracks of a network that breaks them and swaps people.

A track that goes on with another person leads the adversary astray without notice. At
the end of a track the adversary joins the next track by the place and the velocity that
motion predicts, as it joins answers to robots (`attacks.following.links`).
"""

from dataclasses import dataclass
from itertools import pairwise
from typing import Final, NamedTuple

import numpy as np

from attacks.following.chains import Chains, join
from attacks.following.links import (
    Links,
    candidate_links,
    entropy_bits,
    learn_weights,
    probabilities,
)
from attacks.following.logs import CONFUSED_BITS, Ending, first_half
from attacks.following.pieces import Pieces, end_states
from isac_track.patrols.patrol import Patrol
from isac_track.patrols.reports import Reports
from isac_track.tracking.detections import CLUTTER
from isac_track.tracking.sharing import SharedTracks
from isac_track.types import Bools, Floats, Ints, stretches

HELD_S: Final = 1.0  # A track holds who has most of its samples within so long.


@dataclass(frozen=True, eq=False, slots=True)
class TrackFollowing:
    """How long N people are followed through tracks, and B breaks of their tracks."""

    present_s: Floats  # (N,) between the first and the last sample of a walk.
    followed_s: Floats  # (N,) longest time within one chain that holds the person.
    until_s: Floats  # (N,) from the first time that a track holds her until `ending`.
    ending: Ints  # (N,) an `Ending`; `UNSEEN`: no track ever holds her.
    break_s: Floats  # (B,) s, ends of tracks whose person begins another track later.
    is_joined: Bools  # (B,) whether the adversary joins that track.


@dataclass(frozen=True, eq=False, slots=True)
class Spans:
    """H spans of samples in which a track holds the same person, in each track's order.

    A track holds the person who has most of its samples within `HELD_S`.
    """

    track: Ints  # (H,)
    person: Ints  # (H,) or `CLUTTER`.
    start_s: Floats  # (H,) first sample.
    end_s: Floats  # (H,) last sample.
    is_first: Bools  # (H,) whether the track begins with it.
    is_last: Bools  # (H,) whether the track ends with it.


def held_spans(shared: SharedTracks) -> Spans:
    """Return whom each track holds, span by span."""
    offsets, t = shared.release.offsets, shared.release.t
    holder = np.full(shared.person.size, CLUTTER)
    for first, end in pairwise(offsets.tolist()):
        samples = slice(first, end)
        holder[samples] = _holders(t[samples], shared.person[samples])
    track = np.repeat(np.arange(len(shared.release)), np.diff(offsets))
    begins = np.ones(holder.size, dtype=bool)
    begins[1:] = (np.diff(track) != 0) | (np.diff(holder) != 0)
    first = np.flatnonzero(begins)
    last = np.append(first[1:], holder.size) - 1
    changes = np.diff(track[first]) != 0
    return Spans(
        track=track[first],
        person=holder[first],
        start_s=t[first],
        end_s=t[last],
        is_first=np.append(np.ones(min(first.size, 1), dtype=bool), changes),
        is_last=np.append(changes, np.ones(min(first.size, 1), dtype=bool)),
    )


def _holders(t: Floats, person: Ints) -> Ints:
    """Return who has most samples around each sample of a track, (S,)."""
    people, number = np.unique(person, return_inverse=True)
    total = np.zeros((t.size + 1, people.size), dtype=np.int64)
    total[1:] = np.cumsum(number[:, None] == np.arange(people.size), axis=0)
    low = np.searchsorted(t, t - HELD_S / 2.0)
    high = np.searchsorted(t, t + HELD_S / 2.0, side="right")
    return np.asarray(people[(total[high] - total[low]).argmax(axis=1)])


def follow_tracks(patrol: Patrol, shared: SharedTracks) -> TrackFollowing:
    """Return how long an adversary without identities follows people through tracks."""
    shared = _by_start(shared)
    n_people, spans = len(patrol.people), held_spans(shared)
    pieces, following = _as_pieces(shared, spans), _next_spans(spans)
    links = candidate_links(pieces)
    at_end = np.flatnonzero(spans.is_last)
    goes_on = following[at_end]
    begins = goes_on[goes_on >= 0]
    # Only a track that begins with her can be joined.
    true_next = np.full(len(pieces), -1)
    true_next[goes_on >= 0] = np.where(spans.is_first[begins], spans.track[begins], -1)
    half = first_half(patrol.people.group)[spans.person[at_end]]
    chains = _chains(links, true_next, half)
    steps = _judged_links(links, chains.probability, true_next)
    until_s, ending = _until_lost(spans, following, steps, n_people=n_people)
    t, offsets = patrol.people.t, patrol.people.offsets
    is_break = (true_next >= 0) & (spans.person[at_end] != CLUTTER)
    return TrackFollowing(
        present_s=t[offsets[1:] - 1] - t[offsets[:-1]],
        followed_s=_longest_s(spans, chains.chain, n_people=n_people),
        until_s=until_s,
        ending=ending,
        break_s=spans.end_s[at_end][is_break],
        is_joined=_are_joined(chains.chain, pieces, true_next)[is_break],
    )


def _by_start(shared: SharedTracks) -> SharedTracks:
    """Return tracks in the order of their starts, as pieces of a log are."""
    offsets = shared.release.offsets
    order = np.argsort(shared.release.t[offsets[:-1]], kind="stable")
    rows, _ = stretches(offsets[:-1][order], np.diff(offsets)[order])
    return SharedTracks(
        release=shared.release.tracks(order),
        variance=shared.variance[rows],
        scan=shared.scan[rows],
        confirmed=shared.confirmed[order],
        last=shared.last[order],
        person=shared.person[rows],
    )


def _as_pieces(shared: SharedTracks, spans: Spans) -> Pieces:
    """Return tracks as pieces of a log, each with whom it holds at its end."""
    release = shared.release
    reports = Reports(release.xy, shared.variance, release.cov).floored()
    start, end = end_states(release.t, reports, release.offsets)
    return Pieces(
        person=spans.person[spans.is_last],
        sample=np.arange(release.t.size),
        reports=reports,
        offsets=release.offsets,
        start=start,
        end=end,
    )


def _next_spans(spans: Spans) -> Ints:
    """Return the next span that holds the same person after each ends, (H,), or -1."""
    following = np.full(spans.track.size, -1)
    for person in np.unique(spans.person[spans.person != CLUTTER]).tolist():
        rows = np.flatnonzero(spans.person == person)
        rows = rows[np.argsort(spans.start_s[rows], kind="stable")]
        place = np.searchsorted(spans.start_s[rows], spans.end_s[rows], side="right")
        is_known = place < rows.size
        following[rows[is_known]] = rows[place[is_known]]
    return following


def _chains(links: Links, true_next: Ints, half: Bools) -> Chains:
    """Return the chains of tracks; weights for a half are learnt on the other half."""
    is_next = true_next[links.before] == links.after
    probability = np.zeros(links.before.size)
    for part in (half, ~half):
        weights = learn_weights(links, is_next, learn_from=~part)
        in_part = part[links.before]
        probability[in_part] = probabilities(links, weights)[in_part]
    return Chains(join(links, probability), probability)


class _Steps(NamedTuple):
    """What an adversary makes of the ends of K tracks."""

    is_confused: Bools  # (K,)
    is_right: Bools  # (K,) whether it is sure of the true next track.


def _judged_links(links: Links, probability: Floats, true_next: Ints) -> _Steps:
    """Return whether the adversary is unsure, or right, at the end of each track."""
    n_pieces = links.n_pieces
    stop = 1.0 - np.bincount(links.before, weights=probability, minlength=n_pieces)
    is_true = true_next[links.before] == links.after
    true_probability, best = np.zeros(n_pieces), np.zeros(n_pieces)
    true_probability[links.before[is_true]] = probability[is_true]
    np.maximum.at(best, links.before[~is_true], probability[~is_true])
    return _Steps(
        is_confused=entropy_bits(links, probability) > CONFUSED_BITS,
        is_right=true_probability > np.maximum(stop, best),
    )


def _until_lost(
    spans: Spans, following: Ints, steps: _Steps, *, n_people: int
) -> tuple[Floats, Ints]:
    """Return the time from the first span of each person to an ending, and the ending."""
    until_s, ending = np.zeros(n_people), np.full(n_people, Ending.UNSEEN)
    order = np.argsort(spans.start_s, kind="stable")
    order = order[spans.person[order] != CLUTTER]
    people, first = np.unique(spans.person[order], return_index=True)
    for person, begin in zip(people.tolist(), order[first].tolist(), strict=True):
        row = begin
        while ending[person] == Ending.UNSEEN:
            track, after = spans.track[row], int(following[row])
            if not spans.is_last[row]:
                ending[person] = Ending.WRONG  # The track goes on with somebody else.
            elif after < 0:
                ending[person] = Ending.LEFT
            elif steps.is_confused[track]:
                ending[person] = Ending.CONFUSED
            elif not steps.is_right[track]:
                ending[person] = Ending.WRONG
            else:
                row = after
        until_s[person] = spans.end_s[row] - spans.start_s[begin]
    return until_s, ending


def _longest_s(spans: Spans, chain: Ints, *, n_people: int) -> Floats:
    """Return the longest time that one chain holds each person, (N,) s."""
    longest_s = np.zeros(n_people)
    if not spans.track.size:
        return longest_s
    label = chain[spans.track]
    order = np.lexsort((spans.start_s, label))
    person, label = spans.person[order], label[order]
    begins = np.ones(order.size, dtype=bool)
    begins[1:] = (np.diff(person) != 0) | (np.diff(label) != 0)
    first = np.flatnonzero(begins)
    last = np.append(first[1:], order.size) - 1
    span_s = spans.end_s[order][last] - spans.start_s[order][first]
    is_person = person[first] != CLUTTER
    np.maximum.at(longest_s, person[first][is_person], span_s[is_person])
    return longest_s


def _are_joined(chain: Ints, pieces: Pieces, true_next: Ints) -> Bools:
    """Return whether each track is joined to its true successor, directly, (K,)."""
    order = np.lexsort((pieces.start.t, chain))
    joined = np.full(len(pieces), -1)
    same = np.diff(chain[order]) == 0
    joined[order[:-1][same]] = order[1:][same]
    return np.asarray((joined == true_next) & (true_next >= 0))
