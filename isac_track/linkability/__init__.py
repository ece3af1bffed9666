"""Scores of linkage attacks: the same people in two pseudonymous releases.

A *search* holds the scores of P probes, the people of one release, against the gallery,
the G people of another; the *mate* of a probe is the same person. Everything is a pure
function of scores and mates: `ranks`, `scores` (as evidence), tests of `significance`,
and `scoring`, all of them at once with intervals. Where an attack's scores are all
equal, every metric is at chance.

A score has no unit: a higher score makes the same person likelier. All rates are
fractions, 0..1.
"""

from isac_track.linkability.matches import fit_scale, open_matches
from isac_track.linkability.ranks import (
    GALLERY,
    Search,
    assign,
    chance,
    log_rank,
    mean_log_rank,
    rank1,
    rank1_among,
    reciprocal_rank,
    residual_risk,
)
from isac_track.linkability.scales import SCORE_REPLICATES
from isac_track.linkability.scores import (
    Calibration,
    auc,
    cllr,
    cllr_min,
    d_sys,
    d_sys_published,
    eer,
    fit_calibration,
    tpr_at_fpr,
)
from isac_track.linkability.scoring import (
    ProbeRanks,
    Scorecard,
    rank_scorecard,
    scorecard,
)
from isac_track.linkability.significance import (
    LEVEL,
    Outcome,
    minimum_detectable_rank1,
    outcome,
    permutation_p,
    rank1_p,
)

__all__ = ["Calibration", "Outcome", "ProbeRanks", "Scorecard", "Search"]
__all__ += ["GALLERY", "LEVEL", "SCORE_REPLICATES", "assign", "chance", "log_rank"]
__all__ += ["mean_log_rank", "rank1", "rank1_among", "reciprocal_rank", "residual_risk"]
__all__ += [
    "auc",
    "cllr",
    "cllr_min",
    "d_sys",
    "d_sys_published",
    "eer",
    "fit_calibration",
]
__all__ += ["fit_scale", "open_matches"]
__all__ += [
    "minimum_detectable_rank1",
    "outcome",
    "permutation_p",
    "rank1_p",
    "rank_scorecard",
]
__all__ += ["scorecard", "tpr_at_fpr"]
