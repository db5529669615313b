"""Films of comparisons: `pickenv film`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from pickenv.commands.showing import progress_bars


def film(
    run: Annotated[Path, typer.Argument(help="Run folder of `pickenv compare`.", show_default=False)],
    out: Annotated[Path, typer.Option(help="File to write, .gif or .mp4.")] = Path("film.gif"),
    policy: Annotated[
        list[str] | None,
        typer.Option(help="Policy to show, as the run names it, left first; its first and last if left out."),
    ] = None,
    seconds: Annotated[float, typer.Option(help="Length of the film, s.")] = 12.0,
    fps: Annotated[int, typer.Option(help="Frames per second.")] = 10,
    dark: Annotated[bool, typer.Option("--dark", help="Draw on a dark background.")] = False,
) -> None:
    """Make a film of a comparison: two policies side by side at the same fruit, with misses in mm and fruit picked."""
    from pickenv.inspect.films.make_film import film as make_film
    from pickenv.pictures.drawers import why_plain

    with progress_bars("frames") as report:
        made = make_film(
            run, out, policies=policy or (), seconds=seconds, frames_per_second=fps, dark=dark, progress=report
        )
    plain = why_plain()
    if plain is not None:
        print(plain)
    last = made.plan.frames[-1]
    counted = ", ".join(f"{stated.label} picks {stated.picked} of {stated.tried}" for stated in last.stated)
    size = f"{made.path.stat().st_size / 1e6:.1f} MB"
    print(f"{made.path}: {len(made.plan.frames)} frames, {size}; {counted}; {made.plan.speed:.1f} x as fast as the arm")
