"""The mechanisms of made-up estimates, by their names."""

from evaluation.analysis.families import Family
from evaluation.analysis.sweeps import Sweeps

RULE = ":adding=independent"
WITHOUT_RULE = ("raw", "clean", "offset", "thin", "mine:Ou")
"""What declares no adding rule; `mine:Ou` is somebody else's."""


def family_of(mechanism):
    """Return the family that a mechanism of this name has."""
    own = mechanism.startswith("mine:Ou")
    family = "mine:Ou" if own else mechanism.partition(":")[0]
    linear = "" if mechanism in WITHOUT_RULE else "linear"
    return Family(mechanism, family, "independent" if RULE[1:] in mechanism else linear)


def families_of(found):
    """Return the mechanisms of estimates or of names, by name."""
    names = dict.fromkeys(getattr(key, "mechanism", key) for key in found)
    return {name: family_of(name) for name in names}


def sweeps_of(found):
    """Return the sweeps of estimates by key."""
    return Sweeps(found, families_of(found))
