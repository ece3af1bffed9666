"""Linked people, read once: against the summary and the rows of each cell."""

import numpy as np
import pytest
from helpers.addresses import address_at
from helpers.runs import stored_rows
from helpers.small_runs import smoke, write_walks

import evaluation
from evaluation.estimates.families import entry_families
from evaluation.estimates.linked_people import LinkedProbes, read_probes, sum_by_cluster
from evaluation.estimates.strongest import first_half
from evaluation.estimates.sweeps import Sweeps
from evaluation.plan.address import parse_consumer
from evaluation.store.manifest import read_manifest
from isac_track.intervals import Estimate

TASKS = {
    "rerelease": parse_consumer("rerelease/shape", "blind"),
    "split": parse_consumer("split/shape", "blind"),
}
SPECS = {
    ("raw", None): "raw",
    ("fixed", 0.7): "fixed:0.7",
    ("offset", 0.3): "offset:0.3",
}


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("linked")
    settings = smoke(
        write_walks(folder / "walks.csv"),
        folder / "run",
        attacks=("shape", "profile"),
        tasks=tuple(TASKS),
        mechanisms=tuple(SPECS.values()),
    )
    results = evaluation.run(settings, pictures=False)
    result = {
        address_at(
            row.mechanism,
            None if np.isnan(row.level) else row.level,
            row.consumer,
            row.metric,
            row.knowledge,
        ): Estimate(row.value)
        for row in results.summary.fillna({"knowledge": ""}).itertuples()
    }
    manifest = read_manifest(settings.out)
    sweeps = Sweeps(result, entry_families(manifest["cells"]))
    return (
        result,
        settings.out,
        read_probes(settings.out, manifest, sweeps, strongest=TASKS),
    )


def test_sums_over_clusters_are_the_summary_and_the_windows_of_who_is_linked(run):
    numbers, out, probes = run
    for task in sum_by_cluster(probes):
        assert task.gallery is None  # of thirty people
        assert [(item.mechanism, item.level) for item in task.levels] == list(SPECS)
        for item in task.levels:
            for name, sums in (("rank1", item.success), ("chance", item.chance)):
                expected = numbers[
                    address_at(
                        item.mechanism,
                        item.level,
                        item.linker.consumer,
                        name,
                        item.linker.adversary,
                    )
                ]
                assert sums.sum() / item.probes.sum() == pytest.approx(expected.value)
            spec = SPECS[item.mechanism, item.level]
            rows = stored_rows(out, spec, item.linker.consumer, item.linker.adversary)
            linked = rows[rows["above"] >= 0]
            windows = stored_rows(out, spec, f"{task.task}/windows")
            own_windows = windows.merge(
                linked[["search", "source"]], on=["search", "source"]
            )
            assert len(own_windows) == 2 * len(linked) == 2 * item.probes.sum()
            total, n = item.descriptors["ael"]
            own = own_windows.groupby("group", observed=True)["ael_s"].agg(
                ["sum", "count"]
            )
            assert list(own.index) == list(task.clusters)
            assert total == pytest.approx(own["sum"].to_numpy())
            assert n.tolist() == own["count"].tolist()


def test_other_mechanisms_are_linked_by_whoever_is_strongest_there(run):
    numbers, _, probes = run
    for task, linker in TASKS.items():
        linkers = {item.mechanism: item.linker for item in probes[task]}
        rivals = {}
        for rule in (
            "rank1",
            "rank1_assigned",
        ):  # a linker counts by the better of both
            for key, item in numbers.items():
                is_linker = key.adversary and key.reader.task == task
                if key.mechanism == "offset" and key.metric == rule and is_linker:
                    reader = key.reader
                    rivals[reader] = max(item.value, rivals.get(reader, 0.0))
        assert len(rivals) > 1
        assert linkers == {
            "raw": linker,
            "fixed": linker,
            "offset": max(rivals, key=rivals.get),
        }


@pytest.mark.parametrize(
    ("among", "gallery"), [([0.5, 1.0, 0.0], 100), ([0.5, np.nan, 0.0], None)]
)
def test_of_a_hundred_candidates_where_all_have_as_many(among, gallery):
    hit, chance = np.array([1.0, 1.0, 0.0]), np.full(3, 1 / 120)
    shown = np.array([[0.1, np.nan], [0.2, 0.4], [np.nan, np.nan]])
    result = LinkedProbes(
        "raw",
        None,
        TASKS["split"],
        hit,
        np.array(among),
        chance,
        np.array([0, 0, 1]),
        ("a", "b"),
        {"plr": shown},
        np.zeros((3, 1)),
        np.ones((3, 3), dtype=int),
    )
    (task,) = sum_by_cluster({"split": [result]})
    (level,) = task.levels
    assert (task.gallery, task.clusters) == (gallery, ("a", "b"))
    assert level.success.tolist() == ([1.5, 0.0] if gallery else [2.0, 0.0])
    assert level.chance == pytest.approx(
        [2 * (0.01 if gallery else 1 / 120), 0.01 if gallery else 1 / 120]
    )
    assert level.probes.tolist() == [2.0, 1.0]
    assert level.descriptors["plr"] == pytest.approx(np.array([[0.7, 0.0], [3.0, 0.0]]))


def test_each_half_of_the_people_is_linked_by_whom_the_other_half_chose(run):
    numbers, out, _ = run
    manifest = read_manifest(out)
    sweeps = Sweeps(numbers, entry_families(manifest["cells"]))
    linker, other = TASKS["rerelease"], parse_consumer("rerelease/profile", "blind")
    pair = [linker.measured("rank1"), other.measured("rank1_assigned")]
    choices = {("rerelease", ""): {"rank1": pair}}
    read = read_probes(out, manifest, sweeps, strongest=TASKS, choices=choices)
    for level in read["rerelease"][:2]:
        spec = SPECS[level.mechanism, level.level]
        first, second = (
            stored_rows(out, spec, reader.consumer, reader.adversary)
            for reader in (linker, other)
        )
        is_first = first_half(level.clusters)[level.cluster]
        by_rank = np.where(first["above"] == 0, 1.0 / first["tied"].clip(lower=1), 0.0)
        joint = (second["assigned"] == "mate").to_numpy() * 1.0
        mated = (first["above"] >= 0).to_numpy()
        assert 0 < is_first.sum() < is_first.size
        assert (
            level.hit.tolist()
            == np.where(is_first, joint[mated], by_rank[mated]).tolist()
        )
