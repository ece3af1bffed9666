"""Adversaries: reconstruction and linkage."""
