"""Helpers that all packages of pickenv use: errors, files, containers, TOML tables, intervals, seeds, extensions."""

from pickenv.base.extras import offered as _offered

__getattr__, __dir__, __all__ = _offered("pickenv.base", __file__)
