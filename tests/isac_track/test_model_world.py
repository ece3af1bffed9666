"""Model worlds: fitted motions, simulated walks, and the bound on their attacks."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats
from scipy.special import logsumexp

from isac_track.kalman import Batch, smooth_positions
from isac_track.kalman.slow_errors import SlowError, smooth_tracks
from isac_track.mechanisms.controls import Correlated, Offset, Thin
from isac_track.mechanisms.protections import Forecast, Laplace, Ou
from isac_track.model_world import (
    START_STD_M,
    Errors,
    Motion,
    OwnMotions,
    fit_motion,
    fit_own_motions,
    known_share,
    log_ratios,
    release_errors,
    simulate_walks,
)
from isac_track.rng import stream
from isac_track.sensing import unit_errors
from isac_track.sharing import Fixed, Raw
from isac_track.types import Sensed, Tracks

MOTION = Motion(q=0.06, speed_mps=0.9)
N, SIZE = 400, 90
OFFSETS = np.arange(N + 1) * SIZE


def rng(*names):
    return stream(3, "test", "model world", *names)


@pytest.fixture(scope="module")
def walks():
    step = rng("steps").uniform(0.05, 0.15, (N, SIZE))
    t = np.cumsum(step, axis=1).ravel()
    start = rng("start").uniform(-5.0, 5.0, (N, 2))
    xy = simulate_walks(
        t=t, offsets=OFFSETS, start=start, motion=MOTION, rng=rng("walks")
    )
    return t, xy, start


def sensed(walks, law, sigma_m=0.5):
    t, xy, _ = walks
    sigma = sigma_m * rng("sigma").uniform(0.5, 1.5, t.size)
    unit = unit_errors(n_samples=t.size, law=law, rng=rng("errors", law))
    ones = np.ones_like(t)
    rest = {"information": ones, "fid": ones, "offsets": OFFSETS, "law": law}
    return Sensed(
        t=t, xy=xy + sigma[:, None] * unit, unit_error=unit, sigma_raw=sigma, **rest
    )


def test_walks_begin_at_their_start_and_spread_by_the_motion(walks):
    t, xy, start = walks
    np.testing.assert_allclose(xy[OFFSETS[:-1]], start, atol=1e-9)
    last_s = t[OFFSETS[1:] - 1] - t[OFFSETS[:-1]]
    moved = xy[OFFSETS[1:] - 1] - start
    expected = np.square(MOTION.speed_mps * last_s) + MOTION.q * last_s**3 / 3.0
    z = moved / np.sqrt(expected)[:, None]
    assert stats.kstest(z.ravel(), "norm").pvalue > 1e-3


def test_the_motion_of_simulated_walks_is_recovered(walks):
    t, xy, _ = walks
    names = tuple(map(str, range(N)))
    fitted = fit_motion(Tracks(t=t, xy=xy, offsets=OFFSETS, source=names, group=names))
    assert fitted.q == pytest.approx(MOTION.q, rel=0.05)
    assert fitted.speed_mps == pytest.approx(MOTION.speed_mps, rel=0.15)


@pytest.mark.parametrize("end_m", [1.0, 0.0], ids=["straight", "standing"])
def test_a_straight_walk_of_two_samples_has_a_motion(end_m):
    xy = np.array([[0.0, 0.0], [end_m, end_m]])
    rest = {"source": ("a",), "group": ("a",), "offsets": np.array([0, 2])}
    fitted = fit_motion(Tracks(t=np.array([0.0, 1.0]), xy=xy, **rest))
    assert fitted.q > 0.0
    assert fitted.speed_mps == pytest.approx(max(end_m, 0.01))


@pytest.mark.parametrize(
    ("law", "mechanism"),
    [
        ("isotropic", Raw()),
        ("radial", Raw()),
        ("radial", Fixed(0.7)),
        ("radial", Fixed(0.7, adding="independent")),
        ("isotropic", Fixed(0.7, adding="independent")),
        ("radial", Laplace(0.6)),
        ("radial", Thin(3)),
    ],
    ids=str,
)
def test_given_their_scales_errors_are_standard_gaussian(walks, law, mechanism):
    raw = sensed(walks, law)
    release = mechanism.share(raw, rng("share"))
    keep = np.isin(
        raw.t + 1e6 * np.repeat(np.arange(N), SIZE),
        release.t + 1e6 * np.repeat(np.arange(N), np.diff(release.offsets)),
    )
    seen = Sensed(
        **{
            name: getattr(raw, name)[keep]
            for name in ("t", "xy", "unit_error", "sigma_raw", "information", "fid")
        },
        offsets=release.offsets,
        law=law,
    )
    errors = release_errors(
        release=release, sensed=seen, mechanism=mechanism, rng=rng("genie")
    )
    z = (release.xy - walks[1][keep]) / np.sqrt(errors.variance)[:, None]
    assert stats.kstest(z[:, 0], "norm").pvalue > 1e-3
    # The scale does not predict the length of the scaled error.
    assert abs(np.corrcoef(errors.variance, np.square(z).sum(axis=1))[0, 1]) < 0.02
    assert errors.is_gaussian == (
        law == "isotropic" and not isinstance(mechanism, Laplace)
    )


@pytest.mark.parametrize("law", ["isotropic", "radial"])
@pytest.mark.parametrize("mechanism", [Fixed(0.7), Ou(0.4)], ids=str)
def test_the_posterior_mean_of_the_genie_knows_the_expected_share(
    walks, law, mechanism
):
    """In a linear Gaussian world with known scales the smoother is the optimum."""
    raw = sensed(walks, law)
    release = mechanism.share(raw, rng("share"))
    errors = release_errors(
        release=release, sensed=raw, mechanism=mechanism, rng=rng("genie")
    )
    options = {"t": raw.t, "offsets": OFFSETS, "errors": errors, "epsilon_m": 0.3}
    expected = known_share(**options, motion=MOTION)
    if errors.slow is None:
        batch = Batch(
            raw.t, release.xy, errors.variance, OFFSETS, (100.0, MOTION.speed_mps)
        )
        mean = smooth_positions(batch, q=MOTION.q)[0]
        off = np.hypot(*(mean - walks[1]).T).reshape(N, SIZE)
        share = (off < 0.3).mean(axis=1)
        gap = share - expected
        assert abs(gap.mean()) < 4.0 * gap.std() / np.sqrt(N)
    # With less acceleration the genie knows more.
    low = known_share(**options, motion=replace(MOTION, q=0.01))
    assert low.mean() > expected.mean()


def _people(walks):
    """Motions and walks where every other person stands nearly still."""
    stands = np.arange(N) % 2 == 0
    motions = OwnMotions(np.where(stands, 2e-3, 0.1), np.where(stands, 0.05, 1.2))
    t, _, start = walks
    return motions, simulate_walks(
        t=t, offsets=OFFSETS, start=start, motion=motions, rng=rng("people")
    )


def test_each_persons_motion_is_recovered(walks):
    motions, xy = _people(walks)
    names = tuple(map(str, range(N)))
    tracks = Tracks(t=walks[0], xy=xy, offsets=OFFSETS, source=names, group=names)
    fitted = fit_own_motions(tracks)
    for kind in (0, 1):
        np.testing.assert_allclose(fitted.q[kind::2].mean(), motions.q[kind], rtol=0.07)
    # A few seconds determine q to a factor of about two: these two differ more.
    assert fitted.q[::2].max() < fitted.q[1::2].min()
    assert fitted.take(np.array([3, 3, 0])).q.tolist() == fitted.q[[3, 3, 0]].tolist()


@pytest.mark.parametrize("mechanism", [Fixed(0.7), Ou(0.4)], ids=str)
def test_knowing_each_motion_gives_the_expected_share_and_others_less(walks, mechanism):
    """A smoother for each of the two motions, against one smoother for all."""
    motions, xy = _people(walks)
    raw = sensed((walks[0], xy, None), "isotropic")
    release = mechanism.share(raw, rng("share"))
    errors = release_errors(
        release=release, sensed=raw, mechanism=mechanism, rng=rng("genie")
    )
    options = {"t": raw.t, "offsets": OFFSETS, "errors": errors, "epsilon_m": 0.3}
    expected = known_share(**options, motion=motions)

    def share(q, speed_mps):
        batch = Batch(
            raw.t, release.xy, errors.variance, OFFSETS, (START_STD_M, speed_mps)
        )
        slow = errors.slow or SlowError(0.0, 0.0)
        off = np.hypot(*(smooth_tracks(batch, slow, q=q)[0] - xy).T).reshape(N, SIZE)
        return (off < 0.3).mean(axis=1)

    own = np.empty(N)
    for kind in (0, 1):
        own[kind::2] = share(motions.q[kind], motions.speed_mps[kind])[kind::2]
        gap = own[kind::2] - expected[kind::2]
        assert abs(gap.mean()) < 4.0 * gap.std() / np.sqrt(N / 2)
    common = share(motions.q.mean(), np.sqrt(np.square(motions.speed_mps).mean()))
    assert (own - common).mean() > 4.0 * (own - common).std() / np.sqrt(N)


def test_one_gaussian_sample_is_known_as_the_rayleigh_law_says():
    sample = {"t": np.zeros(1), "offsets": np.array([0, 1])}
    errors, motion = Errors(np.array([0.04])), Motion(q=0.05, speed_mps=1.0)
    share = known_share(**sample, errors=errors, motion=motion, epsilon_m=0.3)
    assert share == pytest.approx(stats.rayleigh(scale=0.2).cdf(0.3), rel=1e-5)


@pytest.mark.parametrize(
    "mechanism", [Correlated(0.5), Offset(0.3), Forecast(0.3), "mine"], ids=str
)
def test_other_errors_are_not_covered(walks, mechanism):
    raw = sensed(walks, "radial")
    release = Raw().share(raw, rng("share"))
    assert (
        release_errors(
            release=release, sensed=raw, mechanism=mechanism, rng=rng("genie")
        )
        is None
    )


def _dense(positions, covariance):
    root = np.linalg.cholesky(covariance)
    white = np.linalg.solve(root, positions)
    normal = 2.0 * np.log(np.diag(root)).sum() + positions.size * np.log(2.0 * np.pi)
    return -0.5 * np.square(np.abs(white)).sum() - normal


def _covariance(t, variance, *, second):
    early, late = np.minimum.outer(t, t), np.maximum.outer(t, t)
    walk = early**3 / 3.0 + early**2 * (late - early) / 2.0
    shift = np.outer(second, second) * START_STD_M**2
    free = START_STD_M**2 + MOTION.speed_mps**2 * np.outer(t, t)
    return free + MOTION.q * walk + shift + np.diag(variance)


def test_ratios_of_pairs_are_those_of_dense_densities_averaged_over_rotations():
    lags_s, weight = np.array([-1.0, 0.0, 0.7]), np.array([0.2, 0.5, 0.3])
    sides = []
    for name, n, size in (("probe", 2, 8), ("gallery", 3, 6)):
        draw, offsets = rng("pairs", name), np.arange(n + 1) * size
        t = np.cumsum(draw.uniform(0.2, 0.6, (n, size)), axis=1).ravel()
        walk = {"t": t, "offsets": offsets, "start": np.zeros((n, 2)), "motion": MOTION}
        variance = draw.uniform(0.01, 0.1, t.size)
        noise = np.sqrt(variance)[:, None] * draw.standard_normal((t.size, 2))
        prior = START_STD_M, MOTION.speed_mps
        sides.append(
            Batch(t, simulate_walks(**walk, rng=draw) + noise, variance, offsets, prior)
        )
    ratios = log_ratios(*sides, motion=MOTION, lags_s=lags_s, weight=weight)
    angles = np.exp(2j * np.pi * np.arange(360) / 360)

    def seen(batch, row):
        own = slice(*batch.offsets[row : row + 2])
        t, z = batch.t[own], (batch.xy[own] - batch.xy[own][0]) @ [1.0, 1j]
        return t - t[0], z, batch.variance[own]

    for i, j in np.ndindex(ratios.shape):
        (t1, z1, r1), (t2, z2, r2) = seen(sides[0], i), seen(sides[1], j)
        separate = sum(
            _dense(z, _covariance(t, r, second=np.zeros(t.size)))
            for t, z, r in ((t1, z1, r1), (t2, z2, r2))
        )
        second = np.repeat([0.0, 1.0], [t1.size, t2.size])
        log_likelihoods = []
        for lag_s, share in zip(lags_s, weight, strict=True):
            t = np.concatenate([t1, t2 + lag_s])
            joint = _covariance(t - t.min(), np.concatenate([r1, r2]), second=second)
            turned = [_dense(np.concatenate([z1, turn * z2]), joint) for turn in angles]
            log_likelihoods.append(
                logsumexp(turned) - np.log(angles.size) + np.log(share)
            )
        assert ratios[i, j] == pytest.approx(
            logsumexp(log_likelihoods) - separate, abs=1e-6
        )
