"""Mechanisms of the paper, and how noise is added to sensed positions.

A mechanism is a frozen dataclass of its parameters. Its method ``share(sensed, rng)``
returns a `isac_track.types.Release`.
"""

from typing import TYPE_CHECKING

from isac_track.mechanisms.paper import Clean, Fid, Fixed, Raw, fid_d_sigma
from isac_track.mechanisms.perturb import perturb, split_pseudonyms
from isac_track.renamed import renamed
from isac_track.types import check_at_least

__all__ = ["Clean", "Fid", "Fixed", "Raw"]
__all__ += ["check_at_least", "fid_d_sigma", "perturb", "split_pseudonyms"]

if not TYPE_CHECKING:  # type checkers are to know the names that are
    __getattr__ = renamed(__name__, {"names_of": "split_pseudonyms"})
