"""Answers of a network on patrol: the samples that a policy discloses to each robot."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from isac_track.errors import PluginError, error_text
from isac_track.patrols.network import Network
from isac_track.patrols.patrol import Patrol
from isac_track.policies.query import Form, Query, SelectOn, View
from isac_track.protocols import Policy
from isac_track.rng import stream
from isac_track.types import (
    Bools,
    Floats,
    Ints,
    Prediction,
    read_only,
    stretches,
)


@dataclass(frozen=True, eq=False, slots=True)
class Disclosure:
    """Answers of a policy on a patrol: A runs of samples, by query, robot, person."""

    form: Form
    select_on: SelectOn  # Positions that the policy's choice rests on.
    robot: Ints  # (A,)
    presence: Ints  # (A,) query and person.
    first: Ints  # (A,) first sample of the run.
    end: Ints  # (A,) first sample after the run.

    def key(self, *, robots: Ints) -> bytes:
        """Return a key that equal answers share, whichever of `robots` got them."""
        is_ours = np.isin(self.robot, robots)
        runs = np.stack([self.presence, self.first, self.end])[:, is_ours]
        return np.unique(runs, axis=1).tobytes()

    def sent_mask(self, patrol: Patrol, *, robots: Ints) -> Bools:
        """Return which samples were sent to at least one of `robots`, (M,)."""
        is_ours = np.isin(self.robot, robots)
        change = np.zeros(patrol.people.t.size + 1, dtype=np.int64)
        np.add.at(change, self.first[is_ours], 1)
        np.add.at(change, self.end[is_ours], -1)
        return np.asarray(np.cumsum(change[:-1]) > 0)


def disclose(network: Network, policy: Policy, *, name: str = "") -> Disclosure:
    """Return the answers of a policy to all queries of all robots.

    PluginError if the policy does not return a mask of the query's samples; `name` is
    its name in messages.
    """
    name = name or type(policy).__name__
    return disclose_each(network, {name: policy})[name]


def disclose_each(
    network: Network, policies: Mapping[str, Policy]
) -> dict[str, Disclosure]:
    """Return the answers of several policies, by their names; otherwise as `disclose`.

    A query's people are gathered once for all of them. A policy's answers depend on no
    other policy.
    """
    runs: dict[str, list[Ints]] = {name: [] for name in policies}
    for number in range(network.patrol.query_scan.size):
        people = _present_people(network, number)
        for name, policy in policies.items():
            for robot in range(network.patrol.n_robots):
                query = _make_query(network, people, robot)
                selected = _select_samples(policy, query, name=name)
                runs[name].append(_answer_runs(selected, people, robot))
    return {
        name: _joined_answers(policy, runs[name]) for name, policy in policies.items()
    }


def _joined_answers(policy: Policy, runs: Sequence[Ints]) -> Disclosure:
    """Return the disclosure of runs as `_answer_runs` returns them."""
    robot, presence, first, end = np.concatenate(runs, axis=1)
    select_on: SelectOn = getattr(policy, "select_on", "raw")
    return Disclosure(
        form=policy.form,
        select_on=select_on,
        robot=robot,
        presence=presence,
        first=first,
        end=end,
    )


@dataclass(frozen=True, eq=False, slots=True)
class _QueryPeople:
    """People who are present at a query of any robot."""

    number: int  # Of the query.
    presence: Ints  # (P,)
    shift: Ints  # (P,) added to a sample's number in the query: that in the patrol.
    t: Floats  # (M,) s
    offsets: Ints  # (P + 1,)
    raw: View
    shared: View


def _present_people(network: Network, number: int) -> _QueryPeople:
    """Return the people who are present at the query of this number."""
    patrol = network.patrol
    start, stop = np.searchsorted(patrol.presences.query, [number, number + 1])
    presence = np.arange(start, stop)
    first = patrol.people.offsets[patrol.presences.person[presence]]
    sample, offsets = stretches(first, patrol.presences.sample[presence] + 1 - first)
    raw_xy, shared_xy = network.sensed.xy[sample], network.release.xy[sample]
    if network.histories is not None:
        offsets_of_all = network.histories.raw.offsets
        rows = slice(offsets_of_all[start], offsets_of_all[stop])
        raw_xy = network.histories.raw.xy[rows]
        shared_xy = network.histories.shared.xy[rows]
    raw_forecast = _take_forecasts(network.raw_forecast, presence)
    shared_forecast = _take_forecasts(network.shared_forecast, presence)
    return _QueryPeople(
        number=number,
        presence=presence,
        shift=first - offsets[:-1],
        # Read-only: no policy changes the input of another.
        t=read_only(network.sensed.t[sample]),
        offsets=read_only(offsets),
        raw=View(read_only(raw_xy), raw_forecast),
        shared=View(read_only(shared_xy), shared_forecast),
    )


def _take_forecasts(forecast: Prediction, rows: Ints) -> Prediction:
    cov = None if forecast.cov is None else forecast.cov[rows]
    return Prediction(forecast.mean[rows], cov)


def _make_query(network: Network, people: _QueryPeople, robot: int) -> Query:
    patrol = network.patrol
    now = patrol.query_scan[people.number]
    return Query(
        t=people.t,
        offsets=people.offsets,
        raw=people.raw,
        shared=people.shared,
        robot_xy=patrol.robot_xy[robot, now : now + patrol.ahead_s.size],
        ahead_s=patrol.ahead_s,
        rng=stream(network.seed, "patrols", "policy", robot, people.number),
    )


def _select_samples(policy: Policy, query: Query, *, name: str) -> Bools:
    """Return the mask that a policy returns, (M,); PluginError for anything else."""
    try:
        selected = policy.select(query)
    except Exception as error:
        raise PluginError(f"policy {name} failed: {error_text(error)}") from error
    mask = np.asarray(selected)
    if mask.dtype != np.bool_ or mask.shape != query.t.shape:
        raise PluginError(f"policy {name} must return a mask of {query.t.size} samples")
    return mask


def _answer_runs(selected: Bools, people: _QueryPeople, robot: int) -> Ints:
    """Return robot, presence, first sample and end of each selected run, (4, A).

    No run reaches from one person to the next. A person with gaps has several runs.
    """
    starts, ends = selected.copy(), selected.copy()
    starts[1:] &= ~selected[:-1]
    ends[:-1] &= ~selected[1:]
    first_samples, last_samples = people.offsets[:-1], people.offsets[1:] - 1
    starts[first_samples] = selected[first_samples]
    ends[last_samples] = selected[last_samples]
    first, end = np.flatnonzero(starts), np.flatnonzero(ends) + 1
    person = np.searchsorted(people.offsets, first, side="right") - 1
    shift = people.shift[person]
    return np.stack(
        [
            np.full(person.size, robot),
            people.presence[person],
            first + shift,
            end + shift,
        ]
    )
