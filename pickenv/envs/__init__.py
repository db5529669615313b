"""Gymnasium environments; `import pickenv` registers them."""

from pickenv.envs.reach import ReachEnv

__all__ = ["ReachEnv"]
