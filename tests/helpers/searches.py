"""Searches of linkage attacks, made up, and their scorecards."""

from __future__ import annotations

import numpy as np

from isac_track.intervals import cluster_weights
from isac_track.linkability import Calibration, Search, scorecard
from isac_track.rng import stream

CALIBRATION = {0: Calibration(1.0, -0.3), 1: Calibration(0.5, 0.1)}


def search(scores, mate=None, cluster=None, scale=0):
    """A search where probe i has mate i, each a cluster, unless given otherwise."""
    scores = np.asarray(scores, dtype=np.float64)
    n_probes, n_gallery = scores.shape
    mate = np.arange(n_probes) if mate is None else np.asarray(mate)
    cluster = (
        np.arange(max(n_probes, n_gallery)) if cluster is None else np.asarray(cluster)
    )
    return Search(scores, mate, cluster[:n_probes], cluster[:n_gallery], scale)


def gaussian(rng, n, d, *, decimals=None, scale=0, first_cluster=0):
    scores = rng.standard_normal((n, n)) + d * np.eye(n)
    if decimals is not None:
        scores = np.round(scores, decimals)
    return search(scores, cluster=first_cluster + np.arange(n), scale=scale)


def card(searches, *, n_clusters, n_replicates=20, seed=0, **options):
    usual = {
        "weights": cluster_weights(
            n_clusters=n_clusters, n_replicates=n_replicates, seed=seed
        ),
        "calibration": None,
        "no_match_score": None,
        "rng": stream(seed, "test", "card"),
    }
    return scorecard(searches, **usual | options)


def random_searches(rng, decimals):
    """Three small searches of two scales: open sets, ties, groups, any shape."""
    searches = []
    for scale in (0, 1, 0):
        n_probes, n_gallery = rng.integers(3, 14, 2)
        n_mated = rng.integers(1, min(n_probes, n_gallery) + 1)
        probes = rng.choice(n_probes, n_mated, replace=False)
        mate = np.full(n_probes, -1)
        mate[probes] = rng.choice(n_gallery, n_mated, replace=False)
        scores = rng.standard_normal((n_probes, n_gallery))
        scores[probes, mate[probes]] += 1
        clusters = rng.integers(0, 6, n_probes), rng.integers(0, 6, n_gallery)
        searches.append(Search(np.round(scores, decimals), mate, *clusters, scale))
    return searches
