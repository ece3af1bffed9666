"""The project's own pedestrian crowd: a generator, and the two sessions that are bundled.

``plaza.npz`` and ``plaza_session2.npz`` are the output of ``python -m isac_track.datasets.crowd
--out DIR``. ``docs/plaza.md`` describes the model, how it was tuned and what it must not be
used for. Same settings, seed and session give the same millimetres. A crowd is chaotic, and
two machines' mathematical functions may differ in the last bit; the state is therefore rounded
to a micrometre in every step, which makes such a difference very unlikely to survive.
"""

from __future__ import annotations

import numpy as np

from isac_track.datasets.crowd.model import simulate
from isac_track.datasets.crowd.npz import SESSIONS, bundled, bundled_path, read_npz, write_npz
from isac_track.datasets.crowd.plan import CrowdSettings, draw_traits, person_id, plan_session
from isac_track.types import Tracks

__all__ = [
    "BUNDLED_SEED",
    "SESSIONS",
    "CrowdSettings",
    "bundled",
    "bundled_path",
    "generate",
    "read_npz",
    "write_npz",
]

BUNDLED_SEED = 1


def generate(settings: CrowdSettings, *, seed: int, session: int = 1) -> Tracks:
    """Simulate one session of the crowd.

    The same seed gives the same people with the same traits in every session, on new routes,
    at other times, in other company. Traits of a person do not depend on how many others
    there are.

    Parameters
    ----------
    settings : CrowdSettings
        The scenario.
    seed : int
        Base seed, not negative.
    session : int
        Number of the session, from 1.

    Returns
    -------
    Tracks
        One walk a person, in whole millimetres at multiples of ``settings.frame_s`` seconds.
        `source` is the persistent id of the person (``p0001``), `group` the party that he or
        she walks with in this session (``s1g001``).
    """
    if session < 1:
        raise ValueError(f"sessions are numbered from 1, got {session}")
    traits = draw_traits(settings, seed=seed)
    plan = plan_session(settings, traits, seed=seed, session=session)
    frame, person, xy = simulate(settings, traits, plan, seed=seed, session=session)
    order = np.lexsort((frame, person))
    rows, first = np.unique(person[order], return_index=True)
    party = np.empty(settings.n_people, dtype=np.int64)
    for number, members in enumerate(party.members for party in plan.parties):
        party[members] = number
    return Tracks(
        t=frame[order].astype(np.float64) * settings.frame_s,
        xy=np.rint(xy[order] * 1e3) / 1e3,
        offsets=np.append(first, frame.size),
        source=tuple(person_id(row) for row in rows),
        group=tuple(f"s{session}g{party[row] + 1:03d}" for row in rows),
    )
