"""Chunks of arms, computed by one process or many."""

from pickenv.extras import require as _require

_require("pyarrow", "joblib")
