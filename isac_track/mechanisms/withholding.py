"""Mechanisms that withhold samples instead of adding an error.

The GDPR limits personal data to what is necessary, Art. 5(1)(c). A robot predicts from
the last samples of a walk, so older samples need not leave the network.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, Final

import numpy as np
from numpy.random import Generator

from isac_track.mechanisms.perturb import perturb
from isac_track.types import (
    TIME_TOLERANCE_S,
    Adding,
    Release,
    Sensed,
    check_at_least,
    positive,
)


@dataclass(frozen=True, slots=True)
class Window:
    """Share only the samples of the last seconds of every track.

    A sample is shared if it is at most `seconds` older than the track's last sample. It
    gets the noise that `fixed` with the same `d_sigma` adds to it: the error is drawn
    for all samples first, so that shared samples lie where `fixed` puts them. PLR, AEL
    and MEL describe the shared samples. The withheld samples do not count.

    Attributes
    ----------
    seconds : float
        Greatest age of a shared sample, s before the last of its track, positive: the
        level.
    adding : Adding
        Rule by which the noise joins the raw error, see `perturb`.
    d_sigma : float
        Additional standard deviation, m, at least 0.
    plain_name, about : str
        Its name and meaning in words; ``{level}`` stands for the level.
    protects : bool
        True: it claims protection.
    withholds : bool
        True: it leaves out samples.

    Raises
    ------
    ValueError
        If a parameter is out of its range or not finite.
    """

    seconds: float
    adding: Adding = "linear"
    d_sigma: float = 0.0

    plain_name: ClassVar[str] = "last {level} s only"
    about: ClassVar[str] = (
        "Only the last seconds of every track are shared; older samples are withheld."
    )
    protects: ClassVar[bool] = True
    withholds: ClassVar[bool] = True

    def __post_init__(self) -> None:
        positive("seconds", self.seconds)
        check_at_least("d_sigma", self.d_sigma, 0, " m")

    @property
    def adds_error(self) -> bool:
        """Whether it adds an error; if not, both adding rules share the same."""
        return self.d_sigma > 0

    def share(self, sensed: Sensed, rng: Generator) -> Release:
        """Return a release of the N tracks' samples within the window."""
        full = perturb(sensed, self.d_sigma, rng, adding=self.adding)
        sizes = np.diff(full.offsets)
        age_s = np.repeat(full.t[full.offsets[1:] - 1], sizes) - full.t
        is_shared = age_s <= self.seconds + TIME_TOLERANCE_S
        shared_before = np.concatenate([[0], np.cumsum(is_shared)])
        return full.samples(is_shared, offsets=shared_before[full.offsets])


MECHANISMS: Final[Mapping[str, type]] = {"window": Window}
"""By the name in a SPEC."""
