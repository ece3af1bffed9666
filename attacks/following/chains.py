"""Join pieces of a log to chains, by the most probable assignment.

Every piece has at most one successor and at most one predecessor. Among all such sets
of links the assignment takes the set with the largest product of odds. The odds of a
link are its probability over the probability that the piece is the last of its person.
The algorithm is Jonker and Volgenant's on the sparse graph of candidates.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np

from attacks.following.links import Links, learn_weights, probabilities, true_links
from attacks.following.pieces import Pieces
from isac_track.types import Bools, Floats, Ints

_SMALLEST: Final = 1e-300  # In place of a probability of 0 below the odds.


@dataclass(frozen=True, eq=False, slots=True)
class Chains:
    """The chains that an adversary makes of the K pieces of a log, by C links."""

    chain: Ints  # (K,) number of the chain of each piece.
    probability: Floats  # (C,) of each candidate link.


def follow(pieces: Pieces, links: Links, *, is_first_half: Bools) -> Chains:
    """Return the chains of a log.

    Weights for the pieces of one half of the people are learnt on the other half:
    `is_first_half`, (K,), tells the pieces of the first half. People who walk together
    belong to one half.
    """
    is_next = true_links(pieces, links)
    probability = np.zeros(links.before.size)
    for half in (is_first_half, ~is_first_half):
        weights = learn_weights(links, is_next, learn_from=~half)
        in_half = half[links.before]
        probability[in_half] = probabilities(links, weights)[in_half]
    return Chains(join(links, probability), probability)


def join(links: Links, probability: Floats) -> Ints:
    """Return the chain of each piece, (K,), given probabilities of links, (C,)."""
    from scipy.sparse import coo_array  # noqa: PLC0415 - heavy to import
    from scipy.sparse.csgraph import connected_components  # noqa: PLC0415 - heavy to import

    stop_probability = 1.0 - np.bincount(
        links.before, weights=probability, minlength=links.n_pieces
    )
    with np.errstate(divide="ignore"):  # a link of probability 0 is never chosen
        log_odds = np.log(probability) - np.log(
            np.maximum(stop_probability[links.before], _SMALLEST)
        )
    chosen = _assigned(links, log_odds)
    graph = coo_array(
        (np.ones(chosen.size), (links.before[chosen], links.after[chosen])),
        shape=(links.n_pieces, links.n_pieces),
    )
    _, chain = connected_components(graph, directed=False)
    return np.asarray(chain, dtype=np.int64)


def _assigned(links: Links, log_odds: Floats) -> Ints:
    """Return the numbers of the links of the best assignment.

    A link whose log odds are not above 0 is never chosen.
    """
    from scipy.sparse import coo_array  # noqa: PLC0415 - heavy to import
    from scipy.sparse.csgraph import (  # noqa: PLC0415 - heavy to import
        min_weight_full_bipartite_matching,
    )

    useful = np.flatnonzero(log_odds > 0.0)
    if not useful.size:
        return useful
    n_pieces = links.n_pieces
    # Each piece may also have no successor: a column of its own. Costs are `most` less
    # the log odds. In a full matching each piece has exactly one cost, so that `most`
    # changes no comparison; it keeps costs positive, as a sparse 0 is a missing link.
    most = float(log_odds[useful].max()) + 1.0
    rows = np.concatenate([links.before[useful], np.arange(n_pieces)])
    columns = np.concatenate([links.after[useful], n_pieces + np.arange(n_pieces)])
    costs = np.concatenate([most - log_odds[useful], np.full(n_pieces, most)])
    # The oldest supported scipy takes indices of 32 bits only.
    places = rows.astype(np.int32), columns.astype(np.int32)
    graph = coo_array((costs, places), shape=(n_pieces, 2 * n_pieces)).tocsr()
    row, column = min_weight_full_bipartite_matching(graph)
    partner = np.full(n_pieces, -1)
    partner[row] = column
    return np.asarray(useful[partner[links.before[useful]] == links.after[useful]])
