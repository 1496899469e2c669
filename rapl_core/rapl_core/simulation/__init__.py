"""Stepping, control, rendering."""
