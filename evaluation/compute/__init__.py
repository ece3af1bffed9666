"""The numbers of a unit of work: scenes, links, patrols, tracks, returns; no disk.

A worker gets a piece of work (`work`) and returns tables of rows (`tables`), one for
each consumer at each level. The files by section, in the order in which data flow:

Scenes
    `model_walks` senses them, `sharing` lets a mechanism share them. `forecasts` has
    the descriptors and the robots' predictions. `reconstruction` attacks; `frames`
    hides place and clock from an adversary, `companions` grants shared walks,
    `walk_bounds` says how well any attack can do.
Linkage tasks
    `link_setup` senses both sides and splits the people. `link_views` holds what
    linkers see at a level, `linkage` lets them score it, `candidates` scores only a
    part of a large gallery. `link_scores` makes the scorecard, `link_tables` its rows,
    `window_tables` those of the windows themselves.
People who come back
    `returns`, with the columns of `return_columns`.
Patrols
    `patrols` walks robots through a recording, `log_attacks` attacks their log,
    `patrol_rows` has the rows.
Tracks
    `tracking_setup` detects and tracks, `tracking` scores, `track_policies` answers
    robots from tracks, `track_links` links tracks, `recipients` track on their own,
    `track_rows` has the rows.
Beside the cells
    `board` has the scores of a card, `sample_tracks` the tracks that are drawn.

Calls of a user's plug-in go through `guards`; `plugin_call` tries one before a run.
`loops` compiles beforehand, `current_cell` names the cell that fails.
"""
