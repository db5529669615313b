"""The environment Pick: picking fruit one after the other, with a gripper."""
