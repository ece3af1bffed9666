"""Stronger adversaries against the levels that would be proposed, in a single pass.

They attack the levels that a run would propose to its default question: those that hold
all limits, else those with no limit broken, else the nearest (`candidates` in
`evaluation.verdict.what_to_share`). All others stay untried. A level that is refused
stays refused whatever these adversaries do: more knowledge only raises the risk.

The default question gives no limit to these adversaries, so their numbers stand beside
a proposal and do not remove it. Under a question with such a limit
(`Question.against`) a level that breaks it is refused, and one that was not tried has no
answer (`level_checks`). No further level is then attacked in its place.
"""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from evaluation.api.run_estimates import level_table, link_estimates, scene_estimates
from evaluation.estimates.families import CLEAN, RAW, entry_families
from evaluation.estimates.strongest_table import strongest_attacks
from evaluation.plan.address import Address, MechanismLevel
from evaluation.plan.plan import Plan, plan_stronger
from evaluation.plan.source_digest import changed_modules
from evaluation.pool.execute import execute_stronger
from evaluation.store.entries import Entry
from evaluation.store.manifest import read_manifest, write_manifest
from evaluation.verdict.level_rows import leading_handover
from evaluation.verdict.question import default_question
from evaluation.verdict.what_to_share import recommend


def try_stronger(plan: Plan, update: Callable[[int, int, str], None]) -> None:
    """Let stronger adversaries attack the levels that would be proposed.

    Not if a source was edited while the cells were computed: those cells would count
    as of another code version, and be dropped. The manifest then names the modules.
    """
    all_specs = [plugin.spec for plugin in plan.axes.mechanisms]
    if not plan_stronger(plan, specs=all_specs).units:
        return
    manifest = read_manifest(plan.out)
    if edited := changed_modules(plan.code_digests):
        write_manifest(plan.out, manifest | {"edited_modules": edited})
        return
    entries = _proposal_entries(manifest["cells"])
    proposed = _proposed_levels(plan.out, manifest | {"cells": entries})
    specs = [
        entry.spec for entry in entries if entry.address.mechanism_level in proposed
    ]
    # All cells of the run are finished: these few are not counted among them.
    n_cells = plan.n_cells

    def report(_done: int, _total: int, cell: str) -> None:
        update(n_cells, n_cells, f"levels to propose: {cell}")

    execute_stronger(plan_stronger(plan, specs=specs), report)


def _proposal_entries(entries: Sequence[Entry]) -> list[Entry]:
    """Return the entries that proposed levels rest on.

    They are of protections, raw and clean, at all horizons; of the linkage tasks only
    the leading handover.
    """
    names = {
        name
        for name, family in entry_families(entries).items()
        if family.protects or family.family in (RAW, CLEAN)
    }
    leading = leading_handover({entry.address.task for entry in entries})

    def is_wanted(address: Address) -> bool:
        in_world = not (address.world.law or address.world.is_model)
        return address.mechanism in names and address.task in ("", leading) and in_world

    return [entry for entry in entries if is_wanted(entry.address)]


def _proposed_levels(out: Path, manifest: Mapping[str, Any]) -> set[MechanismLevel]:
    """Return mechanism and level of each level that would be proposed now."""
    families = entry_families(manifest["cells"])
    scenes, links = scene_estimates(out, manifest), link_estimates(out, manifest)
    attacks = strongest_attacks(
        {**scenes.estimates, **links.estimates}, links.sums | scenes.attacked, families
    )
    table = level_table(manifest, scenes, links, attacks=attacks)
    dataset, question = manifest["dataset"]["name"], default_question(families)
    offers = recommend(table, question, dataset=dataset).candidates
    return {offer.mechanism_level for offer in offers}
