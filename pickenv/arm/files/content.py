"""What a thing made of numbers holds, as a hash: equal content, equal hash, wherever it came from."""

from __future__ import annotations

import hashlib
import json
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np


def content_sha256(*parts: Any) -> str:
    """SHA-256 of dataclasses, arrays, numbers and text, by their values."""
    return hashlib.sha256(json.dumps([plain(part) for part in parts], sort_keys=True).encode()).hexdigest()


def plain(value: Any) -> Any:
    """A value as JSON has it: dataclasses by their fields' names, arrays as lists."""
    if is_dataclass(value) and not isinstance(value, type):
        return {field.name: plain(getattr(value, field.name)) for field in fields(value)}
    if isinstance(value, tuple | list):
        return [plain(entry) for entry in value]
    return value.tolist() if isinstance(value, np.ndarray) else value
