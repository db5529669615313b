"""Arms: geometry, kinematics, Jacobians, rank-aware inverse, and the plant (what the true arm does with a command)."""

from pickenv.base.faces import offered as _offered

__getattr__, __dir__, __all__ = _offered("pickenv.arm", __file__)
