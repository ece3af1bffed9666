"""The mechanisms of the paper (raw, fixed and FID-controlled), and a clean ceiling."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, Final, Literal

import numpy as np
from numpy.random import Generator

from isac_track.measurement import least_share
from isac_track.mechanisms.perturb import draw_pseudonyms, perturb
from isac_track.types import (
    Adding,
    ErrorLaw,
    Floats,
    Release,
    Sensed,
    check_at_least,
    positive,
)


def fid_d_sigma(*, fid: Floats, eta: float, alpha_m: float, beta: float) -> Floats:
    """Return the additional standard deviation of the FID rule, (M,) m.

    Eqs. fid_ratio and fid_error_control: 0 up to the threshold, then alpha * (beta -
    exp(-(rho - 1))), which rises from alpha * (beta - 1) just above it to alpha * beta.
    `fid`, (M,), and the threshold `eta`, positive, are in 1/(m^2 s); `alpha_m` is in m,
    `beta` at least 1 and without a unit. NaN where `fid` is NaN. Nothing is checked
    here: `Fid` and `perturb` do it.

    Examples
    --------
    Below, at, just above and far above the threshold:

    >>> import numpy as np
    >>> from isac_track.sharing import fid_d_sigma
    >>> fid = np.array([5.0, 10.0, 10.001, 1000.0])
    >>> fid_d_sigma(fid=fid, eta=10.0, alpha_m=0.5, beta=1.5).round(3)
    array([0.  , 0.  , 0.25, 0.75])
    """
    rho = fid / eta
    # An unknown density, NaN, is not below the threshold: `perturb` refuses its NaN.
    is_below = rho <= 1.0
    # alpha_m * (beta - exp(min(1 - rho, 0))), step by step in one array: new arrays take
    # longer than the arithmetic. The clipped exponent cannot overflow.
    d_sigma: Floats = np.subtract(1.0, rho, out=rho)
    np.minimum(d_sigma, 0.0, out=d_sigma)
    np.exp(d_sigma, out=d_sigma)
    np.subtract(beta, d_sigma, out=d_sigma)
    d_sigma *= alpha_m
    d_sigma[is_below] = 0.0
    return d_sigma


@dataclass(frozen=True, slots=True)
class Raw:
    """Share the raw sensing estimates, without further noise.

    Attributes
    ----------
    plain_name, about : str
        Its name and meaning in words.
    adds_error : bool
        False: the release has the error of the sensors alone.
    protects : bool
        False: it claims no protection.
    """

    plain_name: ClassVar[str] = "raw positions"
    about: ClassVar[str] = "Sensed positions, shared with nothing added."
    adds_error: ClassVar[bool] = False
    protects: ClassVar[bool] = False

    def share(self, sensed: Sensed, rng: Generator) -> Release:
        """Return the raw estimates of N tracks under pseudonyms that `rng` draws."""
        return perturb(sensed, 0.0, rng)


@dataclass(frozen=True, slots=True)
class Fixed:
    """Add the same standard deviation to every sample (the paper's baseline).

    Attributes
    ----------
    d_sigma : float
        Additional standard deviation, m, at least 0: the level.
    adding : Adding
        Rule by which the noise joins the raw error, see `perturb`.
    law : ErrorLaw or None
        Law of the added error; None: that of the raw error.
    plain_name, about : str
        Its name and meaning in words; ``{level}`` stands for the level.
    protects : bool
        True: it claims protection.

    Raises
    ------
    ValueError
        If `d_sigma` is negative or not finite.

    Examples
    --------
    A sample 0.1 m off, of a sensor of 0.1 m, is 0.4 m off with 0.3 m of linear noise:

    >>> import numpy as np
    >>> from isac_track.sharing import Fixed
    >>> from isac_track.types import Sensed
    >>> sensed = Sensed(
    ...     t=np.array([0.0]),
    ...     xy=np.array([[0.1, 0.0]]),
    ...     unit_error=np.array([[1.0, 0.0]]),
    ...     sigma_raw=np.array([0.1]),
    ...     information=np.array([100.0]),
    ...     fid=np.array([250.0]),
    ...     offsets=np.array([0, 1]),
    ... )
    >>> release = Fixed(0.3).share(sensed, np.random.default_rng(0))
    >>> release.xy.round(6), release.sigma.round(6)
    (array([[0.4, 0. ]]), array([0.4]))
    """

    d_sigma: float
    adding: Adding = "linear"
    law: ErrorLaw | None = None

    plain_name: ClassVar[str] = "fixed noise, {level} m"
    about: ClassVar[str] = "The same amount of noise on every position, level in m."
    protects: ClassVar[bool] = True

    def __post_init__(self) -> None:
        check_at_least("d_sigma", self.d_sigma, 0, " m")

    def share(self, sensed: Sensed, rng: Generator) -> Release:
        """Return the estimates with `d_sigma` more error; raises as `perturb`."""
        return perturb(sensed, self.d_sigma, rng, adding=self.adding, law=self.law)


@dataclass(frozen=True, slots=True)
class Fid:
    """Add error where the Fisher information density exceeds eta (the paper's rule).

    The rule is `fid_d_sigma`.

    Attributes
    ----------
    eta : float
        Threshold, 1/(m^2 s), positive: the level. A lower threshold adds more noise.
    alpha : float
        Scale of the noise, m, at least 0.
    beta : float
        Largest noise in units of `alpha`, at least 1.
    adding : Adding
        Rule by which the noise joins the raw error, see `perturb`.
    law : ErrorLaw or None
        Law of the added error; None: that of the raw error.
    information : str
        What is held against the threshold where errors have a shape: ``trace``, the
        mean information of both axes, or ``least``, that of the worst direction.
    plain_name, about : str
        Its name and meaning in words; ``{level}`` stands for the level.
    sweep : str
        ``"log"``: a range of levels is spaced logarithmically.
    protects : bool
        True: it claims protection.

    Raises
    ------
    ValueError
        If a parameter is out of its range or not finite.
    """

    eta: float
    alpha: float = 0.5
    beta: float = 1.5
    adding: Adding = "linear"
    law: ErrorLaw | None = None
    information: Literal["trace", "least"] = "trace"

    plain_name: ClassVar[str] = "FID noise, eta {level}"
    about: ClassVar[str] = "The paper's mechanism: noise where the FID exceeds eta."
    sweep: ClassVar[str] = "log"
    protects: ClassVar[bool] = True

    def __post_init__(self) -> None:
        positive("eta", self.eta)
        check_at_least("alpha", self.alpha, 0, " m")
        check_at_least("beta", self.beta, 1)
        if self.information not in ("trace", "least"):
            raise ValueError(
                f"information must be trace or least, got {self.information!r}"
            )

    def share(self, sensed: Sensed, rng: Generator) -> Release:
        """Return the estimates with the rule's noise; raises as `perturb`."""
        fid = sensed.fid
        if self.information == "least" and sensed.cov is not None:
            fid = fid * least_share(sensed.cov)
        d_sigma = fid_d_sigma(fid=fid, eta=self.eta, alpha_m=self.alpha, beta=self.beta)
        return perturb(sensed, d_sigma, rng, adding=self.adding, law=self.law)


@dataclass(frozen=True, slots=True)
class Clean:
    """Share the truth, without any error: the ceiling of every attack.

    Attributes
    ----------
    plain_name, about : str
        Its name and meaning in words.
    adds_error : bool
        False: the release has no error.
    protects : bool
        False: it claims no protection.
    """

    plain_name: ClassVar[str] = "no error at all"
    about: ClassVar[str] = (
        "True positions without any error: a reference, not a release."
    )
    adds_error: ClassVar[bool] = False
    protects: ClassVar[bool] = False

    def share(self, sensed: Sensed, rng: Generator) -> Release:
        """Return the true positions, declared with a standard deviation of 0 m."""
        return Release(
            t=sensed.t,
            xy=sensed.xy - sensed.sigma_raw[:, None] * sensed.unit_error,
            sigma=np.zeros_like(sensed.sigma_raw),
            offsets=sensed.offsets,
            pseudonym=draw_pseudonyms(len(sensed), rng),
            cov=None if sensed.cov is None else np.zeros_like(sensed.cov),
        )


MECHANISMS: Final[Mapping[str, type]] = {
    "raw": Raw,
    "fixed": Fixed,
    "fid": Fid,
    "clean": Clean,
}
"""By the name in a SPEC."""
