"""Reach, ReachGoal, ReachIdeal, one at a time and in native vectors."""
