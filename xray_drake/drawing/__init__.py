"""Meshcat layers and colour maps."""
