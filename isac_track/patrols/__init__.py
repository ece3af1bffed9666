"""Patrols: robots that walk through a whole recording and ask where people are."""

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
