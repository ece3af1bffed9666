"""One number by itself."""

from isac_track.intervals import ratio_estimates


def ratio_estimate(*, numerator, denominator, weights, is_share=False):
    """Return the estimate of a ratio of sums within clusters, (C,) each."""
    sums = {"numerator": numerator[None], "denominator": denominator[None]}
    return ratio_estimates(**sums, weights=weights, is_share=(is_share,))[0]
