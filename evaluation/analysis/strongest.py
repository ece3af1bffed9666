"""The strongest attacks of a run: those that the verdict is about."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from evaluation.analysis.matching import Measure
from evaluation.experiment.presets import SHARED

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from evaluation.analysis.summary import Key
    from isac_track.intervals import Estimate

SWEPT: Final = ("raw", "fixed", "fid")
"""Families whose levels the strongest attack of a run is chosen by."""
_REFERENCE: Final = "oracle"
"""Adversary who is granted all: a reference, never the headline."""


def strongest_linkers(
    found: Mapping[Key, Estimate], *, mechanism: str | None = None
) -> dict[str, Measure]:
    """Return the strongest linker of every task, by its highest mean rank 1.

    The reference adversary (oracle) is left out.

    Parameters
    ----------
    found : mapping
    mechanism : str, optional
        Against this one; by default over all levels of raw, fixed noise and FID, so that the
        choice favours none of them.
    """
    best: dict[str, tuple[float, Measure]] = {}
    means = _means(
        found,
        "rank1",
        lambda name: name.partition(":")[0] in SWEPT if mechanism is None else name == mechanism,
    )
    for measure, mean in means.items():
        task, _, linker = measure.consumer.partition("/")
        if not linker or linker.startswith("control-"):
            continue
        if task not in best or mean > best[task][0]:
            best[task] = mean, measure
    return {task: measure for task, (_, measure) in best.items()}


def strongest_reconstruction(found: Mapping[Key, Estimate]) -> Measure | None:
    """Return the reconstruction with the highest mean PLR over all sweep levels, if any."""
    means = {
        measure: mean
        for measure, mean in _means(
            found, "plr", lambda name: name.partition(":")[0] in SWEPT
        ).items()
        if measure.consumer != SHARED and measure.knowledge
    }
    return max(means, key=means.__getitem__, default=None)


def _means(
    found: Mapping[Key, Estimate], metric: str, counts: Callable[[str], bool]
) -> dict[Measure, float]:
    """Return the mean over the levels that count, of attacks that ran at all of them."""
    values: dict[Measure, list[float]] = {}
    for key, one in found.items():
        if key.metric == metric and key.knowledge != _REFERENCE and counts(key.mechanism):
            values.setdefault(Measure(key.consumer, metric, key.knowledge), []).append(one.value)
    most = max((len(one) for one in values.values()), default=0)
    means = {measure: float(np.mean(one)) for measure, one in values.items() if len(one) == most}
    return {measure: mean for measure, mean in means.items() if np.isfinite(mean)}
