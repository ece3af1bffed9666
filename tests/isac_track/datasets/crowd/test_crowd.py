from collections import Counter
from dataclasses import replace
from functools import cache
from hashlib import sha256
from importlib import import_module
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from helpers.recordings import build_tracks, same

import isac_track
from isac_track import datasets
from isac_track.datasets import crowd
from isac_track.datasets.crowd import CrowdSettings, __main__, model, plan

ROOT = Path(isac_track.__file__).parent.parent

SHORT = CrowdSettings(duration_s=40.0, n_people=70)


@pytest.fixture(scope="module")
def plaza():
    return datasets.load("plaza").tracks


@pytest.fixture(scope="module")
def stats():
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(ROOT))
        return import_module("benchmarks.crowd_table")


# the generator


@cache
def short(*, session=1, seed=5):
    return crowd.generate(SHORT, seed=seed, session=session)


def test_the_generator_makes_the_same_millimetres_unless_seed_or_session_change():
    """The slow tests check the bundled sessions; this is a short one."""
    xy_mm = np.rint(1000 * short().xy).astype("<i8")
    assert sha256(xy_mm.tobytes()).hexdigest()[:16] == "b10c98829f94bbc4"
    for change in ({"seed": 6}, {"session": 2}):
        assert not np.array_equal(short().t, short(**change).t)


def test_last_bits_of_the_machine_do_not_reach_the_tracks(monkeypatch):
    exact = short()
    noise, avoidance = np.random.default_rng(0), model._avoidance

    def with_other_last_bits(*args, **kwargs):
        force = avoidance(*args, **kwargs)
        return force * (1 + 4e-16 * noise.standard_normal(force.shape))

    monkeypatch.setattr(model, "_avoidance", with_other_last_bits)
    assert same(exact, crowd.generate(SHORT, seed=5))


def test_traits_do_not_depend_on_how_many_others_there_are_and_their_spread_scales():
    usual = plan.draw_traits(CrowdSettings(), seed=5)
    assert np.array_equal(plan.draw_traits(SHORT, seed=5), usual[: SHORT.n_people])
    equal = plan.draw_traits(CrowdSettings(trait_strength=0.0), seed=5)
    double = plan.draw_traits(CrowdSettings(trait_strength=2.0), seed=5)
    for name, (median, spread) in plan.TRAIT_MEDIAN_AND_SPREAD.items():
        logs = np.log(usual[name] / median)
        assert logs.std() == pytest.approx(spread, rel=0.1)
        assert np.allclose(np.log(double[name] / median), 2 * logs)
        assert np.allclose(equal[name], median)


# the forces


def test_anticipation_is_the_gradient_of_the_time_to_collision_energy():
    v = np.array([[1.0, 0.1], [-0.4, 0.0]])

    def energy(x):
        dx, dv = x[0] - x[1], v[0] - v[1]
        a, b = dv @ dv, -dx @ dv
        tau = (b - np.sqrt(b**2 - a * (dx @ dx - model.COLLISION_M**2))) / a
        return model.ENERGY_M2 / tau**2 * np.exp(-tau / model.FORESIGHT_S)

    x = np.array([[0.0, 0.0], [4.0, 0.3]])
    step = 1e-6 * np.eye(2)
    first = np.array([[1.0], [0.0]])
    slope = [
        (energy(x + first * shift) - energy(x - first * shift)) / 2e-6 for shift in step
    ]
    force = model._avoidance(x, v, together=np.eye(2, dtype=bool))[0]
    assert np.allclose(force, -np.array(slope), rtol=1e-5)


# the bundled sessions


@pytest.mark.slow
@pytest.mark.parametrize("session", crowd.FILES)
def test_the_bundled_sessions_are_the_generators_output(session):
    made = crowd.generate(CrowdSettings(), seed=crowd.BUNDLED_SEED, session=session)
    path = crowd.bundled_path(session)
    assert same(crowd.read_npz(path), made)
    assert path.stat().st_size < 400_000


def test_plaza_is_in_metres_near_the_place_of_the_real_crowd(plaza):
    assert (plaza.t.min(), plaza.t.max()) == (0.0, pytest.approx(600.0))
    assert np.allclose(np.diff(plaza[0].t), 0.4)
    low, high = np.quantile(plaza.xy, [0.01, 0.99], axis=0)
    assert (low > [-7.5, -7.5]).all()
    assert (high < [9.0, 9.0]).all()
    assert (high - low > 11).all()


def test_people_keep_their_speed_between_the_bundled_sessions(plaza, stats):
    second = datasets.load("plaza-session2").tracks
    assert second.source == plaza.source
    speed_1, speed_2 = stats.moving_speeds_mps(plaza), stats.moving_speeds_mps(second)
    walked = np.isfinite(speed_1) & np.isfinite(speed_2)
    alone = np.ones(len(plaza), dtype=bool)
    for tracks in (plaza, second):
        sizes = Counter(tracks.group)
        alone &= [sizes[name] == 1 for name in tracks.group]
    assert np.corrcoef(speed_1[walked], speed_2[walked])[0, 1] > 0.2
    assert np.corrcoef(speed_1[walked & alone], speed_2[walked & alone])[0, 1] > 0.5


def test_groups_walk_together(plaza):
    rows = pd.Series(range(len(plaza))).groupby(np.array(plaza.group)).agg(list)
    gaps, together = [], []
    for first, other in rows[rows.str.len() == 2]:
        track_1, track_2 = plaza[first], plaza[other]
        _, i, j = np.intersect1d(
            np.rint(track_1.t / 0.4), np.rint(track_2.t / 0.4), return_indices=True
        )
        together.append(i.size / max(track_1.t.size, track_2.t.size))
        gaps.append(np.median(np.hypot(*(track_1.xy[i] - track_2.xy[j]).T)))
    assert np.quantile(together, 0.05) > 0.7
    assert 0.4 < np.median(gaps) < 1.0
    assert np.quantile(gaps, 0.95) < 1.5


def test_company_is_new_in_the_second_session(plaza):
    parties = [
        set(
            pd.DataFrame({"person": tracks.source, "party": tracks.group})
            .groupby("party")
            .person.agg(tuple)
        )
        for tracks in (plaza, datasets.load("plaza-session2").tracks)
    ]
    assert sum(len(members) > 1 for members in parties[0] & parties[1]) <= 2


def documented(column):
    """A column of the table in the document."""
    text = (
        (ROOT / "docs" / "explanation" / "plaza.md")
        .read_text()
        .partition("| statistic |")[2]
    )
    text = text.partition("\n\n")[0]  # other tables follow
    rows = [
        line.split("|")[1:-1] for line in text.splitlines()[2:] if line.startswith("| ")
    ]
    return {cells[0].strip(): float(cells[column]) for cells in rows}


def test_plaza_resembles_students03_as_the_document_says(plaza, stats):
    plaza_statistics = stats.statistics(plaza)
    assert documented(1) == pytest.approx(plaza_statistics, rel=1e-3)
    real = documented(3)
    for name in real.keys() - {"tracks"}:
        assert plaza_statistics[name] == pytest.approx(real[name], rel=0.2), name


@pytest.mark.usefixtures("ucy")
def test_the_document_tells_students03(stats):
    measured = stats.statistics(datasets.load("students03").tracks)
    assert documented(3) == pytest.approx(measured, rel=1e-3)


# the file


def test_the_command_writes_both_sessions_and_a_file_gives_back_the_millimetres(
    tmp_path, monkeypatch, capsys
):
    monkeypatch.setattr(
        __main__, "CrowdSettings", lambda **changes: replace(SHORT, **changes)
    )
    assert __main__.main(["--out", str(tmp_path / "new"), "--seed", "5"]) == 0
    for session, name in crowd.FILES.items():
        made = short(session=session)
        assert same(crowd.read_npz(tmp_path / "new" / name), made)
        assert made.source == tuple(
            plan.person_id(row) for row in range(SHORT.n_people)
        )
    assert capsys.readouterr().out.count("70 tracks") == 2


def test_the_statistics_by_hand(stats):
    # 1 m/s east for 1.6 s, then north: one turn of 90 degrees, sampled across the
    # corner.
    corner = build_tracks(
        [(0, 0), (0.4, 0), (0.8, 0), (0.8, 0.4), (0.8, 0.8)], [(5, 5)] * 2
    )
    assert np.allclose(stats.step_speeds_mps(corner), [1, 1, 1, 1, 0])
    assert np.allclose(stats.turn_rates_dps(corner), 90 / 0.8)
    assert np.allclose(stats.moving_speeds_mps(corner), [1.0, np.nan], equal_nan=True)
    people = build_tracks([(0, 0), (0, 0)], [(3, 4), (0, 1)], [(9, 9)])
    nearest, present = stats.neighbour_distances_m(people)
    assert present.tolist() == [3, 2]
    assert np.allclose(sorted(nearest), [1, 1, 5, 5, np.hypot(6, 5)])
    t = 0.4 * np.arange(80)
    straight, bent = (
        build_tracks(np.stack([x, -0.5 * t], axis=1)) for x in (t, 0.05 * t**2)
    )
    assert stats.line_errors_m(straight) == pytest.approx([0.0], abs=1e-9)
    # x = a t^2 / 2: the line through a window of length w, at h past its end, errs by
    # a / 2 * (h^2 + h w + w^2 / 6) in the limit of many samples.
    expected = 0.05 * (0.917**2 + 0.917 * 1.25 + 1.25**2 / 6)
    assert stats.line_errors_m(bent)[0] == pytest.approx(expected, rel=0.25)
