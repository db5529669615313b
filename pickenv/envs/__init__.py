"""Gymnasium environments, which `import pickenv` registers."""

from pickenv.base.extras import offered as _offered

__getattr__, __dir__, __all__ = _offered("pickenv.envs", __file__)
