"""The smoother of slow errors: fitted, known, learnt; and without a slow error."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from helpers.walks import context, cv_walks, flat_release

from attacks.reconstruction.kalman_rts import KalmanRTS, RadialRTS
from attacks.reconstruction.ou_rts import OuRTS, fit_slow_error
from isac_track.mechanisms.controls import Correlated
from isac_track.mechanisms.error_paths import correlated_errors
from isac_track.plugins import parse
from isac_track.protocols import TrainingSet
from isac_track.rng import stream
from isac_track.sharing import Fixed, Raw
from isac_track.types import Knowledge, derived

MECHANISM, REPEATS, SCENE = Knowledge.MECHANISM, Knowledge.REPEATS, Knowledge.SCENE
ANCHOR, COMPANIONS = Knowledge.ANCHOR, Knowledge.COMPANIONS

Q, NOISE_M = 0.05, 0.1


@dataclass(frozen=True)
class Slow:
    """A mechanism that declares such an error."""

    std_m: float
    tau_s: float


def walks(std_m, tau_s, *, n=40, size=150, white_m=NOISE_M):
    """Return walks of the model behind its errors, and the truth."""
    t, path, offsets = cv_walks(*[size] * n, q=Q)
    rng = stream(0, "test", "ou_rts", str((std_m, tau_s, white_m)))
    xy = path + white_m * rng.standard_normal(path.shape)
    if std_m:
        slow = correlated_errors(
            t=t, offsets=offsets, law="isotropic", tau_s=tau_s, rng=rng
        )
        xy = xy + std_m * slow
    return flat_release(t, xy, offsets), path


def informed(taught, mechanism):
    return context(taught, granted=(MECHANISM, Knowledge.TRAIN), mechanism=mechanism)


def error_m2(attack, seen, truth, known=None):
    """Return the mean squared error of a reconstruction, by default a blind one."""
    return float(((attack.fit(known or context())(seen).xy - truth) ** 2).mean())


@pytest.mark.parametrize("error", [(0.5, 2.0), (1.0, 5.0), (0.8, 10.0)])
def test_the_release_tells_how_large_and_how_slow_an_error_is(error):
    release, _ = walks(*error)
    std_m, tau_s = fit_slow_error(release, Q)
    # Over seconds an error shows how fast it moves, less how large it would become.
    assert std_m**2 / tau_s == pytest.approx(error[0] ** 2 / error[1], rel=0.15)
    assert error[1] / 3 < tau_s < 3 * error[1]
    truth = OuRTS(q=Q, std_m=error[0], tau_s=error[1]).fit(context())(release).xy
    blind = OuRTS(q=Q).fit(context())(release).xy
    assert np.sqrt(((blind - truth) ** 2).mean()) < 0.15 * error[0]


def test_an_assumed_error_brings_it_nearer_and_its_std_is_right():
    release, truth = walks(0.8, 2.0)
    own = OuRTS(q=Q, std_m=0.8, tau_s=2.0).fit(context())(release)
    square = (own.xy - truth) ** 2
    assert square.mean() < 0.8 * error_m2(KalmanRTS(Q), release, truth)
    assert (square.sum(axis=1) / (2 * own.std**2)).mean() == pytest.approx(1.0, abs=0.2)


def test_half_or_twice_the_error_costs_little_next_to_none():
    release, truth = walks(0.8, 2.0)
    right = error_m2(OuRTS(q=Q, std_m=0.8, tau_s=2.0), release, truth)
    none = error_m2(KalmanRTS(Q), release, truth)
    for std_m, tau_s in ((0.4, 2.0), (1.6, 2.0), (0.8, 1.0), (0.8, 4.0)):
        wrong = error_m2(OuRTS(q=Q, std_m=std_m, tau_s=tau_s), release, truth)
        assert right < wrong < right + 0.6 * (none - right)


def test_the_mechanism_and_training_help():
    release, truth = walks(0.8, 5.0)
    other, known = walks(0.8, 5.0, n=20, size=120)
    taught = TrainingSet(other, known)
    # It declares d_sigma: per axis 0.71 m.
    law = replace(Correlated(1.0, 5.0), adding="independent")
    informed_m2, misled_m2, by_law_m2 = (
        error_m2(OuRTS(), release, truth, informed(taught, mechanism))
        for mechanism in (Slow(0.8, 5.0), Slow(0.1, 90.0), law)
    )
    assert informed_m2 < 1.1 * error_m2(OuRTS(), release, truth)
    # The training people show the true error.
    assert misled_m2 < 1.1 * informed_m2
    assert by_law_m2 < 1.1 * informed_m2


@pytest.mark.parametrize("mechanism", [None, Raw(), Fixed(0.5)])
def test_where_nothing_slow_is_added_it_is_the_smoother_of_white_errors(mechanism):
    release, truth = walks(0.0, 0.0, white_m=0.5)
    known = informed(TrainingSet(release, truth), mechanism) if mechanism else context()
    own, white = (attack.fit(known)(release) for attack in (OuRTS(), RadialRTS()))
    np.testing.assert_array_equal(own.xy, white.xy)


def test_parameters_that_cannot_be_are_refused():
    for spec in ("ou_rts:0", "ou_rts:std_m=1", "ou_rts:std_m=1,tau_s=-1"):
        with pytest.raises(Exception, match=r"must be positive|give both"):
            parse("attacks", spec)


def beyond(release, **granted):
    """Return the result of an adversary who knows the error and is granted more."""
    knows = {
        "repeats": (REPEATS, SCENE),
        "anchor": (ANCHOR,),
        "companions": (COMPANIONS,),
    }
    known = (MECHANISM, *(needed for name in granted for needed in knows[name]))
    granted_context = context(granted=known, mechanism=Slow(0.8, 5.0), **granted)
    return OuRTS(q=Q).fit(granted_context)(release)


def known_at(release, truth, places):
    """One true position of each track."""
    n = len(places)
    return flat_release(release.t[places], truth[places], np.arange(n + 1))


def test_repeats_are_averaged_and_anchors_and_companions_help():
    t, path, offsets = cv_walks(*[150] * 40, q=Q)

    def release(row, shift_m=0.0):
        rng = stream(0, "test", "beyond", row)
        slow = correlated_errors(
            t=t, offsets=offsets, law="isotropic", tau_s=5.0, rng=rng
        )
        white = NOISE_M * rng.standard_normal(path.shape)
        return flat_release(t, path + shift_m + 0.8 * slow + white, offsets)

    def off_m2(reconstruction):
        return float(((reconstruction.xy - path) ** 2).mean())

    own = release(0)
    alone_m2 = off_m2(beyond(own))
    averaged = off_m2(beyond(own, repeats=tuple(release(row) for row in range(1, 10))))
    assert averaged == pytest.approx(alone_m2 / 10, rel=0.3)
    anchor = known_at(own, path, offsets[:-1] + 70)
    anchored = beyond(own, anchor=anchor)
    assert off_m2(anchored) < 0.8 * alone_m2
    np.testing.assert_allclose(anchored.xy[offsets[:-1] + 70], anchor.xy, atol=0.05)
    assert off_m2(beyond(own, companions=(release(1, shift_m=1.0),))) < 0.97 * alone_m2
    nobody = known_at(own, path, offsets[:-1])  # one sample: walks alone
    np.testing.assert_allclose(beyond(own, companions=(nobody,)).xy, beyond(own).xy)


def test_an_anchor_outside_its_track_is_named():
    release, path = walks(0.8, 5.0, n=3)
    anchor = known_at(release, path, release.offsets[:-1])
    late = replace(anchor, t=anchor.t + 1e3 * (np.arange(3) == 1))
    with pytest.raises(
        ValueError, match=r"the anchor of track 1 is at .* s, outside its"
    ):
        beyond(release, anchor=late)


def with_shapes(release, white_m, slow_m, *, ratio):
    """White errors in ellipses of the same trace along an axis that turns."""
    angle = 0.02 * np.arange(release.t.size)
    axis = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    along = 2.0 / (1.0 + ratio**2)
    shape = along * np.eye(2) + along * (ratio**2 - 1.0) * (
        axis[:, :, None] * axis[:, None, :]
    )
    cov = white_m**2 * shape
    factor = np.linalg.cholesky(cov)
    rng = stream(0, "test", "ou_rts shapes")
    error = np.einsum("mab,mb->ma", factor, rng.standard_normal(release.xy.shape))
    return derived(
        release,
        xy=release.xy + error,
        # As a network declares it under a radial law of the raw error.
        sigma=np.full(release.t.size, np.sqrt(2.0 * white_m**2 + slow_m**2)),
        cov=cov + slow_m**2 * np.eye(2),
    )


def test_the_shape_of_the_white_error_helps_and_a_round_one_changes_nothing():
    smooth_release, truth = walks(0.2, 3.0, white_m=0.0)
    knows = {"granted": (MECHANISM, Knowledge.SIGMA), "mechanism": Slow(0.2, 3.0)}
    for attack in (OuRTS(), OuRTS(q=Q)):
        reconstruct = attack.fit(context(**knows))
        long, circular = (
            with_shapes(smooth_release, 1.0, 0.2, ratio=ratio) for ratio in (8.0, 1.0)
        )
        square = ((reconstruct(long).xy - truth) ** 2).mean()
        blind = ((reconstruct(derived(long, cov=None)).xy - truth) ** 2).mean()
        assert square < 0.97 * blind
        got, expected = (
            reconstruct(each) for each in (circular, derived(circular, cov=None))
        )
        np.testing.assert_allclose(got.xy, expected.xy, rtol=0, atol=1e-10)
        np.testing.assert_allclose(got.std, expected.std, rtol=0, atol=1e-10)
    places = circular.offsets[:-1] + 40
    anchored = OuRTS(q=Q).fit(
        context(
            granted=(*knows["granted"], ANCHOR),
            mechanism=knows["mechanism"],
            anchor=known_at(circular, truth, places),
        )
    )
    got, expected = (anchored(each) for each in (circular, derived(circular, cov=None)))
    np.testing.assert_allclose(got.xy, expected.xy, rtol=0, atol=1e-10)
