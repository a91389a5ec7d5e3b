"""Search policies: which object to grasp next."""
