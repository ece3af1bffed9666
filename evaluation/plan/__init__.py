"""The plan of a run: presets, settings, axes; no module here computes anything.

A plan is made in four steps (`plan.make_plan`):

1. `settings.Settings` are checked. What the user names on an axis (`choices`) replaces
   the values of a preset (`presets`) or adds to them.
2. `axes.expand_axes` turns them into plug-ins: mechanisms, and consumers by subject
   (`scene_axes`, `linkage_axes` with `linkers`, `patrol_axes`, `track_axes`), for each
   of the run's `adversaries`.
3. `fitted_data.fit_to_data` leaves out parts for which the recording has too few people.
4. `units.plan_units` crosses mechanisms with consumers, and gives every cell its key,
   from settings and `source_digest` (`fingerprint`).

`origins` and `user_plugins` tell a user's plug-ins from the project's own. `workers`
chooses the number of processes, `environment` checks what a library would fail at.
`variants` are the runs of `evaluation.sensitivity`, `protocol` is that of the board.
`constants` are words and numbers that cells depend on.

The nouns of plan, pool and store:

Level
    A mechanism with its parameters, such as ``fid:1``. Everything is computed level by
    level.
Consumer
    A reader of releases: a robot's predictor, an adversary's attack or linker, or the
    plain descriptors (`consumer.Consumer`). Its kind says which of these it is.
Axes
    The mechanisms and consumers that a run combines (`axes.Axes`), by subject: scenes,
    linkage tasks, patrols, tracks.
World
    The walks, the error law and the horizon that a number belongs to; by default the
    run's own (`world.World`). A consumer belongs to a single world.
Address
    Where a number belongs: recording, world, mechanism, level, consumer, adversary and
    metric (`address.Address`).
Section
    The part of the pipeline that computes a consumer: sharing, reconstruction, patrol,
    returns, tracking, or a linkage task by its own name (`fingerprint`). It decides
    which source files the key of a cell covers.
Cell
    One consumer at one level, in one block of scenes or one task. It is the smallest
    part of a run that is finished, fails or is stored by itself.
Unit
    The cells of one level, section and world, in one block of scenes or one task
    (`units.Unit`). They share a key; each consumer adds a key of its own.
Work
    What a worker computes at a time: missing cells that share their scenes, people or
    patrols (`evaluation.compute.work`). It may have the cells of several units.
Piece
    A part of the missing cells of a block or a task, where these are cut into several
    works for an even load (`evaluation.pool.pieces`).
"""
