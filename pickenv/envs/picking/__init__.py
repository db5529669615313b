"""The Pick environment: reaching among fruit, with a gripper."""
