"""Family and adding rule of a mechanism: asked, never read off its name."""

import numpy as np
import pandas as pd
import pytest

from evaluation import matrix
from evaluation.estimates.families import FID, Family, families_in
from evaluation.estimates.sweeps import Sweeps
from isac_track.errors import PluginError
from isac_track.plugins import parse


@pytest.mark.parametrize(
    ("spec", "family", "adding", "rest"),
    [
        ("raw", "raw", "", ""),
        ("clean", "clean", "", ""),
        ("fid:100", "fid", "linear", ""),
        ("fid:100,adding=independent,alpha=0.25", "fid", "independent", "alpha=0.25"),
        ("offset:0.3", "offset", "", ""),
        ("thin:4", "thin", "", ""),
        ("thin:4,d_sigma=0.75", "thin", "linear", "d_sigma=0.75"),
        ("helpers.mechanisms:Twice:0.2", "helpers.mechanisms:Twice", "", ""),
        ("helpers.mechanisms:Says:0.2", "helpers.mechanisms:Says", "independent", ""),
        ("helpers.mechanisms:Vague:0.2,adding=0.7", "helpers.mechanisms:Vague", "", ""),
    ],
)
def test_a_mechanism_says_of_which_family_it_is_and_how_it_adds(
    spec, family, adding, rest
):
    (plugin,) = parse("mechanisms", spec)
    assert (plugin.family, plugin.adding) == (family, adding)
    mechanism = Family(plugin.name, plugin.family, plugin.adding)
    assert mechanism.parameters == rest
    assert mechanism.rules == ((adding,) if adding else ("linear", "independent"))
    assert mechanism.is_added == (family not in ("raw", "clean"))


def test_one_that_cannot_say_is_refused_by_name():
    with pytest.raises(PluginError, match=r"helpers.mechanisms:Mute.*adding: KeyError"):
        parse("mechanisms", "helpers.mechanisms:Mute:0.2")


def test_the_paper_s_mechanism_is_the_one_with_nothing_else_changed():
    rows = [
        {"mechanism": name, "family": "fid", "adding": adding}
        for name, adding in (("fid:alpha=1.0", "linear"), ("fid", "linear"))
    ]
    sweeps = Sweeps({}, families_in(rows))
    assert sweeps.named(FID, adding="linear") == "fid"
    assert sweeps.named(FID, adding="independent") == ""
    assert families_in(pd.DataFrame(rows).replace("linear", np.nan)) == {
        row["mechanism"]: Family(row["mechanism"], "fid", "") for row in rows
    }


@pytest.mark.usefixtures("undrawn", "single_process")
def test_a_run_with_a_mechanism_of_ones_own_treats_it_like_fid(
    csv_recording, tmp_path, capsys
):
    out = tmp_path / "run"
    mechanisms = ("raw", "fixed:0.2..1/3", "helpers.mechanisms:Twice:0.1..0.5/3")
    code = matrix.main(
        [
            "--dataset",
            str(csv_recording),
            "--scenes",
            "40",
            "--out",
            str(out),
            "--predictor",
            "least_squares",
            "--attack",
            "kalman_rts",
            "--task",
            "none",
            *(word for spec in mechanisms for word in ("--mechanism", spec)),
        ]
    )
    assert code == 0
    messages = capsys.readouterr().err
    assert messages.count("has no `adding` attribute") == 1
    assert "helpers.mechanisms:Twice has no" in messages
    summary = pd.read_csv(out / "summary.csv", keep_default_na=False)
    assert list(summary.columns[-3:]) == ["family", "adding", "policy"]
    names = (
        summary[["mechanism", "family", "adding"]].drop_duplicates().to_numpy().tolist()
    )
    twice = "helpers.mechanisms:Twice"
    assert names == [
        ["raw", "raw", ""],
        ["fixed", "fixed", "linear"],
        [twice, twice, ""],
    ]
    matched = pd.read_csv(out / "matched.csv")
    assert set(matched["family"]) == {"helpers.mechanisms:Twice"}
    assert set(matched["adding"]) == {
        "linear"
    }  # of the other rule there is no fixed noise
    # It is fixed noise by another name, on the same draws.
    assert np.allclose(matched["difference"], 0.0, atol=1e-9)


@pytest.mark.parametrize(
    ("spec", "claims"),
    [
        *(
            (name, False)
            for name in ("raw", "clean", "correlated:0.75", "offset:0.3", "thin:4")
        ),
        *(
            (name, True)
            for name in ("fixed:1", "fid:1", "ou:0.4", "ou_fid:1", "laplace:1")
        ),
        ("forecast:0.1", True),
        ("thin:4,d_sigma=0.75", False),
        ("helpers.mechanisms:Twice:0.2", True),  # without a word it claims to
        ("helpers.mechanisms:Control:0.2", False),
    ],
)
def test_a_mechanism_says_whether_it_claims_to_protect(spec, claims):
    (plugin,) = parse("mechanisms", spec)
    assert plugin.protects is claims
    entry = {"mechanism": plugin.name, "family": plugin.family, "adding": plugin.adding}
    for rows in (
        [entry | {"protects": claims}],
        pd.DataFrame([entry | {"protects": claims}]),
    ):
        assert families_in(rows)[plugin.name].protects is claims
    assert families_in([entry])[plugin.name].protects


def test_a_claim_that_is_neither_yes_nor_no_is_refused_by_name():
    with pytest.raises(
        PluginError, match=r"helpers.mechanisms:Perhaps.*protects must be True or"
    ):
        parse("mechanisms", "helpers.mechanisms:Perhaps:0.2")
