"""What is made of a release is made once, and forgotten with it."""

import weakref

from helpers.walks import smooth_walks

from attacks.remembered import remembered


def test_it_is_made_once_for_each_release_and_dies_with_it():
    made = []

    @remembered
    def counted(release, *rest, factor=1):
        made.append((len(release), rest, factor))
        return len(made)

    one, other = (smooth_walks(3)[0] for _ in range(2))
    asked = [(one, 1), (one, 1), (one, 2), (other, 1), (one, other), (one, 1), (one, other)]
    asked += [(other, one), (one, one), (other, one)]  # nobody keeps itself or its partner alive
    assert [counted(*each) for each in asked] == [1, 1, 2, 3, 4, 1, 4, 5, 6, 5]
    alive = [weakref.ref(each) for each in (one, other)]
    assert counted(one, factor=2) == 7
    assert counted(one, factor=3) == 8
    del one, other, asked, made[:]
    assert [each() for each in alive] == [None, None]
