"""Cards to test on: made-up ones, and those of a small protocol on 20 s of the plaza."""

from dataclasses import replace
from functools import cache

from evaluation.api.card_entries import Seed, cross_entries
from evaluation.api.card_maker import CardMaker
from evaluation.estimates.cards import primary_scores
from evaluation.plan.protocol import read_protocol
from evaluation.store.cards import Card, CardPlugin, CardScore

SMALL = replace(
    read_protocol(),
    attacks=("ou_rts",),
    robots=("least_squares",),
    settings={**read_protocol().settings, "patrol.segment_s": 20.0},
)
"""Intervals need 20 fleets, so that only the time is short."""


def score(value, *, metric="known_share", by="ou_rts", error=0.01):
    """A score with an interval of two standard errors."""
    return CardScore(metric, by, value, value - 2 * error, value + 2 * error, error, 50)


def made_up_card(
    *,
    missed=0.4,
    known=0.3,
    followed=0.2,
    mechanism="ou:0.4",
    policy="everything",
    seed=0,
    protects=True,
    error=0.01,
    weaker=0.25,
    **changes,
):
    """A card with numbers of one's own."""
    protocol = read_protocol()
    scores = (
        score(missed, metric="missed_future_rate", by="kalman_cv", error=error),
        score(weaker, by="log:smooth", error=error),
        score(known, error=error),
        score(followed, metric="followed_10s", by="chains", error=error),
    )
    card = Card(
        protocol_version=protocol.version,
        protocol_digest=protocol.digest,
        recording="plaza",
        recording_digest=protocol.recordings["plaza"],
        law="radial",
        mechanism=CardPlugin(mechanism, "0" * 64, protects),
        mechanism_name=mechanism.partition(":")[0],
        level=None,
        policy=CardPlugin(policy, "1" * 64),
        form="samples",
        seed=seed,
        seed_commitment=Seed(seed).commitment(protocol),
        scores=scores,
        primary=primary_scores(scores, protocol),
        attacks=(CardPlugin("ou_rts", "2" * 64, adversary="informed"),),
        digits=None,
        code_digest="3" * 64,
        environment={"python": "3.11", "numpy": "2", "machine": "Linux x86_64"},
    )
    return replace(card, **changes)


@cache
def small_maker(seed=0):
    """A maker under the small protocol."""
    return CardMaker(Seed(seed), (), SMALL)


@cache
def small_card(mechanism="ou:0.4", policy="everything", seed=0):
    """A card of the plaza under the small protocol."""
    (entry,) = cross_entries(["plaza"], ["radial"], [mechanism], [policy])
    return small_maker(seed).card(entry)
