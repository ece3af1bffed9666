"""Queries of a robot on patrol, and the checks that hold for policies."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from numpy.random import Generator

from attacks.testing import _checks as common
from attacks.testing import _releases as made
from isac_track.policies.query import Query, View
from isac_track.types import Bools, Floats, Knowledge, Prediction, read_only

if TYPE_CHECKING:
    from isac_track.testing.engine import Body

_SCAN_S = 0.0836  # Of the clock that all people share.
_STEPS = 49  # Of the forecasts, 4 s.
_SPEED_MPS = 1.4  # Of the robot.


@dataclass(frozen=True, eq=False, slots=True)
class PolicyCase(made.Case):
    """The query of a robot."""

    asked: ClassVar[tuple[str, ...]] = ("query",)
    compared: ClassVar[str] = "samples"
    unit: ClassVar[str] = ""

    query: Query

    def prepared(
        self,
        policy: made.Plugin,
        _given: frozenset[Knowledge],
        _rng: Generator,
        _actor: str,
    ) -> made.Plugin:
        """Return the function that selects."""
        return policy.select

    def read(self, result: object) -> Floats:
        """Return 1.0 for each sample that is sent, (M, 1); or ValueError."""
        mask, n_samples = np.asarray(result), self.query.t.size
        if mask.dtype != np.bool_ or mask.shape != (n_samples,):
            raise ValueError(
                f"select must return a mask of the {n_samples} samples, got"
                f" {mask.dtype} of shape {mask.shape}"
            )
        return mask.astype(np.float64)[:, None]

    def fault(self, _selected: object) -> str:
        """Return nothing: `form_stays_the_same` looks at what is selected."""
        return ""

    @staticmethod
    def ordinary_and_another(
        _granted: object, **_shown: bool
    ) -> tuple[PolicyCase, PolicyCase]:
        """Return the query of a crowd, and that of a single person."""
        return _case(tuple(20 + 5 * row for row in range(14))), _case((40,))

    def odd(self) -> Iterator[PolicyCase]:
        """Yield queries with nobody, and with people of a single sample or two."""
        return (_case(sizes) for sizes in ((), (1,), (2, 1), (1, 60, 2)))

    def out_of_bounds(self, _answer: Floats) -> str:
        """Return nothing: a mask has no bounds."""
        return ""


# Made-up queries, the same for every policy; for the process.
@cache
def _case(sizes: tuple[int, ...]) -> PolicyCase:
    about = f"a query with {len(sizes)} people"
    return PolicyCase(about, _query(sizes))


def _query(sizes: tuple[int, ...]) -> Query:
    """Return a query among people of some samples each, who walk straight."""
    rng = made.draws("policy", *sizes)
    offsets = np.cumsum([0, *sizes])
    age_s = [_SCAN_S * np.arange(size - 1.0, -1.0, -1.0) for size in sizes]
    now_xy = rng.uniform(-6.0, 6.0, (len(sizes), 2))
    velocity = rng.uniform(-1.5, 1.5, (len(sizes), 2))
    ages = np.concatenate([np.zeros(0), *age_s])
    owner = np.repeat(np.arange(len(sizes)), sizes)
    xy = now_xy[owner] - ages[:, None] * velocity[owner]
    ahead_s = _SCAN_S * np.arange(float(_STEPS))
    mean = now_xy[:, None, :] + ahead_s[:, None] * velocity[:, None, :]
    variance = 0.01 + 0.02 * ahead_s**3
    cov = np.broadcast_to(variance[:, None, None] * np.eye(2), (*mean.shape, 2)).copy()
    noise_m = 0.05 * rng.standard_normal(xy.shape)
    return Query(
        t=read_only(100.0 - ages),
        offsets=read_only(offsets),
        raw=View(read_only(xy), Prediction(mean, cov)),
        shared=View(read_only(xy + noise_m), Prediction(mean + 0.02, cov.copy())),
        robot_xy=read_only(
            np.column_stack([_SPEED_MPS * ahead_s, np.zeros(ahead_s.size)])
        ),
        ahead_s=read_only(ahead_s),
        rng=rng,
    )


def form_stays_the_same(row: common.Row) -> None:
    """A state is of the present sample of a person, and a flag selects no sample."""
    form = row.subject.form
    for case in (row.ordinary, row.another, *row.ordinary.odd()):
        sent: Bools = row.answer(case)[:, 0] > 0.0
        if form == "flag" and sent.any():
            row.fail(case, "form is a flag, which sends no sample: select none")
        is_last = np.isin(np.arange(sent.size), case.query.offsets[1:] - 1)
        if form == "state" and (sent & ~is_last).any():
            row.fail(
                case,
                "form is a state, which is of now: select the last sample of a person",
            )


POLICY: dict[str, Body] = {
    "result_is_a_mask": common.result_is_right,
    "form_stays_the_same": form_stays_the_same,
    "query_is_not_mutated": common.inputs_are_not_mutated,
    "same_query_same_answer": common.same_seed_same_result,
    "odd_queries_are_answered": common.odd_tracks_are_handled,
}
