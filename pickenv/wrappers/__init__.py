"""Wrappers of the environments."""

from pickenv.wrappers.compensation import CompensationVectorWrapper, CompensationWrapper, Compensator

__all__ = ["CompensationVectorWrapper", "CompensationWrapper", "Compensator"]
