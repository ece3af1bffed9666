"""Reconstruction attacks: estimate true positions from a release. One file each."""
