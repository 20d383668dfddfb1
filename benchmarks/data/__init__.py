"""Regenerates the shipped presets from named sources. Nothing in the packages imports this."""
