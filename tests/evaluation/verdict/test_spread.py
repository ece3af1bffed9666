"""Ends of a spread against closed forms, scipy and simulation; and the decision."""

from dataclasses import fields, replace

import numpy as np
import pytest
from scipy.special import stdtrit
from scipy.stats import binomtest, norm, t

from evaluation.verdict import curves, power, rules, spread
from evaluation.verdict.contrasts import (
    Contrasts,
    Discordant,
    FixedRange,
    standard_error,
)
from evaluation.verdict.curves import (
    BOTH,
    NEITHER,
    ONLY_FEWER,
    ONLY_MORE,
    FixedNoise,
)
from evaluation.verdict.prediction_error import prediction_errors

MANY = 1e6
"""Degrees of freedom with which t is normal."""


def contrasts(gaps, errors, *, rng=None, n_drawn=4000, **changed):
    """Return independent contrasts with normal replicates.

    `changed` are fields of the contrasts, or of their range of fixed noise.
    """
    rng = rng or np.random.default_rng(0)
    gaps, errors = np.array(gaps, dtype=float), np.array(errors, dtype=float)
    k = gaps.size
    default = Contrasts(
        gaps=np.vstack([gaps, gaps + errors * rng.normal(size=(n_drawn, k))]),
        errors=errors,
        side=np.full(k, BOTH),
        degrees=np.full(k, MANY),
        people=np.full(k, 100),
        discordant=Discordant(*np.full((3, k), 50.0)),
        decides=np.full(k, True),
        fixed=FixedRange(
            fall=np.full(1 + n_drawn, 0.5)
            + 0.01 * np.append(0.0, rng.normal(size=n_drawn)),
            span=np.full(1 + n_drawn, 1.0),
            fall_error=0.01,
            span_error=0.01,
            degrees=MANY,
        ),
        is_whole=True,
    )
    arrays = {
        name: value if isinstance(value, Discordant) else np.array(value)
        for name, value in changed.items()
    }
    range_names = {field.name for field in fields(FixedRange)} - {"degrees"}
    in_range = {name: arrays.pop(name) for name in range_names & arrays.keys()}
    if "fixed_degrees" in arrays:
        in_range["degrees"] = float(arrays.pop("fixed_degrees"))
    return replace(default, fixed=replace(default.fixed, **in_range), **arrays)


def decision(item, section=None):
    deviation = item.largest_deviation if section is None else section
    widths = spread.interval_widths(item, deviation)
    fixed = item.fixed
    answers = spread.decide(
        item, widths, gaps=item.gaps[:1], fall=fixed.fall[:1], span=fixed.span[:1]
    )
    decided = spread.ANSWERS[answers.codes[0]]
    return decided, float(answers.low[0]), float(answers.high[0])


class TestParts:
    def test_the_jackknife_of_a_mean_is_its_standard_error(self):
        x = np.random.default_rng(0).normal(size=12)
        left_out = (x.sum() - x)[:, None] / 11
        se = x.std(ddof=1) / np.sqrt(12)
        assert standard_error(np.zeros((5, 1)), left_out) == pytest.approx([se])
        drawn = np.array([[-9.0], [9.0]])  # replicates that show more
        assert standard_error(drawn, left_out) == pytest.approx(drawn.std(ddof=1))

    @pytest.mark.parametrize(("more", "fewer"), [(0, 0), (3, 0), (2, 5), (60, 0)])
    def test_exact_ends_are_those_of_two_binomials(self, more, fewer):
        n = 60
        low, high = spread.exact_difference_ends(
            np.array([more / n]), np.array([fewer / n]), np.array([float(n)]), 0.025
        )
        up, down = (binomtest(hits, n).proportion_ci(0.975) for hits in (more, fewer))
        assert low[0] == pytest.approx(up.low - down.high)
        assert high[0] == pytest.approx(up.high - down.low)

    def test_gaps_are_those_of_a_curve_drawn_by_hand(self):
        fixed = np.array([[0.1, 0.3, 0.5]]), np.array([[0.2, 0.4, 0.9]])
        at = np.array([[0.05, 0.2, 0.4, 0.5, 0.6]])
        beside = curves.compare_with_fixed(at, np.full((1, 5), 0.5), FixedNoise(*fixed))
        curve = np.interp(
            at[0], *(curve_values[0] for curve_values in fixed)
        )  # flat beyond its ends
        assert beside.gaps[0] == pytest.approx(0.5 - curve)
        assert beside.side.tolist() == [ONLY_MORE, BOTH, BOTH, BOTH, ONLY_FEWER]
        assert curves.level_shares(beside.places, 3) @ fixed[1][0] == pytest.approx(
            curve
        )

    def test_fid_is_read_at_quarter_points_of_the_common_range_of_the_logarithm(self):
        fid, fixed = np.array([[0.01, 0.1, 1.0]]), np.array([[0.0001, 1.0]])
        read = curves.read_at_quarter_points(fid, np.log10(fid) + 2, fixed)
        at = read.descriptor
        assert at[0] == pytest.approx(0.01 ** np.array([0.75, 0.5, 0.25]))
        assert read.success[0] == pytest.approx(np.interp(at[0], fid[0], [0, 1, 2]))


class TestEnds:
    def test_with_one_contrast_they_are_those_of_t(self):
        item = contrasts([0.2], [0.02], degrees=[24.0])
        answer, low, high = decision(item)
        q, half = (t.ppf(p, 24) for p in (norm.cdf(norm.ppf(0.9875)), 0.975))
        assert answer == rules.DOES_NOT
        assert low == pytest.approx(0.2 - 0.02 * q, abs=0.002)
        assert high == pytest.approx(0.2 + 0.02 * half)

    def test_where_all_are_equal_half_are_shown_as_zero_and_the_page_errs_in_2_5_pct(
        self,
    ):
        rng, errors = np.random.default_rng(1), np.full(8, 0.02)
        item = contrasts(np.zeros(8), errors)
        shown, lower = [], []
        for gaps in 0.02 * rng.normal(size=(1500, 8)):
            there = replace(item, gaps=item.gaps + gaps)
            shown.append(spread.median_unbiased_spread(there))
            lower.append(decision(there, section=item.largest_deviation)[1])
        assert np.mean(np.array(shown) > 0) == pytest.approx(0.5, abs=0.04)
        assert np.mean(np.array(lower) > 0) == pytest.approx(0.025, abs=0.013)

    def test_few_who_differ_have_counts_for_an_interval_and_stay_out_of_the_rest(self):
        few = np.array([[50.0, 0.0], [50.0, 0.0], [50.0, 0.0]])
        item = contrasts(
            [0.0, 0.0], [0.01, 1e-12], degrees=[99.0, 99.0], discordant=Discordant(*few)
        )
        assert item.largest_deviation == pytest.approx(np.abs(item.gaps[1:, 0]) / 0.01)
        assert spread.interval_widths(item, item.largest_deviation).up[
            1
        ] == pytest.approx(1 - 0.0125 ** (1 / 100))
        expected = [stdtrit(99.0, 0.975) * 0.01, 1 - 0.0125 ** (1 / 100)]
        for ends, sign in zip(spread.gap_intervals(item), (-1.0, 1.0), strict=True):
            assert sign * ends == pytest.approx(np.array(expected))

    def test_where_only_counts_are_left_the_error_of_the_descriptor_still_widens_them(
        self,
    ):
        """Counts tell of linkage; the standard error also of the point on the curve."""
        few = {
            "degrees": [21.0],
            "discordant": Discordant(*np.array([[0.19], [0.0], [4.0]])),
            "fixed_degrees": 21.0,
        }
        answer, low, _ = decision(contrasts([0.19], [0.01], **few))
        assert (answer, low > rules.SUCCESS_MARGIN) == (rules.DOES_NOT, True)
        answer, low, _ = decision(contrasts([0.19], [0.23], **few))
        assert (answer, low) == (rules.BETWEEN, 0.0)


class TestDecision:
    """Two contrasts, sure to a point of a hundred or so."""

    @pytest.mark.parametrize(
        ("gaps", "changed", "expected"),
        [
            ([0.01, -0.02], {}, rules.TRACKS),
            ([0.01, -0.20], {}, rules.DOES_NOT),
            ([0.01, 0.05], {}, rules.BETWEEN),
            ([0.01, -0.20], {"decides": [True, False]}, rules.BETWEEN),
            ([0.01, 0.20], {"side": [BOTH, ONLY_MORE]}, rules.DOES_NOT),
            ([0.01, -0.20], {"side": [BOTH, ONLY_MORE]}, rules.NOT_TESTABLE),
            ([0.01, 0.01], {"side": [BOTH, ONLY_FEWER]}, rules.NOT_TESTABLE),
            ([0.01, 0.20], {"side": [BOTH, NEITHER]}, rules.NOT_TESTABLE),
            ([0.01, 0.01], {"is_whole": False}, rules.NOT_TESTABLE),
            ([0.01, 0.01], {"fall": [0.15] * 4001}, rules.NOT_TESTABLE),
            ([0.01, 0.20], {"fall": [0.15] * 4001}, rules.DOES_NOT),
            ([0.01, 0.01], {"span": [0.05] * 4001}, rules.DOES_NOT),
            (
                [0.01, 0.01],
                {"span": [0.05] * 4001, "fall": [0.05] * 4001},
                rules.NOT_TESTABLE,
            ),
            ([0.01, 0.20], {"fixed_degrees": 18.0}, rules.NOT_TESTABLE),
            ([0.01, 0.20], {"fall_error": 0.0}, rules.NOT_TESTABLE),
        ],
    )
    def test_follows_from_the_ends(self, gaps, changed, expected):
        assert decision(contrasts(gaps, [0.005, 0.005], **changed))[0] == expected


class TestPower:
    def test_is_that_of_a_normal_contrast(self):
        s = 0.012
        item = contrasts([0.3], [s], n_drawn=20_000)
        table = power.answer_probabilities(
            item, spread.interval_widths(item, item.largest_deviation), ["offset"]
        )
        q = np.quantile(item.largest_deviation, 0.975)
        tracks = 2 * norm.cdf((0.05 - 1.96 * s) / s) - 1
        fails = norm.sf((0.05 + q * s - 0.10) / s)
        assert table[power.EQUAL][rules.TRACKS] == pytest.approx(tracks, abs=0.01)
        assert power.decision_power(table)[rules.DOES_NOT] == pytest.approx(
            fails, abs=0.01
        )
        assert all(
            sum(shares.values()) == pytest.approx(1) for shares in table.values()
        )

    def test_clusters_needed_show_a_true_equal_in_four_of_five(self):
        item = contrasts([0.0, 0.1], [0.03, 0.02], n_drawn=20_000)
        needed = power.clusters_needed(
            item, spread.interval_widths(item, item.largest_deviation), 100
        )
        factor = np.sqrt(100 / needed)
        there = contrasts([0.0, 0.1], [0.03 * factor, 0.02 * factor], n_drawn=20_000)
        table = power.answer_probabilities(
            there, spread.interval_widths(there, there.largest_deviation), ["a", "b"]
        )
        assert table[power.EQUAL][rules.TRACKS] == pytest.approx(0.8, abs=0.02)

    @pytest.mark.parametrize(
        "changed",
        [{"is_whole": False}, {"fall": [0.2] * 4001}, {"side": [BOTH, ONLY_MORE]}],
    )
    def test_no_number_helps_where_equality_cannot_be_tested(self, changed):
        item = contrasts([0.0, 0.0], [0.01, 0.01], **changed)
        assert (
            power.clusters_needed(
                item, spread.interval_widths(item, item.largest_deviation), 100
            )
            is None
        )


class TestPredictionError:
    KINDS = ("white",) * 5 + ("thin", "thin", "offset")
    AT = np.array([0.1, 0.3, 0.5, 0.7, 0.9, 0.2, 0.8, 0.4])

    def drawn(self, reached, noise):
        rng = np.random.default_rng(0)
        around = reached + noise * rng.normal(size=(400, self.AT.size))
        return np.vstack([reached, around])

    def test_is_the_distance_of_a_kind_from_the_others_curve(self):
        reached = self.AT + 0.1 * (
            self.AT == 0.4
        )  # offset is read at 0.4 between 0.3 and 0.5
        shows = np.tile(self.AT, (401, 1))
        errors = prediction_errors(shows, self.drawn(reached, 1e-6), self.KINDS)
        curve = [
            reached[self.AT == 0.8],
            reached[self.AT == 0.2],
            reached[self.AT == 0.4],
        ]
        assert min(curve) > 0
        # white from thin and offset: flat beyond 0.2 and 0.8, and 0.1 too high between
        others = np.interp([0.1, 0.3, 0.5, 0.7, 0.9], [0.2, 0.4, 0.8], [0.2, 0.5, 0.8])
        white = np.mean((reached[:5] - others) ** 2)
        thin = np.mean((np.array([0.2, 0.8]) - [0.2, 0.8]) ** 2)
        assert errors.own.roots[0] ** 2 == pytest.approx(
            (white + thin + 0.1**2) / 3, rel=1e-3
        )
        assert errors.null.roots[0] > errors.own.roots[0]

    def test_what_sampling_alone_gives_is_taken_off(self):
        shows = np.tile(self.AT, (401, 1))
        rng = np.random.default_rng(3)
        errors = []
        for _ in range(40):
            reached = self.AT + 0.05 * rng.normal(size=self.AT.size)
            errors.append(
                prediction_errors(shows, self.drawn(reached, 0.05), self.KINDS).own
            )
        flat = np.mean(
            [error.drawn[0] for error in errors]
        )  # beyond 0.2 and 0.8 the curve is flat
        assert flat == pytest.approx(2 / 5 * 0.1**2 / 3, abs=0.0012)
        assert all(error.ends[0] <= error.ends[1] for error in errors)

    def test_one_kind_foretells_nothing(self):
        shows = np.tile(self.AT, (401, 1))
        assert prediction_errors(shows, shows, ["white"] * 8) is None
