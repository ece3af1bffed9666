"""What the manifest of a run says of the values that were named on its axes."""

from dataclasses import dataclass
from typing import ClassVar

import pytest

from evaluation.plan.settings import Settings
from evaluation.store.describe import named_values
from isac_track.types import Knowledge, Reconstruction


@dataclass(frozen=True)
class OwnAttack:
    """Return the positions as they were shared."""

    requires: ClassVar[frozenset[Knowledge]] = frozenset()
    uses: ClassVar[frozenset[Knowledge]] = frozenset()

    def fit(self, context):  # noqa: ARG002 - it learns nothing
        return lambda release: Reconstruction(release.xy)


@pytest.mark.parametrize(
    ("attacks", "given"),
    [
        (None, None),
        ([], []),
        (["savgol"], ["savgol"]),
        (["+savgol", "+dtw"], ["+savgol", "+dtw"]),
        (["+", OwnAttack(), "savgol"], [f"+{__name__}:OwnAttack", "+savgol"]),
    ],
)
def test_values_are_as_they_are_typed(attacks, given):
    assert named_values(Settings(attacks=attacks), "attacks") == given
