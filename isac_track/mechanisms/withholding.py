"""Mechanisms that withhold samples instead of adding an error: share what a robot needs.

The GDPR asks for personal data to be limited to what is necessary, Art. 5(1)(c). A
robot predicts from the last samples of a walk, so older ones need not leave the
network.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, Final

import numpy as np
from numpy.random import Generator

from isac_track.mechanisms.perturb import check_at_least, perturb
from isac_track.types import Adding, Release, Sensed, positive


@dataclass(frozen=True, slots=True)
class Window:
    """Share the last seconds of every track only, as `fixed` would.

    A sample is shared if it is at most `seconds` older than the last one, which is
    shared in any case. The error is drawn for all samples first, so that those shared
    lie where `fixed` puts them. PLR, AEL and MEL describe the samples that are sent:
    they cannot see what is withheld.
    """

    seconds: float  # s before the last sample of a track.
    adding: Adding = "linear"
    d_sigma: float = 0.0  # m, standard deviation that is added.

    protects: ClassVar[bool] = True

    def __post_init__(self) -> None:
        positive("seconds", self.seconds)
        check_at_least("d_sigma", self.d_sigma, 0, " m")

    @property
    def adds_error(self) -> bool:
        """Without an error of its own it shares the same under either adding rule."""
        return self.d_sigma > 0

    def share(self, sensed: Sensed, rng: Generator) -> Release:
        """Return a release of the samples within the window, (N tracks, at most M samples)."""
        whole = perturb(sensed, self.d_sigma, rng, adding=self.adding)
        assert whole.sigma is not None
        sizes = np.diff(whole.offsets)
        age_s = np.repeat(whole.t[whole.offsets[1:] - 1], sizes) - whole.t
        is_shared = age_s <= self.seconds
        shared_before = np.concatenate([[0], np.cumsum(is_shared)])
        return Release(
            t=whole.t[is_shared],
            xy=whole.xy[is_shared],
            sigma=whole.sigma[is_shared],
            offsets=shared_before[whole.offsets],
            pseudonym=whole.pseudonym,
        )


MECHANISMS: Final[Mapping[str, type]] = {"window": Window}
"""By the name in a SPEC."""
