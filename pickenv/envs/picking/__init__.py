"""Pick: reaching among fruit, with a gripper."""
