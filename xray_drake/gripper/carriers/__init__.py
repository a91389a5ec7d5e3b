"""What moves the gripper about: a wrist or an arm."""
