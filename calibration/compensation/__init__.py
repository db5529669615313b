"""Compensation: compute the joint command that brings the calibrated arm to a wanted pose."""
