from . import (
    agents as agents,
    arm as arm,
    base as base,
    calibration as calibration,
    envs as envs,
    experiments as experiments,
    harvester as harvester,
    inspect as inspect,
    orchard as orchard,
    wrappers as wrappers,
)
from .agents import compare as compare, load_policy as load_policy, run_reaches as run_reaches
from .arm import Arm as Arm, Plant as Plant, load_arm as load_arm, load_plant as load_plant
from .base.errors import InputError as InputError
from .base.registry import register as register
from .calibration import Calibration as Calibration, Choices as Choices, Result as Result, calibrate as calibrate
from .inspect import film as film

__version__: str
