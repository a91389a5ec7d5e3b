"""The cell: bin, tote, cameras and gripper; each fact stands here once."""
