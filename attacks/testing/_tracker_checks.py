"""Detections of a network, and the checks that hold for trackers."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cache
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from numpy.random import Generator

from attacks.testing import _checks as common
from attacks.testing import _releases as made
from isac_track.tracking.association import UNASSIGNED, Likelihood
from isac_track.tracking.detections import Detections
from isac_track.tracking.methods import check_tracked
from isac_track.tracking.trackers import Tracked
from isac_track.types import Floats, Ints, Knowledge, read_only

if TYPE_CHECKING:
    from isac_track.testing.engine import Body

_SCAN_S = 0.0836  # Of the clock that all people share.
_STD_M = 0.05  # Of the error, per axis.
_PROBABILITY = 0.9  # Of detecting a person at a scan.
_LEAST_SHARE = 0.6  # Of an easy person's detections in one confirmed track.
_CLUTTER = -1


@dataclass(frozen=True, eq=False, slots=True)
class TrackerCase(made.Case):
    """The detections of a recording, and who is behind each."""

    asked: ClassVar[tuple[str, ...]] = ("detections", "likelihood")
    compared: ClassVar[str] = "states"
    unit: ClassVar[str] = ""

    detections: Detections
    likelihood: Likelihood
    person: Ints  # (D,) truth, which no tracker gets.

    def prepared(
        self,
        tracker: made.Plugin,
        _given: frozenset[Knowledge],
        _rng: Generator,
        _actor: str,
    ) -> made.Plugin:
        """Return the function that tracks."""
        return tracker.track

    def read(self, result: object) -> Floats:
        """Return a row for each state, as `state_rows`; or ValueError."""
        if not isinstance(result, Tracked):
            got = type(result).__name__
            raise ValueError(f"track must return a Tracked, got {got}")  # noqa: TRY004 - as the contract says
        check_tracked(result, self.detections)
        return state_rows(result)

    def fault(self, _tracked: object) -> str:
        """Return nothing: `read` looks at all that tracks must be."""
        return ""

    @staticmethod
    def ordinary_and_another(
        _granted: object, **_shown: bool
    ) -> tuple[TrackerCase, TrackerCase]:
        """Return the detections of a crowd, and those of two people."""
        return _case(9, 60), _case(2, 25)

    def odd(self) -> Iterator[TrackerCase]:
        """Yield empty scans, a single scan, and many points at the same place."""
        yield _case(0, 6)
        yield _case(3, 1)
        crowd = _case(4, 12)
        detections = crowd.detections
        heap = replace(detections, xy=read_only(np.zeros_like(detections.xy)))
        yield replace(crowd, about="people at one place", detections=heap)

    def out_of_bounds(self, _states: Floats) -> str:
        """Return nothing: positions have no bounds."""
        return ""

    def until(self, n_scans: int) -> TrackerCase:
        """Return the same with the first scans alone."""
        detections = self.detections
        end = int(detections.offsets[n_scans])
        return replace(
            self,
            about=f"{self.about}, the first {n_scans} scans",
            detections=Detections(
                scan_s=detections.scan_s[:n_scans],
                offsets=detections.offsets[: n_scans + 1],
                xy=detections.xy[:end],
                cov=detections.cov[:end],
            ),
            person=self.person[:end],
        )


def state_rows(tracked: Tracked) -> Floats:
    """Return the states with track, scan, detection, confirmation and place, (S, 6)."""
    return np.column_stack(
        [
            tracked.track,
            tracked.scan,
            tracked.detection,
            tracked.confirmed[tracked.track],
            tracked.xy,
        ]
    ).astype(np.float64)


# Made-up detections, the same for every tracker; for the process.
@cache
def _case(n_people: int, n_scans: int) -> TrackerCase:
    """Return people who walk straight, 4 m apart, with misses and clutter."""
    rng = made.draws("tracker", n_people, n_scans)
    start = 4.0 * np.column_stack([np.arange(n_people) % 3, np.arange(n_people) // 3])
    velocity = rng.uniform(-0.6, 0.6, (n_people, 2))
    points, people, sizes = [np.zeros((0, 2))], [np.zeros(0, dtype=np.int64)], [0]
    for scan in range(n_scans):
        seen = np.flatnonzero(rng.random(n_people) < _PROBABILITY)
        xy = start[seen] + _SCAN_S * scan * velocity[seen]
        xy = xy + _STD_M * rng.standard_normal(xy.shape)
        clutter = rng.uniform(-2.0, 10.0, (int(rng.poisson(0.5 * (n_people > 0))), 2))
        xy = np.concatenate([xy, clutter])
        person = np.concatenate([seen, np.full(len(clutter), _CLUTTER)])
        order = np.lexsort((xy[:, 1], xy[:, 0]))
        points.append(xy[order])
        people.append(person[order])
        sizes.append(order.size)
    xy = np.concatenate(points)
    return TrackerCase(
        about=f"{n_people} people in {n_scans} scans",
        detections=Detections(
            scan_s=read_only(_SCAN_S * np.arange(float(n_scans))),
            offsets=read_only(np.cumsum(sizes)),
            xy=read_only(xy),
            cov=read_only(np.tile(_STD_M**2 * np.eye(2), (len(xy), 1, 1))),
        ),
        likelihood=Likelihood(detection_probability=_PROBABILITY, density_per_m2=0.01),
        person=np.concatenate(people),
    )


def later_scans_do_not_matter(row: common.Row) -> None:
    """Tracks up to a scan are the same whether or not later scans follow."""
    case = row.ordinary
    whole = row.answer(case)
    for n_scans in (5, 20, 40):
        part = row.answer(case.until(n_scans))
        is_early = (whole[:, 1] < n_scans) & (whole[:, 3] < n_scans)
        expected = whole[is_early]
        if not _same_tracks(part, expected):
            row.fail(
                case.until(n_scans),
                f"{len(part)} states, and {len(expected)} up to that scan if later"
                " scans follow, or other scans; a robot gets tracks as they grow: use"
                " no later scan",
            )


def _same_tracks(first: Floats, second: Floats) -> bool:
    """Whether states are of the same tracks, whatever the numbers of these."""
    if first.shape != second.shape:
        return False
    ours, theirs = (rows[np.lexsort(rows[:, [4, 2, 1]].T)] for rows in (first, second))
    pairs = np.unique(np.column_stack([ours[:, 0], theirs[:, 0]]), axis=0)
    is_matched = (
        len(pairs) == np.unique(pairs[:, 0]).size == np.unique(pairs[:, 1]).size
    )
    return is_matched and np.allclose(ours[:, 1:], theirs[:, 1:], atol=common.SAME)


def people_far_apart_are_tracked(row: common.Row) -> None:
    """A person far from all others is mostly in a single confirmed track."""
    case = row.another
    states = row.answer(case)
    hit = states[states[:, 2] != UNASSIGNED]
    person = case.person[hit[:, 2].astype(np.int64)]
    for number in range(int(case.person.max()) + 1):
        n_detections = int((case.person == number).sum())
        _, sizes = np.unique(hit[person == number, 0], return_counts=True)
        share = sizes.max(initial=0) / n_detections
        if share < _LEAST_SHARE:
            row.fail(
                case,
                f"the longest track of a person has {share:.0%} of the person's"
                f" detections, expected at least {_LEAST_SHARE:.0%}: people are 4 m"
                " apart and errors 5 cm",
            )


TRACKER: dict[str, Body] = {
    "result_is_tracks": common.result_is_right,
    "later_scans_do_not_matter": later_scans_do_not_matter,
    "people_far_apart_are_tracked": people_far_apart_are_tracked,
    "detections_are_not_mutated": common.inputs_are_not_mutated,
    "same_detections_same_tracks": common.same_seed_same_result,
    "odd_scans_are_tracked": common.odd_tracks_are_handled,
}
