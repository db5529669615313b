from .harvest_run import (
    Harvest as Harvest,
    Measure as Measure,
    Round as Round,
    Strategy as Strategy,
    funnel as funnel,
    harvest as harvest,
    work_trees as work_trees,
)
from .interference import arm_distances as arm_distances, pairs_of as pairs_of
from .machine import (
    Machine as Machine,
    dense_workspace as dense_workspace,
    load_machine as load_machine,
    master_time as master_time,
    profile as profile,
    travel_time as travel_time,
)
from .optimiser import assign as assign, lower_bound as lower_bound
from .pick_points import Grid as Grid, Zone as Zone, cut as cut, load_grid as load_grid, pick_point as pick_point
from .picking import (
    Luck as Luck,
    Picking as Picking,
    attempt as attempt,
    draw_luck as draw_luck,
    load_picking as load_picking,
    pushes as pushes,
)
from .trees import (
    Orchard as Orchard,
    Tree as Tree,
    lab_zone as lab_zone,
    load_lab as load_lab,
    load_orchard as load_orchard,
    sample_tree as sample_tree,
    tree_leaves as tree_leaves,
)
from .true_machine import (
    Controller as Controller,
    TrueMachine as TrueMachine,
    load_true_machine as load_true_machine,
)
from .work import (
    Work as Work,
    slave_joints_at as slave_joints_at,
    timetable as timetable,
    ultrasonic_hold as ultrasonic_hold,
    zone_work as zone_work,
)
