"""Errors judged in blocks: the interval between blocks holds the mean over all blocks there could be."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from pickenv.calibration import contiguous_folds, error_statistics

NORM = np.sqrt(8.0 / np.pi)
"""Mean norm of three standard normal coordinates."""


SAFE = 0.999
"""Neighbours that are not alike are held too often: that is the price of holding those that are."""


@pytest.mark.parametrize("blocks", [10, 40])
@pytest.mark.parametrize("alike", [0.0, 0.3, 0.6])
@pytest.mark.parametrize("apart", [0.0, 0.25, 0.4])
def test_blocks_of_known_spread(repeats: Any, blocks: int, apart: float, alike: float) -> None:
    """Sizes of errors that differ by a log-normal factor from block to block; measured robots' by 0.15 to 0.25.

    Factors of neighbours are correlated, as far as there are any.
    """
    mixed = np.linalg.cholesky(alike ** np.abs(np.subtract.outer(np.arange(blocks), np.arange(blocks))))

    def errors(rng: np.random.Generator) -> Any:
        size = np.exp(apart * (mixed @ rng.normal(size=blocks)))[:, None, None]
        return (size * rng.normal(size=(blocks, 25, 3))).reshape(-1, 3)

    number = np.repeat(np.arange(blocks), 25)
    truth = NORM * np.exp(apart**2 / 2.0)
    repeats.check(lambda rng: error_statistics(errors(rng), number).mean_ci95, truth, SAFE, share=0.2, least=0.92)
    if apart < 0.4:  # of ten blocks that differ more, the interval of the root mean square holds in 92 %
        truth = np.sqrt(3.0) * np.exp(apart**2)

        def of_rms(rng: np.random.Generator) -> Any:
            """Of data that have one: now and then a sample looks further apart than it is."""
            return next(ends for _ in range(100) if (ends := error_statistics(errors(rng), number).rms_ci95))

        repeats.check(of_rms, truth, SAFE, share=0.2, least=0.92)


def test_rows_of_alike_errors_judged_without_their_block(repeats: Any) -> None:
    """The whole procedure on a line with a smooth remainder: fitted without each block, judged there."""
    rows = 200
    folds = contiguous_folds(np.zeros(rows, dtype=np.int64), np.arange(rows), 10)
    number = np.concatenate([np.full(len(held), i) for i, (_, held) in enumerate(folds)])

    def left(rng: np.random.Generator) -> Any:
        inputs = np.stack([np.ones(rows), rng.uniform(-1.0, 1.0, rows)], axis=1)
        remainder = np.convolve(rng.normal(size=rows + 7), np.ones(8) / np.sqrt(8.0), "valid")
        found = np.zeros(rows)
        for train, held in folds:
            line = np.linalg.lstsq(inputs[train], remainder[train], rcond=None)[0]
            found[held] = remainder[held] - inputs[held] @ line
        return found

    rng = np.random.default_rng(1)
    truth = float(np.mean([np.abs(left(rng)).mean() for _ in range(2000)]))
    repeats.check(lambda rng: error_statistics(left(rng), number).mean_ci95, truth, SAFE, share=0.2)
