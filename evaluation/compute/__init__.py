"""The numbers of a unit of work: scenes, links, patrols, tracks, returns; no disk."""
