"""Evidence from silence, for an adversary who knows routes, times and the policy.

Had the same person walked from the end of one piece to the start of another, the policy
would have sent her at some queries in between. It did not. Each such query is evidence
against the link.
"""

import numpy as np

from attacks.following.links import Links
from attacks.following.pieces import Pieces, Q
from isac_track.patrols import Patrol
from isac_track.policies.query import Query, View
from isac_track.protocols import Policy
from isac_track.rng import stream
from isac_track.types import Floats, Ints, Prediction, stretches


def contradictions(
    pieces: Pieces,
    links: Links,
    *,
    patrol: Patrol,
    policy: Policy,
    robots: Ints,
    seed: int,
) -> Floats:
    """Return at how many queries within its gap each link should have been sent, (C,).

    The person is assumed to walk straight from piece to piece, at constant speed. The
    policy decides about her as about any person, for each robot of the fleet.
    """
    query_s = patrol.scan_s[patrol.query_scan]
    left_s, right_s = pieces.end.t[links.before], pieces.start.t[links.after]
    first = np.searchsorted(query_s, left_s, side="right")
    sizes = np.maximum(np.searchsorted(query_s, right_s) - first, 0)
    number, _ = stretches(first, sizes)
    link = np.repeat(np.arange(links.before.size), sizes)
    left = pieces.end.mean[links.before, :, 0]
    gap_s = right_s - left_s
    velocity = (pieces.start.mean[links.after, :, 0] - left) / gap_s[:, None]
    place = left[link] + (query_s[number] - left_s[link])[:, None] * velocity[link]
    order = np.argsort(number, kind="stable")
    count = np.zeros(links.before.size)
    for rows in np.split(order, np.flatnonzero(np.diff(number[order])) + 1):
        if not rows.size:
            continue
        query_number = int(number[rows[0]])
        for robot in robots.tolist():
            query = _hypothetical_query(
                patrol,
                query_number,
                robot,
                xy=place[rows],
                velocity_mps=velocity[link[rows]],
                seed=seed,
            )
            np.add.at(count, link[rows], policy.select(query).astype(np.float64))
    return np.asarray(np.minimum(count, sizes))


def _hypothetical_query(
    patrol: Patrol,
    number: int,
    robot: int,
    *,
    xy: Floats,
    velocity_mps: Floats,
    seed: int,
) -> Query:
    """Return the query at which P supposed people would be present, a sample each."""
    now = int(patrol.query_scan[number])
    mean = xy[:, None, :] + patrol.ahead_s[:, None] * velocity_mps[:, None, :]
    variance = Q * patrol.ahead_s**3 / 3.0
    cov = np.broadcast_to(variance[:, None, None] * np.eye(2), (*mean.shape, 2))
    view = View(xy, Prediction(mean, cov))
    return Query(
        t=np.full(len(xy), patrol.scan_s[now]),
        offsets=np.arange(len(xy) + 1),
        raw=view,
        shared=view,
        robot_xy=patrol.robot_xy[robot, now : now + patrol.ahead_s.size],
        ahead_s=patrol.ahead_s,
        rng=stream(seed, "following", "absence", robot, number),
    )
