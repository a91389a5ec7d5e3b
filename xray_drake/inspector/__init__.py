"""Inspecting searches in Meshcat."""
