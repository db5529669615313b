"""Geometry, forward and inverse kinematics, Jacobians and pose errors."""
