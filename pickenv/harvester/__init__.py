"""The multi-arm harvester of Li 2016: machine, pick points, zones, assignment, interference, and picking with it."""

from types import ModuleType as _ModuleType

from pickenv.harvester.harvest import Harvest as Harvest
from pickenv.harvester.harvest import Strategy as Strategy
from pickenv.harvester.harvest import harvest as harvest
from pickenv.harvester.harvest_summary import Measure as Measure
from pickenv.harvester.harvest_summary import funnel as funnel
from pickenv.harvester.harvest_summary import summary as summary
from pickenv.harvester.machine import Machine as Machine
from pickenv.harvester.machine import load_machine as load_machine
from pickenv.harvester.optimiser import assign as assign
from pickenv.harvester.pick_point import pick_point as pick_point
from pickenv.harvester.picking import Picking as Picking
from pickenv.harvester.picking import load_picking as load_picking
from pickenv.harvester.strategies import work_images as work_images
from pickenv.harvester.strategies import work_trees as work_trees
from pickenv.harvester.trees import Orchard as Orchard
from pickenv.harvester.trees import Tree as Tree
from pickenv.harvester.trees import load_orchard as load_orchard
from pickenv.harvester.true_machine import Controller as Controller
from pickenv.harvester.true_machine import TrueMachine as TrueMachine
from pickenv.harvester.true_machine import load_true_machine as load_true_machine
from pickenv.harvester.work import timetable as timetable
from pickenv.harvester.work import zone_work as zone_work
from pickenv.harvester.zones import Grid as Grid
from pickenv.harvester.zones import load_grid as load_grid

__all__ = sorted(name for name, value in globals().items() if name[0] != "_" and not isinstance(value, _ModuleType))
