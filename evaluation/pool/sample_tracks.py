"""Sample tracks of a run, computed for its pictures beside its cells."""

from collections import deque
from collections.abc import Iterator, Mapping
from functools import partial
from typing import Any

import pyarrow as pa

from evaluation.compute.current_cell import Failure, current_cell, note_cell
from evaluation.compute.sample_tracks import sample_mechanisms, sample_rows
from evaluation.plan.plan import Plan
from evaluation.plan.user_plugins import has_user_plugins
from evaluation.pool.workers import spread
from evaluation.store.cell_files import rename_people
from evaluation.store.sample_tracks import save_sample_tracks
from isac_track.errors import PluginError, error_text
from isac_track.plugins import Plugin


def compute_sample_tracks(
    plan: Plan, failed_specs: set[str], names: Mapping[str, str]
) -> list[str]:
    """Compute and save sample tracks without the failed plug-ins; return new failures.

    `failed_specs` has the SPECs of mechanisms and attacks that failed, `names` the
    pseudonym of each person by id.
    """
    axes = plan.axes
    mechanisms = [
        plugin for plugin in axes.mechanisms if plugin.spec not in failed_specs
    ]
    compute = partial(
        _sample_part,
        tracks=plan.scene_tracks,
        attacks=[
            plugin for plugin in axes.scenes.attacks if plugin.spec not in failed_specs
        ],
        stages=plan.settings.stages,
        seed=plan.settings.seed,
    )
    parts: list[pa.Table] = []
    failed = []
    # Workers have loaded all modules that this takes.
    in_workers = plan.jobs > 1 or has_user_plugins(axes)
    limit_s = plan.settings.cell_timeout_s
    works = deque(sample_mechanisms(mechanisms))
    # A single worker returns the few works in their order, and so the file has it.
    for mechanism, result in spread(
        compute, works, jobs=1, limit_s=limit_s, in_workers=in_workers
    ):
        if isinstance(result, Failure):
            failed.append(f"{mechanism.spec}: {result.message}")
        else:
            parts.append(rename_people(result, names))
    save_sample_tracks(parts, out=plan.out)
    return failed


def _sample_part(mechanism: Plugin, **options: Any) -> Iterator[pa.Table | Failure]:  # noqa: ANN401 - handed on
    note_cell(mechanism.spec, "gallery")
    try:
        yield sample_rows(mechanism, **options)
    except PluginError as error:
        yield Failure(current_cell.names, str(error))
    except Exception as error:  # noqa: BLE001 - no picture may cost finished cells
        yield Failure(current_cell.names, error_text(error))
