"""Inspecting heaps, searches and datasets in Meshcat."""
