"""From a recording and your own attack to a report; see docs/tutorial/first-study.md.

Run it as it is (`python tutorial.py`, 15 s), or cell by cell in an editor that knows
`# %%`. It writes `walks.csv` and the folder `tutorial-run` where it is started.
"""

# ruff: noqa: T201 - a tutorial shows what it does

import numpy as np
import pandas as pd
from geometric_median import GeometricMedian  # the file beside this one

import evaluation
from attacks.testing import run_checks
from evaluation import design
from isac_track import datasets

# %% 1. A recording: t in s, id, x and y in m, and who walks together if that is known
# Simulated and bundled; put your own file in its place.
crowd = datasets.load("plaza").tracks
n_samples = np.diff(crowd.offsets)
walks = pd.DataFrame({"t": crowd.t, "x": crowd.xy[:, 0], "y": crowd.xy[:, 1]})
walks["id"] = np.repeat(crowd.source, n_samples)
walks["group"] = np.repeat(crowd.group, n_samples)
walks = walks[walks["t"] < 240.0]  # four of ten minutes
walks.to_csv("walks.csv", index=False)
recording = datasets.load("walks.csv")
print(
    f"{len(recording.tracks)} tracks; mended on reading:"
    f" {recording.repairs or 'nothing'}"
)

# %% 2. An attack: does it keep the contract?
failed = [
    outcome for outcome in run_checks(GeometricMedian()) if outcome.status == "failed"
]
print("attack kit:", failed or "all checks pass")

# %% 3. Run it on six releases beside a textbook smoother: alone and before a linker
ATTACK = "geometric_median:GeometricMedian"
results = evaluation.run(
    evaluation.Settings(
        dataset="walks.csv",
        preset="paper",
        scenes=60,  # for a look; the preset has 500
        mechanisms=("raw", "fid:1000", "fid:1e5", "fixed:0.3", "fixed:1", "offset:0.3"),
        predictors=("least_squares",),
        attacks=(ATTACK, "kalman_rts", f"shape@{ATTACK}", "shape@kalman_rts"),
        tasks=("rerelease",),
        policies=(),  # no robots on patrol
        out="tutorial-run",
    )
)

# %% 4. Privacy: PLR as shared and after either attack
summary = results.summary.astype({"level": object}).fillna({"level": ""})
shown = summary[summary["knowledge"].isin(["", "blind"])]
plr = shown[shown["metric"] == "plr"]
print(
    plr.pivot_table(
        index=["mechanism", "level"], columns="consumer", values="value"
    ).round(3)
)

# %% 5. Re-identification: rank 1 with its interval
rank1 = shown[(shown["metric"] == "rank1") & (shown["knowledge"] == "blind")]
columns = ["mechanism", "level", "consumer", "value", "ci_low", "ci_high"]
print(rank1[columns].round(3).to_string(index=False))

# %% 6. The verdict: five sentences, then item by item
for sentence in results.verdict["answer"]:
    print("-", sentence)
for item in results.verdict["items"]:
    if item["section"] == "validity":
        print(f"{item['id']}: {item['decision']}. {item['sentence']}")

# %% 7. A site: miss at most 45 % of future conflicts, link at most 20 % of the people
question = "--max-missed 0.45 --max-rank1 0.2 --adding linear tutorial-run"
exit_code = design.main(question.split())
print("exit code:", exit_code)
