"""Patrols: robots that walk through a whole recording and ask where people are.

In the order in which data flow:

1. `routes` draws the robots' ways; `patrol` puts robots and people on one clock and
   lists who is present at each query.
2. `network` senses and shares, `forecasts` predicts from what is shared, `answers`
   holds the samples that a policy discloses to each robot.
3. `utility` counts the conflicts that a robot foresees and misses; `equal_alarms` does
   so at the false alarms of a reference, `refusals` for robots that commit to a route.
4. `reports` are positions in answers, with their errors; `fleet_logs` collects them by
   person. `knowledge` says how much of people's time an adversary knows from a log, by
   the `estimators` of a position; `walked_map` guesses without a log.
5. `metrics` are numbers with `intervals`; `worst_off` is about the tenth of people that
   is known best.
"""

from isac_track.patrols.patrol import (
    Patrol,
    Presences,
    forecast_instants,
    horizon_scans,
    make_patrol,
    scans_per_query,
    sense_people,
)

__all__ = ["Patrol", "Presences", "forecast_instants"]
__all__ += ["horizon_scans", "make_patrol", "scans_per_query", "sense_people"]
