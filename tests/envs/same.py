"""What tests of vectors compare with."""

import numpy as np


def assert_same(one, other, where="", apart=0.0):
    """Equal to the bit, in the same type, entry by entry of dicts and object arrays; or so far ``apart``."""
    if isinstance(one, dict):
        assert one.keys() == other.keys(), where
        for key in one:
            assert_same(one[key], other[key], f"{where}/{key}", apart)
    elif isinstance(one, np.ndarray) and one.dtype == object:
        for i, (a, b) in enumerate(zip(one, other, strict=True)):
            assert (a is None) == (b is None), where
            if a is not None:
                assert_same(a, b, f"{where}[{i}]", apart)
    else:
        assert one.dtype == other.dtype, where
        if not apart or one.dtype.kind != "f":
            np.testing.assert_array_equal(one, other, err_msg=where)
        else:
            most = max(apart, float(np.finfo(one.dtype).eps))
            np.testing.assert_allclose(one, other, rtol=most, atol=most, err_msg=where)
