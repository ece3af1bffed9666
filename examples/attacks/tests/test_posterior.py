"""On short tracks it is a dense solution, averaged over all scales on a grid."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from further_attacks.parameters import PRIOR_STD
from further_attacks.posterior import Posterior, _densest_points, _parts
from scipy.special import gammaincinv
from walks import context, flat_release, smooth_walks

from attacks.building_blocks import Laplace, make_attack
from isac_track.rng import stream
from isac_track.sharing import Fixed, Raw
from isac_track.types import Knowledge

Q = 0.5
T = np.array([0.0, 0.3, 0.7])
XY = np.array([[0.0, 0.0], [0.5, 0.1], [0.3, 0.9]])
N_CHAINS = 1500
STD_M = np.sqrt([0.6, 1.0, 0.4])


def covariance(t):
    """Of positions: start, speed and integrated white acceleration (any textbook)."""
    early, late = np.minimum.outer(t, t), np.maximum.outer(t, t)
    driven = Q * early**2 * (3 * late - early) / 6
    return PRIOR_STD[0] ** 2 + PRIOR_STD[1] ** 2 * np.outer(t, t) + driven


def scales_on_a_grid(std_m, law, n):
    """Return variances, (n, K), that are equally likely under the error law."""
    u = (np.arange(n) + 0.5) / n
    if law == "radial":  # sin^2 of a uniform angle is arcsine distributed
        share = np.sin(np.pi * u / 2) ** 2
    elif law == "laplace":  # Gamma of shape 3/2 and mean 1
        share = gammaincinv(1.5, u) / 1.5
    else:
        share = np.ones(1)
    return share[:, None] * std_m**2


def dense(parts, n):
    """Posterior mean and variance, all scales of all samples and parts on a grid."""
    prior, xy = covariance(T), XY - XY[0]
    grids = [scales_on_a_grid(*part, n)[:, k] for part in parts for k in range(T.size)]
    every = np.stack(
        [axis.ravel() for axis in np.meshgrid(*grids, indexing="ij")], axis=1
    )
    noise = every.reshape(len(every), len(parts), T.size).sum(axis=1)
    total, mean, square = 0.0, 0.0, 0.0
    for noise_part in np.array_split(noise, max(len(noise) // 20_000, 1)):
        covariances = prior + noise_part[:, :, None] * np.eye(T.size)
        gain = prior @ np.linalg.inv(covariances)
        estimate = gain @ xy
        fit = (
            xy
            * np.linalg.solve(
                covariances, np.broadcast_to(xy, (len(noise_part), *xy.shape))
            )
        ).sum((1, 2))
        weight = np.exp(-fit / 2) / np.linalg.det(covariances)  # of two axes
        spread = np.diagonal(prior - gain @ prior, axis1=1, axis2=2)
        total += weight.sum()
        mean = mean + (weight[:, None, None] * estimate).sum(axis=0)
        square = square + (weight[:, None] * (spread + (estimate**2).mean(axis=2))).sum(
            axis=0
        )
    mean = mean / total
    return XY[0] + mean, square / total - (mean**2).mean(axis=1)


@pytest.mark.parametrize(
    ("parts", "n"),
    [
        ([(STD_M, "radial")], 120),
        ([(STD_M, "laplace")], 80),
        ([(STD_M, "isotropic"), (0.7 * STD_M, "laplace")], 80),
        pytest.param(
            [(STD_M, "radial"), (0.7 * STD_M, "radial")], 12, marks=pytest.mark.slow
        ),
    ],
    ids=["radial", "laplace", "Gaussian and Laplace", "two radial"],
)
def test_a_short_track_against_all_scales_on_a_grid(parts, n):
    mean, variance = dense(parts, n)
    times, places = np.tile(T, N_CHAINS), np.tile(XY, (N_CHAINS, 1))
    many = flat_release(times, places, 3 * np.arange(N_CHAINS + 1))
    repeated = [(np.tile(std_m, N_CHAINS), law) for std_m, law in parts]
    attack, rng = Posterior(q=Q, draws=150, burn_in=50), stream(0, "test", "posterior")
    draws = attack._draw(many, many.xy + 0.3, repeated, rng).reshape(
        150, N_CHAINS, 3, 2
    )
    chains = draws.mean(axis=0)
    error = 5.0 * chains.std(axis=0, ddof=1) / np.sqrt(N_CHAINS)
    np.testing.assert_array_less(np.abs(chains.mean(axis=0) - mean), error + 0.003)
    np.testing.assert_allclose(
        ((draws - mean) ** 2).mean(axis=(0, 1, 3)), variance, rtol=0.02
    )


@pytest.mark.parametrize("length", [0.05, 0.4, 1.0, 2.5])
def test_the_scales_make_up_the_law(length):
    """Densities are exp(-r^2 / 2) / r and exp(-sqrt(3) r), each over its integral."""
    for law, expected in (
        ("radial", np.exp(-(length**2) / 2) / length / np.sqrt(2 * np.pi**3)),
        ("laplace", 3.0 * np.exp(-np.sqrt(3.0) * length) / (2 * np.pi)),
    ):
        scale = scales_on_a_grid(np.ones(1), law, 200_000)[:, 0]
        density = np.exp(-(length**2) / 2 / scale) / (2 * np.pi * scale)
        np.testing.assert_allclose(density.mean(), expected, rtol=1e-3)


def test_the_parts_of_an_error_are_those_of_the_mechanism():
    total = np.array([1.0, 0.1])

    def parts(mechanism):
        return [
            (law, (std_m**2).round(6).tolist())
            for std_m, law in _parts(total, mechanism)
        ]

    # Per axis a radial error has half of its square.
    assert parts(None) == parts(Raw()) == parts(Fixed(1.0)) == [("radial", [2.0, 0.2])]
    # Something was sensed: a fiftieth is left of an error that is all but added.
    assert parts(Laplace(0.5)) == [("radial", [1.5, 0.004]), ("laplace", [0.25, 0.098])]
    isotropic = parts(Fixed(0.5, adding="independent", law="isotropic"))
    assert isotropic == [("radial", [1.5, 0.004]), ("isotropic", [0.25, 0.098])]
    radial = parts(Fixed(1.0, adding="independent"))
    assert radial == [("radial", [1.0, 0.004]), ("radial", [1.0, 0.196])]


def test_the_point_is_where_most_draws_are():
    """Seven of ten draws are about the second of two places, the mean near neither."""
    jitter = stream(0, "test", "draws").uniform(-0.05, 0.05, (100, 1, 2))
    draws = jitter + np.where(np.arange(100) % 10 < 3, 0.0, 0.5)[:, None, None]
    result = _densest_points(draws, 0.3)
    places = np.stack(np.meshgrid(*[np.linspace(-0.3, 0.8, 56)] * 2), axis=-1).reshape(
        -1, 1, 2
    )
    near = [
        (np.hypot(*(draws - place)[:, 0].T) < 0.3).sum()
        for place in (result.xy, *places)
    ]
    assert near[0] == max(near) == 70
    square = ((draws - draws.mean(axis=0)) ** 2).mean()
    np.testing.assert_allclose(result.std, np.sqrt([square]))


@dataclass(frozen=True)
class Slow:
    """A mechanism whose error changes slowly, by its parameters."""

    std_m: float = 0.3
    tau_s: float = 5.0


@pytest.mark.parametrize("mechanism", [Slow(), Fixed(0.3)], ids=["slow", "not radial"])
def test_behind_other_errors_it_is_the_smoother(mechanism):
    release, truth = smooth_walks(90, 90, 1, 2)
    if isinstance(mechanism, Fixed):  # all of a length: none is close to zero
        error = release.xy - truth
        release = replace(release, xy=truth + 0.5 * error / np.hypot(*error.T)[:, None])
    known = context(mechanism=mechanism, granted=(Knowledge.MECHANISM,))
    attacks = make_attack("radial_rts"), Posterior()
    smooth, ours = (attack.fit(known)(release) for attack in attacks)
    np.testing.assert_array_equal(ours.xy, smooth.xy)


@pytest.mark.parametrize(
    ("parameters", "message"),
    [
        ({"q": 0.0}, "q must be positive"),
        ({"draws": 0}, "draws must be at least 1"),
        ({"burn_in": -1}, "burn_in at least 0"),
    ],
)
def test_parameters_that_cannot_be_are_named(parameters, message):
    with pytest.raises(ValueError, match=message):
        Posterior(**parameters)
