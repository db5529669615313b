"""Wrappers of the environments."""

from pickenv.wrappers.compensation import CompensationWrapper, Compensator

__all__ = ["CompensationWrapper", "Compensator"]
