"""Small recordings of people who come back, as files of their sessions."""

import numpy as np
from returning_crowds import returning_crowd

SMALL = ((7, 2, 3.6), (8, 2, 4.5), (7, 1, 6.0))


def write_sessions(folder, *, sessions=SMALL, n_people=10, traits=3.0):
    """Write a crowd with planted habits, a CSV with a column person per session."""
    crowd = returning_crowd(
        0, traits=traits, is_order_kept=False, sessions=sessions, n_people=n_people
    )
    paths = []
    for session in dict.fromkeys(crowd.session):
        rows = ["t,id,x,y,person"]
        for row in np.flatnonzero(np.array(crowd.session) == session):
            walk = slice(crowd.offsets[row], crowd.offsets[row + 1])
            person = crowd.person[row]
            rows += [
                f"{t:.2f},{row},{x:.4f},{y:.4f},{person}"
                for t, (x, y) in zip(crowd.t[walk], crowd.xy[walk], strict=True)
            ]
        paths.append(folder / f"run{len(paths) + 1}.csv")
        paths[-1].write_text("\n".join(rows) + "\n", encoding="utf-8")
    return tuple(map(str, paths))
