"""Addresses: their text in columns, labels and worlds, there and back."""

import math
from dataclasses import replace

import pandas as pd
import pytest
from helpers.small_runs import smoke, write_walks
from helpers.strategies import reproducible
from hypothesis import given
from hypothesis import strategies as st

from evaluation.api import run
from evaluation.plan.address import (
    AS_SHARED,
    Address,
    PolicyParts,
    control_name,
    is_track_release,
    parse_consumer,
    parse_dataset,
    parse_label,
    parse_policy,
    parse_row,
    plugin_name,
    policy_text,
    track_release_text,
)
from evaluation.plan.constants import TRACK_RELEASES
from evaluation.plan.world import OWN_WORLD, WORLDS, World, parse_world
from isac_track.protocols import ADVERSARIES

CONSUMERS = {
    "shared": AS_SHARED,
    "bound": Address(plugin="bound"),
    "kalman_cv:aware=true": Address(plugin="kalman_cv:aware=true"),
    "radial_rts": Address(plugin="radial_rts"),
    "rerelease/dtw": Address(task="rerelease", plugin="dtw"),
    "handover-1s/dtw:band=0.1@kalman_rts": Address(
        task="handover-1s", plugin="dtw:band=0.1", reconstruction="kalman_rts"
    ),
    "split/control-times": Address(task="split", plugin=control_name("times")),
    "split/bound": Address(task="split", plugin="bound"),
    "split/windows": Address(task="split", plugin="windows"),
    "mine.attacks:Mine:file=a/b.csv": Address(plugin="mine.attacks:Mine:file=a/b.csv"),
}

names = st.from_regex(r"[a-z][a-z0-9_]{0,9}", fullmatch=True)
specs = st.builds(
    lambda name, values: ":".join(filter(None, [name, ",".join(values)])),
    names,
    st.lists(st.builds("{}={}".format, names, st.integers(0, 99)), max_size=2),
)
tasks = st.sampled_from(["", "rerelease", "handover-1s", "cross_session"])
worlds = st.builds(
    World,
    is_model=st.booleans(),
    law=st.sampled_from(["", "isotropic", "radial"]),
    horizon_s=st.none() | st.integers(1, 9999).map(lambda n: n / 100),
)


@st.composite
def addresses(draw):
    """Addresses of all kinds, of one recording."""
    task, plugin = draw(tasks), draw(specs)
    behind = draw(st.just("") | specs) if task else ""
    if task and not behind and draw(st.booleans()):
        plugin = control_name(draw(names))
    return Address(
        recording=draw(names),
        world=draw(worlds),
        mechanism=draw(specs),
        level=draw(st.none() | st.floats(0.0, 1e6)),
        policy=draw(st.just("") | names),
        task=task,
        plugin=plugin,
        reconstruction=behind,
        adversary=draw(st.sampled_from(["", *ADVERSARIES])),
        metric=draw(names),
    )


@reproducible
@given(addresses())
def test_the_columns_of_an_address_say_all_of_it(address):
    row = address.to_columns() | {"policy": address.policy}
    assert parse_row(row) == address
    assert parse_dataset(address.dataset) == Address(
        recording=address.recording, world=address.world
    )


@reproducible
@given(addresses(), st.booleans())
def test_a_label_says_who_reads_where(address, is_joint):
    metric = "rank1_assigned" if is_joint else ""
    reader = replace(address.reader, world=address.world, metric=metric)
    assert parse_label(reader.cell_label) == reader
    assert parse_label(reader.label) == replace(reader, world=OWN_WORLD)


@pytest.mark.parametrize("world", [OWN_WORLD, World(horizon_s=3.0)])
@pytest.mark.parametrize("policy", ["flag", "ahead:2,window_s=4,horizon_s=4.1"])
@pytest.mark.parametrize("adversary", ["", "blind"])
def test_a_label_says_under_which_policy(world, policy, adversary):
    reader = Address(world=world, policy=policy, plugin="log", adversary=adversary)
    assert parse_label(reader.cell_label) == reader


@pytest.mark.parametrize(
    ("text", "parts"),
    [
        ("", ("", "")),
        ("near:3,window_s=2", ("", "near:3,window_s=2")),
        ("mine.policies:Mine:policy=2", ("", "mine.policies:Mine:policy=2")),
        ("detections:gnn", ("detections:gnn", "")),
        ("tracks:jpda:gate=3", ("tracks:jpda:gate=3", "")),
        (
            "tracks:gnn,noise=before,policy=near:3,window_s=2",
            ("tracks:gnn,noise=before", "near:3,window_s=2"),
        ),
    ],
)
def test_the_column_policy_has_a_release_of_tracks_and_a_policy(text, parts):
    assert parse_policy(text) == PolicyParts(*parts)
    assert policy_text(track_release=parts[0], policy=parts[1]) == text
    assert is_track_release(text) == bool(parts[0])


@reproducible
@given(st.sampled_from(TRACK_RELEASES), specs, st.booleans(), st.just("") | specs)
def test_a_release_of_tracks_comes_back_with_its_policy(
    form, tracker, has_noise_before, policy
):
    release = track_release_text(form, tracker, has_noise_before=has_noise_before)
    text = policy_text(track_release=release, policy=policy)
    assert parse_policy(text) == PolicyParts(release, policy)


@pytest.mark.parametrize(("text", "address"), CONSUMERS.items(), ids=str)
def test_a_consumer_has_its_parts(text, address):
    assert parse_consumer(text) == address
    assert address.consumer == text
    assert parse_consumer(text, "blind") == replace(address, adversary="blind")


def test_only_a_control_of_a_task_is_a_control():
    assert parse_consumer("split/control-times").control == "times"
    assert parse_consumer("control-times").control == ""
    assert parse_consumer("split/dtw").control == ""


def test_a_part_of_an_address_stands_for_all_that_it_leaves_out():
    number = replace(
        parse_consumer("split/dtw@kalman_rts", "informed"),
        mechanism="fid",
        level=1.0,
        metric="rank1",
    )
    assert number.mechanism_level == ("fid", 1.0)
    assert number.measure.at("fid", 1.0) == number
    assert number.reader == parse_consumer("split/dtw@kalman_rts", "informed")
    assert number.reader.measured("rank1") == number.measure
    assert number.reader.without_task.label == "dtw@kalman_rts (informed)"
    assert number.attack_spec == "dtw@kalman_rts"
    assert math.isnan(replace(number, level=None).to_columns()["level"])
    # It follows from the mechanism: not a second number.
    assert replace(number, adding="linear") == number


def test_a_name_is_a_spec_without_its_parameters():
    assert plugin_name("fid:adding=independent") == "fid"
    assert plugin_name("raw") == "raw"


def test_a_world_has_one_name():
    assert not OWN_WORLD
    assert OWN_WORLD.text == ""
    assert [world.text for world in WORLDS] == [
        "law=isotropic",
        "model",
        "model,law=isotropic",
    ]
    assert World(horizon_s=3.0).text == "horizon=3s"
    assert parse_world("horizon=1.5s") == World(horizon_s=1.5)
    for name in (
        "students03",
        "models",
        "modellaw=isotropic",
        "law=",
        "law=isotropic,model",
        "horizon=",
        "horizon=s",
        "horizon=3",
        "horizon=03s",
        "xhorizon=3s",
        ",horizon=3s",
    ):
        assert parse_world(name) is None


def test_a_data_set_without_a_world_may_have_a_colon():
    assert parse_dataset("site:north") == Address(recording="site:north")
    assert parse_dataset("site:north:model") == Address(
        recording="site:north", world=World(is_model=True)
    )
    assert parse_dataset("model") == Address(recording="model")


def test_every_row_and_cell_of_a_run_has_an_address_that_gives_its_columns(tmp_path):
    settings = smoke(
        write_walks(tmp_path / "walks.csv"),
        tmp_path / "run",
        mechanisms=("raw", "fid:1"),
        attacks=("radial_rts", "shape", "shape@radial_rts"),
        tasks=("rerelease",),
        stages={"conflict.horizons_s": (3.0,)},
    )
    made = run(settings, progress=False, pictures=False)
    for frame in (made.summary, made.levels, made.linkability):
        addresses = [parse_row(row) for row in frame.to_dict("records")]
        columns = pd.DataFrame([address.to_columns() for address in addresses])
        known = [name for name in columns if name in frame]
        pd.testing.assert_frame_equal(
            columns[known], frame[known].fillna({"knowledge": ""}), check_dtype=False
        )
    worlds_seen = {parse_row(row).world for row in made.summary.to_dict("records")}
    assert worlds_seen == {OWN_WORLD, World(horizon_s=3.0)}
    for entry in made.manifest["cells"]:
        address = entry.address
        reader = replace(address, mechanism="", level=None)
        assert parse_label(entry.label) == reader
        assert parse_row(entry.level_fields() | entry.consumer_fields()) == address
