"""Rank 1 that linkage attacks lose where only some candidates are scored."""

from __future__ import annotations

from collections import defaultdict
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from evaluation.store.linkage_outcomes import read_outcomes

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path

    from evaluation.store.entries import Entry


class _CellLoss(NamedTuple):
    """The loss of rank 1 in a linkage cell; tuples compare by it first."""

    rank1_loss: float
    n_checked: int
    consumer: str
    spec: str


def candidate_losses(out: Path, entries: Iterable[Entry]) -> dict[str, Any]:
    """Return the loss of rank 1 by `linkage.candidates`, by task, as cells measured it.

    Of each task: the number of `cells` of attacks; the number of `probes` of each (the
    fewest) that were searched in full as well; over the cells the mean `loss` of rank
    1, a fraction; and the largest, `most`, with its `consumer` and its mechanism's
    `spec`. Tasks whose pairs are all scored are left out.
    """
    losses_by_task: dict[str, list[_CellLoss]] = defaultdict(list)
    linked = [entry for entry in entries if entry.kind == "linkage"]
    outcomes = read_outcomes(out, linked, drawn=())
    for entry, outcome in zip(linked, outcomes, strict=True):
        if n_checked := outcome.numbers.get("n_checked"):
            rank1_loss = outcome.numbers["rank1_loss"]
            losses_by_task[entry.address.task].append(
                _CellLoss(rank1_loss, n_checked, entry.label, entry.spec)
            )
    summary = {}
    for task, losses in losses_by_task.items():
        largest = max(losses)
        summary[task] = {
            "cells": len(losses),
            "probes": min(loss.n_checked for loss in losses),
            "loss": float(np.mean([loss.rank1_loss for loss in losses])),
            "most": largest.rank1_loss,
            "consumer": largest.consumer,
            "spec": largest.spec,
        }
    return summary
