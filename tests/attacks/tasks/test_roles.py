"""Who counts as one cluster: walking groups of either session, joined as far as they reach."""

from helpers.strategies import reproducible
from hypothesis import given
from hypothesis import strategies as st

from attacks.tasks.roles import joined

GROUP = st.sampled_from("abcdef")
PEOPLE = st.lists(st.tuples(GROUP, GROUP), min_size=1, max_size=12)


def reached(people, one):
    """Brute force: whoever shares a group with somebody reached, again and again."""
    found = {one}
    while True:
        more = {
            other
            for other, (first, second) in enumerate(people)
            if any(first == people[known][0] or second == people[known][1] for known in found)
        }
        if more == found:
            return found
        found = more


@reproducible
@given(PEOPLE)
def test_a_cluster_is_whoever_can_be_reached_over_shared_groups(people):
    """It has the first name of its groups in the first session."""
    cluster = joined([first for first, _ in people], [second for _, second in people])
    for one, name in enumerate(cluster):
        within = reached(people, one)
        assert {k for k in range(len(people)) if cluster[k] == name} == within
        assert type(name) is str
        assert name == min(people[other][0] for other in within)


def test_groups_of_the_same_name_in_different_sessions_are_different_groups():
    assert joined(["a", "b"], ["b", "c"]) == ("a", "b")
