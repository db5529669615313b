"""The environments Reach, ReachGoal, ReachIdeal, ReachScaled and ReachTool, single and as native vectors."""
