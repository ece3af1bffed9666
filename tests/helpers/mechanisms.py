"""The mechanisms of made-up estimates, by their names, and some of one's own."""

from dataclasses import dataclass
from typing import ClassVar

from evaluation.estimates.families import Family
from evaluation.estimates.sweeps import Sweeps
from isac_track.sharing import perturb

RULE = ":adding=independent"
WITHOUT_RULE = ("raw", "clean", "offset", "thin", "mine:Ou")
"""What declares no adding rule; `mine:Ou` is somebody else's."""
PROTECT_NOBODY = ("raw", "clean", "correlated", "offset", "thin")


def find_family(mechanism):
    """Return the family that a mechanism of this name has."""
    own = mechanism.startswith("mine:Ou")
    family = "mine:Ou" if own else mechanism.partition(":")[0]
    linear = "" if mechanism in WITHOUT_RULE else "linear"
    adding = "independent" if RULE[1:] in mechanism else linear
    return Family(mechanism, family, adding, protects=family not in PROTECT_NOBODY)


def make_families(families):
    """Return the mechanisms of estimates or of names, by name."""
    names = dict.fromkeys(getattr(key, "mechanism", key) for key in families)
    return {name: find_family(name) for name in names}


def make_sweeps(estimates):
    """Return the sweeps of estimates by key."""
    return Sweeps(estimates, make_families(estimates))


@dataclass(frozen=True)
class Twice:
    """Fixed noise twice as large; it does not say by which rule it adds."""

    half: float

    def share(self, sensed, rng):
        return perturb(sensed, 2.0 * self.half, rng)


@dataclass(frozen=True)
class Says(Twice):
    adding: ClassVar[str] = "independent"


@dataclass(frozen=True)
class Control(Twice):
    """One that is there to tell something, not to protect anybody."""

    protects: ClassVar[bool] = False


@dataclass(frozen=True)
class Perhaps(Twice):
    protects: ClassVar[str] = "perhaps"


@dataclass(frozen=True)
class Vague(Twice):
    adding: float = 0.5


@dataclass(frozen=True)
class Mute(Twice):
    @property
    def adding(self):
        raise KeyError("nobody expected this")
