"""Estimates from finished cells: no prose, no ink.

Begin with `metrics`, the table of all metrics, and `summary`, which turns cells into
numbers with intervals by address. `families` is the table of mechanisms, `recordings`
says which recording a number is of. The other files answer a question each:

Robots
    `decisions` (misses over false alarms), `conflict_times`, `best_robot`,
    `standing_still`, `patrols`.
Attacks
    `strongest` and `strongest_table`, `cross_fit` (no gain from the choice of the
    best), `weak_attacks`, `bounds`, `linkability`, `linked_people`, `galleries`, `returns`,
    `worst_off`, `by_speed`, `own_plugins`, `tracking`.
Mechanisms
    `sweeps` and `interpolation` read curves over levels. `matching` compares two
    mechanisms at equal cost, `frontier` and `pareto` all of them; `levels` has each
    level that a site could choose. `paper` holds the published numbers and claims
    against these.
Several runs
    `differences` and `run_settings` compare two, `seeds` averages runs, `pooled`
    several recordings.
Cards
    `cards`, `card_agreement`, `board_places`.

`keys` finds rows of a table by address, `json_numbers` writes numbers into JSON.
"""
