"""What a calibration may be asked for, and what does not go with what was measured."""

from __future__ import annotations

from dataclasses import dataclass

from pickenv.calibration.model.measurements import Frames, Measurements
from pickenv.calibration.model.observations import Observations
from pickenv.calibration.model.pixels import PixelObservations
from pickenv.calibration.model.stacked import Stacked
from pickenv.calibration.pipeline.restation import REFIT_ROWS
from pickenv.calibration.residuals.bpnn import BpnnSettings
from pickenv.errors import InputError


@dataclass(frozen=True)
class Choices:
    """What to do beyond geometry.

    Attributes:
        terms: "auto", or names of terms joined by "+", or "none".
        residual: "auto", a residual model's name, or "none".
        force: Whether a named residual model is used even if it does not win.
        robust: Whether rows far off are left out; they are listed all the same.
        seed: Seeds everything random.
        frames: Whether base and tool are "known" or "fitted"; as the data say when None.
        learn_from: Poses for the named residual model, which is then used as it is, as the paper does; when None it
            learns from the training rows, if it wins there.
        settings: Settings of the network that learns from them; the paper's when None.
        lens: "fixed" or "free", for pictures; as their description says when None.
        refit: Which of "base" and "tool" the rows to judge by have of their own, as rows of another station do.
        refit_rows: So many of them are used to find those.
        fit: One of `pickenv.calibration.model.prior.FIT_WORDS`: "auto", all parameters by their priors; "offsets", the
            joints' zeros alone; "full", all of them without priors, as the papers do.
        tolerances: The tolerance class that parts are expected to be made to, by name or path; the arm's own, or that
            of a cobot, when None.
        prior_scale: Factor on its widths; found from the rows when None.
        workspace: Where the verdict speaks (`pickenv.calibration.pipeline.given.workspace_joints`); the joint limits
            when None.
    """

    terms: str = "auto"
    residual: str = "auto"
    force: bool = False
    robust: bool = True
    seed: int = 0
    frames: Frames | None = None
    learn_from: Measurements | None = None
    settings: BpnnSettings | None = None
    lens: str | None = None
    refit: tuple[str, ...] = ()
    refit_rows: int = REFIT_ROWS
    fit: str = "auto"
    tolerances: str | None = None
    prior_scale: float | None = None
    workspace: str | None = None


def refuse_options(train: Observations, choices: Choices) -> None:
    """Refuse what is there for poses and positions only."""
    given = {"--frames known": choices.frames == "known"}
    parts = train.parts if isinstance(train, Stacked) else (train,)
    tracked = all(isinstance(part, Measurements) for part in parts)
    given[f"--residual {choices.residual}"] = not tracked and choices.residual not in ("auto", "none")
    if choices.lens is not None and not isinstance(train, PixelObservations):
        raise InputError(f"--lens is for pictures, but {train.source} holds {train.kind}; leave it out")
    one, several = (" of one station", " of several") if tracked else ("", "")
    for option, wanted in given.items():
        if wanted:
            raise InputError(
                f"{option} is for poses and positions{one}, but {train.source} holds {train.kind}{several}; "
                "leave it out"
            )
