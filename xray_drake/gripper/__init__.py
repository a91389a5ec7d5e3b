"""Gripper controllers that execute grasps."""
