"""Mechanisms: how a network shares its sensed positions. A file for each kind."""
