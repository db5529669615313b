"""Tables on the screen show every character that they are given."""

import pytest

from pickenv.commands.showing import print_table


def test_units_in_brackets_stand_in_heads_cells_title_and_caption(capsys: pytest.CaptureFixture[str]) -> None:
    print_table("errors [mm]", ("arm", "mean [mm]"), [("a[0]", "[bold]1.5")], words=("arm",), caption="p95 [deg]")
    said = capsys.readouterr().out
    for words in ("errors [mm]", "mean [mm]", "a[0]", "[bold]1.5", "p95 [deg]"):
        assert words in said
