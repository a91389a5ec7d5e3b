"""Poses that explain an image of the target, and ways to sum them up."""
