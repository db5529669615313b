"""The environments Reach, ReachGoal and ReachIdeal, single and as native vectors."""
