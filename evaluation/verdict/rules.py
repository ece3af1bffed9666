"""Rules of the verdict: margins, the fewest people, and the names of decisions.

All of them were set before looking at results. The decision itself is in `spread`
(validity) and `bands` (all else); docs/explanation/verdict.md describes it.
"""

from typing import Final

from evaluation.estimates.metrics import DESCRIPTORS, METRICS

NAME: Final = {name: METRICS[name].head for name in DESCRIPTORS}
"""Descriptors as people write them: PLR, AEL, MEL."""
VALIDITY, WITHIN, CLAIM, INFLATION = "validity", "within", "claim", "inflation"
SECTIONS: Final = (VALIDITY, WITHIN, CLAIM, INFLATION)

# Decisions. Each section has a pair of answers; the last pair occurs in all sections.
TRACKS, DOES_NOT = "tracks", "does not track"
HOLDS, REVERSED = "holds", "reversed"
INFLATED, DEFLATED = "inflated", "deflated"
BETWEEN, NOT_TESTABLE = "between", "not testable"
SIGN: Final = {  # Of a decision; 0: nothing is decided.
    **dict.fromkeys((TRACKS, HOLDS, INFLATED), 1),
    **dict.fromkeys((BETWEEN, NOT_TESTABLE), 0),
    **dict.fromkeys((DOES_NOT, REVERSED, DEFLATED), -1),
}
DIFFERS, EQUAL = "differs", "equal"  # Readings of a contrast by itself.
# Kinds of evidence.
CONSTRUCTION: Final = "construction"  # The task hides what the mechanism changes.
SHOWN: Final = "shown"  # More people are linked.
ATTACKS: Final = "attacks"  # Fewer people are linked, as far as these attacks go.

# Share of studies in which the bands of a section hold all truths.
BAND_COVERAGE: Final = 0.992
# Largest difference in rank 1 that counts as none: five people in a hundred.
SUCCESS_MARGIN: Final = 0.05
# Least ratio of a descriptor, raw over the strongest fixed error, for a decision.
LEAST_SPAN: Final = 1.25
LEAST_CORRELATION: Final = 0.10  # Partial rank correlation that tells something.
# Least fall of linkage from raw to the strongest fixed error: with less, any descriptor
# would track.
LEAST_FALL: Final = 0.20
# Fewest people linked under only one of two mechanisms; fewer: interval of counts.
FEWEST_DISCORDANT: Final = 10
NO_SPREAD: Final = 1e-9  # Standard error below which replicates show nothing.
# Share of its span by which a point may lie beyond the fixed sweep.
REACH: Final = 0.02


def is_flat_miss(decision: str, spread_low: float | None) -> bool:
    """Return whether an item does not track only because its descriptor is flat.

    `spread.decide` has two grounds for `DOES_NOT`: a spread that is surely above the
    margin, or linkage that falls while the descriptor hardly changes. Without the first
    it was the second.
    """
    return decision == DOES_NOT and (spread_low or 0.0) <= SUCCESS_MARGIN
