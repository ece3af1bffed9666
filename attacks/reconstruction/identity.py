"""The control: an adversary who takes what was shared at its word."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from isac_track.types import Knowledge, Reconstruction

if TYPE_CHECKING:
    from isac_track.protocols import AttackContext, Reconstructor


@dataclass(frozen=True, slots=True)
class Identity:
    """Return the shared positions; its descriptors are those as shared, to the last bit."""

    requires: ClassVar[frozenset[Knowledge]] = frozenset()
    uses: ClassVar[frozenset[Knowledge]] = frozenset()

    def fit(self, context: AttackContext) -> Reconstructor:
        """Return what hands a release back."""
        del context
        return lambda release: Reconstruction(release.xy)
