"""Measurements, one script per question; nothing in the packages imports this."""
