"""Two policies → `pickenv compare` → `pickenv film`, as docs/films.md prints it: both count the same."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from pickenv.inspect import RecordedEpisodes, load_part, read_run
from tests.journeys.pages import walked

ROOT = Path(__file__).parents[2]


def test_the_film_of_the_page_is_small_and_lasts_twelve_seconds() -> None:
    from PIL import Image

    path = ROOT / "docs/images/film.gif"
    assert path.stat().st_size < 3e6
    with Image.open(path) as film:
        durations = []
        for frame in range(film.n_frames):
            film.seek(frame)
            durations.append(film.info["duration"])
    assert len(durations) == 120 and sum(durations) == pytest.approx(12_000, rel=0.05)


@pytest.mark.slow
def test_the_page_told_from_an_empty_folder_ends_with_a_film_that_counts_what_the_run_counts(tmp_path: Path) -> None:
    said = walked("films.md", tmp_path)
    assert (tmp_path / "picture.png").is_file()
    assert (tmp_path / "film.gif").stat().st_size < 3e6
    episodes = load_part(read_run(tmp_path / "runs/orchard"), RecordedEpisodes)
    raw, calibrated = episodes.policies
    counted = re.search(r"120 frames.*raw picks (\d+) of (\d+), LS picks (\d+) of (\d+);", said[3])
    assert counted is not None, said[3]
    picked = [int(number) for number in counted.groups()]
    first = [int(policy.ends.picked[0]) for policy in (raw, calibrated)]
    assert [picked[0], picked[2]] == first
    assert picked[2] > picked[0]  # on this machine and cup calibration changes picks
    rows = json.loads((tmp_path / "runs/orchard/comparison.json").read_text(encoding="utf-8"))["rows"]
    assert [row["policy"] for row in rows] == ["raw", "LS"]
    assert re.fullmatch(r"raw: picked \d+ of \d+, last miss [\d.]+ mm\nLS: picked .* mm\n", said[4])
