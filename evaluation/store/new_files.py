"""The new files of a run: which of its missing units of work share a file."""

from __future__ import annotations

import re
from collections.abc import Iterable
from typing import TYPE_CHECKING, NamedTuple

from evaluation.plan.fingerprint import SHARING, digest

if TYPE_CHECKING:
    from collections.abc import Hashable

    from evaluation.plan.units import Unit


class NewFile(NamedTuple):
    """A file of cells to come, and the units that it will hold."""

    name: str
    units: tuple[Unit, ...]


def group_units(missing: Iterable[Unit]) -> list[NewFile]:
    """Return the files that missing units are written to.

    All levels of a block share a file of the section `sharing`: they are computed
    together, in a second or two. A unit of another section has a file of its own, since
    it takes longer, and a killed run keeps it.
    """
    groups: dict[Hashable, list[Unit]] = {}
    for unit in missing:
        group: Hashable = unit
        if unit.section == SHARING:
            group = (unit.section, unit.block, unit.world)
        groups.setdefault(group, []).append(unit)
    return [NewFile(_name(units), tuple(units)) for units in groups.values()]


def _name(units: list[Unit]) -> str:
    first = units[0]
    about = first.section
    if first.section != SHARING:
        about = f"{first.mechanism.spec}_{first.section}"
    slug = re.sub(r"[^A-Za-z0-9.=]+", "-", about)[:80]
    keys = digest([key for unit in units for key in (unit.key, *unit.consumers)])
    return f"{slug}_{first.block:05d}_{keys}.parquet"
