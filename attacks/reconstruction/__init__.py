"""Adversaries who estimate where people truly were, one file each."""
