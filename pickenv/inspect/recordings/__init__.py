"""Recordings for the Rerun viewer."""

from pickenv.extras import require as _require

_require("rerun")
