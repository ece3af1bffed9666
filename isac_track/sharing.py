"""What leaves the network: the public names of sharing, whose homes are in `mechanisms`."""

from isac_track.mechanisms.paper import Clean, Fid, Fixed, Raw, fid_d_sigma
from isac_track.mechanisms.perturb import check_at_least, names_of, perturb

__all__ = ["Clean", "Fid", "Fixed", "Raw"]
__all__ += ["check_at_least", "fid_d_sigma", "names_of", "perturb"]
