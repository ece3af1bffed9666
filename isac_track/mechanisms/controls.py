"""Controls: mechanisms that change descriptors and linkability independently.

None is meant as a protection. `correlated` hides each sample as well as `fixed` does,
but neighbouring errors are similar; `offset` moves a walk as a whole and keeps its
shape; `thin` shares fewer samples. A descriptor that predicts how linkable people are
must predict it under these as well.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import ClassVar, Final

import numpy as np
from numpy.random import Generator

from isac_track.measurement import shaped_errors
from isac_track.mechanisms.error_paths import correlated_errors
from isac_track.mechanisms.perturb import perturb
from isac_track.types import Adding, Release, Sensed, check_at_least, positive


@dataclass(frozen=True, slots=True)
class Correlated:
    """Add errors as large as those of `fixed` that change slowly along a track.

    Each sample has the same error distribution as under `fixed` with the same `d_sigma`
    and adding rule. With linear adding the whole error is redrawn: sigma_raw + d_sigma
    times the slow error.

    Attributes
    ----------
    d_sigma : float
        Additional standard deviation, m, at least 0: the level.
    tau_s : float
        Time over which the error's correlation falls to 1/e, s, positive.
    adding : Adding
        Rule by which the noise joins the raw error, see `perturb`.
    plain_name, about : str
        Its name and meaning in words; ``{level}`` stands for the level.
    errors_are_independent : bool
        False: the linear benchmark, which takes errors as independent, does not hold.
    protects : bool
        False: it claims no protection.

    Raises
    ------
    ValueError
        If `d_sigma` is negative, `tau_s` not positive, or either not finite.
    """

    d_sigma: float
    tau_s: float = 2.0
    adding: Adding = "linear"

    plain_name: ClassVar[str] = "correlated noise, {level} m"
    about: ClassVar[str] = (
        "A control: noise as large as fixed noise, but similar from sample to sample."
    )
    errors_are_independent: ClassVar[bool] = False
    protects: ClassVar[bool] = False

    def __post_init__(self) -> None:
        check_at_least("d_sigma", self.d_sigma, 0, " m")
        positive("tau_s", self.tau_s)

    def share(self, sensed: Sensed, rng: Generator) -> Release:
        """Return the estimates with an error that changes slowly."""
        unit = correlated_errors(
            t=sensed.t,
            offsets=sensed.offsets,
            law=sensed.law,
            tau_s=self.tau_s,
            rng=rng,
        )
        if self.adding == "independent":
            return perturb(
                sensed, self.d_sigma, rng, adding=self.adding, unit_error=unit
            )
        # Linear adding scales the raw error, which changes from sample to sample. For a
        # sum that changes slowly, the slow error first takes the raw error's place.
        if sensed.cov is not None:
            shaped = shaped_errors(cov=sensed.cov, unit_error=unit, law=sensed.law)
            unit = shaped / sensed.sigma_raw[:, None]
        changed = sensed.sigma_raw[:, None] * (unit - sensed.unit_error)
        redrawn = replace(sensed, xy=sensed.xy + changed, unit_error=unit)
        return perturb(redrawn, self.d_sigma, rng, adding=self.adding)


@dataclass(frozen=True, slots=True)
class Offset:
    """Displace every track as a whole in a random direction.

    The release declares the standard deviation of the raw estimates: a smoother weighs
    samples by their scatter, which the displacement does not change.

    Attributes
    ----------
    distance : float
        Length of the displacement, m, at least 0: the level.
    plain_name, about : str
        Its name and meaning in words; ``{level}`` stands for the level.
    adds_error : bool
        False: both adding rules share the same.
    errors_are_independent : bool
        False: all samples of a track have the same displacement.
    protects : bool
        False: it claims no protection.

    Raises
    ------
    ValueError
        If `distance` is negative or not finite.
    """

    distance: float

    plain_name: ClassVar[str] = "constant shift, {level} m"
    about: ClassVar[str] = (
        "A control: a whole track shifted by one distance in a random direction, in m."
    )
    adds_error: ClassVar[bool] = False
    errors_are_independent: ClassVar[bool] = False
    protects: ClassVar[bool] = False

    def __post_init__(self) -> None:
        check_at_least("distance", self.distance, 0, " m")

    def share(self, sensed: Sensed, rng: Generator) -> Release:
        """Return the raw estimates, each track displaced."""
        angle = rng.uniform(0.0, 2.0 * np.pi, len(sensed))
        shift_m = self.distance * np.column_stack([np.cos(angle), np.sin(angle)])
        raw = perturb(sensed, 0.0, rng)
        return replace(
            raw, xy=raw.xy + np.repeat(shift_m, np.diff(sensed.offsets), axis=0)
        )


@dataclass(frozen=True, slots=True)
class Thin:
    """Share every n-th sample as `fixed` would, counted back from the last of a track.

    The error is drawn for all samples first, so that shared samples lie where `fixed`
    puts them.

    Attributes
    ----------
    every : int
        The n of every n-th sample, at least 1: the level.
    adding : Adding
        Rule by which the noise joins the raw error, see `perturb`.
    d_sigma : float
        Additional standard deviation, m, at least 0.
    plain_name, about : str
        Its name and meaning in words; ``{level}`` stands for the level.
    protects : bool
        False: it claims no protection.
    withholds : bool
        True: it leaves out samples.

    Raises
    ------
    ValueError
        If a parameter is out of its range or not finite.
    """

    every: int
    adding: Adding = "linear"
    d_sigma: float = 0.0

    plain_name: ClassVar[str] = "one sample in {level}"
    about: ClassVar[str] = "A control: only every n-th sample is shared."
    protects: ClassVar[bool] = False
    withholds: ClassVar[bool] = True

    def __post_init__(self) -> None:
        check_at_least("every", self.every, 1)
        check_at_least("d_sigma", self.d_sigma, 0, " m")

    @property
    def adds_error(self) -> bool:
        """Whether it adds an error; if not, both adding rules share the same."""
        return self.d_sigma > 0

    def share(self, sensed: Sensed, rng: Generator) -> Release:
        """Return the thinned release."""
        full = perturb(sensed, self.d_sigma, rng, adding=self.adding)
        sizes = np.diff(full.offsets)
        samples_left = np.repeat(full.offsets[1:] - 1, sizes) - np.arange(full.t.size)
        is_shared = samples_left % self.every == 0
        offsets = np.concatenate([[0], np.cumsum(-(-sizes // self.every))])
        return full.samples(is_shared, offsets=offsets)


MECHANISMS: Final[Mapping[str, type]] = {
    "correlated": Correlated,
    "offset": Offset,
    "thin": Thin,
}
"""By the name in a SPEC."""
