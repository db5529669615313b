"""Arms: geometry, kinematics, Jacobians, rank-aware inverse kinematics, and the plant (the simulated true arm)."""

from pickenv.base.extras import offered as _offered

__getattr__, __dir__, __all__ = _offered("pickenv.arm", __file__)
