"""Grasps: sampling, wrench-space analysis, collision checks."""
