"""Mechanisms of the paper, and how noise is added to sensed positions.

A mechanism is a frozen dataclass of its parameters. Its method ``share(sensed, rng)``
returns a `isac_track.types.Release`.
"""

from isac_track.mechanisms.paper import Clean, Fid, Fixed, Raw, fid_d_sigma
from isac_track.mechanisms.perturb import check_at_least, perturb, split_pseudonyms

__all__ = ["Clean", "Fid", "Fixed", "Raw"]
__all__ += ["check_at_least", "fid_d_sigma", "perturb", "split_pseudonyms"]
