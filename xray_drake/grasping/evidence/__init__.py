"""What is known of the objects that are to be grasped."""
