"""Linkage tasks: which walks an adversary links, and controls that must not link them.

The adversary has two releases of walks under different pseudonyms. For each walk of the
first it ranks the walks of the second: which is of the same person? Nothing here senses
or shares: `evaluation.compute` does so with the windows made here.

Session
    One recording of a place on one day, often a file. A *run* is always one of the
    program, except in texts of results: "another run" there means another session.
Track
    The recorded samples of one person in one session (`isac_track.types.Tracks`).
Passage
    A track as `returns` links it: whole, from entry to exit, or its first minute.
Window
    A part of a track that is cut out and resampled for a task.
Side
    Either release: *probe*, the windows to link, or *gallery*, the candidates.
Mate
    The gallery window of the probe's person. In an *open* task a probe may have none.
Group
    People who walk together: their walks resemble each other. In code `group` has the
    name and `cluster` the number; of two sessions, groups are joined.
Search
    Probes and the gallery in which they are looked for. Each probe is ranked against
    all candidates of its search, and against no others.
Fold
    The searches of one adversary: half of the people, or half of the rotations. It is
    trained and calibrated on people of the other fold. Of few returning people, each
    person is a fold. No group is divided (`folds`).
Rotation, silence
    A rotation is the instant at which all pseudonyms change. The silence is the time
    without samples between the old pseudonyms and the new (`rotations`).
Returning people
    People with passages in two sessions or more. Few recordings have them.
Circumstances
    Properties of a session in which somebody walks, such as the place in the queue.
    They are hardly of the person, and a control uses them alone.

Read `task_list` first: the tasks by name. Then follow the windows:

- `task_input` (tracks, settings, seed) goes into `build`, which picks the maker:
  `paired_windows`, `cross_session` or `handover`. These use `cutting` and `assembly`
  and return `windows.TaskWindows`.
- `track_handover` makes the same from the tracks of a tracker, with its errors.
- `controls` are linkers that see one property only; `window_circumstances` measures
  some of these. `queues` has the order of people and whether it closes to a ring.

The task `returns` links whole passages instead of windows:

- `passages` finds them, with their `passage_circumstances`; `passage_releases` is what
  the adversary gets; `passage_scores` runs a linker; `return_study` has all results.
"""
