"""Recordings for the Rerun viewer."""

from pickenv.base import require as _require

_require("rerun")
