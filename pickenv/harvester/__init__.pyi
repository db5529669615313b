from .harvest_run import (
    Harvest as Harvest,
    Strategy as Strategy,
    harvest as harvest,
    work_images as work_images,
    work_trees as work_trees,
)
from .harvest_summary import Measure as Measure, funnel as funnel, summary as summary
from .machine import Machine as Machine, load_machine as load_machine
from .optimiser import assign as assign
from .pick_points import pick_point as pick_point
from .picking import Picking as Picking, load_picking as load_picking
from .trees import Orchard as Orchard, Tree as Tree, load_orchard as load_orchard
from .true_machine import Controller as Controller, TrueMachine as TrueMachine, load_true_machine as load_true_machine
from .work import timetable as timetable, zone_work as zone_work
from .zones import Grid as Grid, load_grid as load_grid
