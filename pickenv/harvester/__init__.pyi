from .harvest_run import (
    Harvest as Harvest,
    Luck as Luck,
    Measure as Measure,
    Picking as Picking,
    Round as Round,
    Strategy as Strategy,
    attempt as attempt,
    draw_luck as draw_luck,
    funnel as funnel,
    harvest as harvest,
    load_picking as load_picking,
    pushes as pushes,
    work_trees as work_trees,
)
from .machine import (
    Machine as Machine,
    dense_workspace as dense_workspace,
    load_machine as load_machine,
    master_time as master_time,
    profile as profile,
    travel_time as travel_time,
)
from .optimiser import assign as assign, lower_bound as lower_bound
from .pick_points import (
    Grid as Grid,
    Orchard as Orchard,
    Tree as Tree,
    Zone as Zone,
    cut as cut,
    lab_zone as lab_zone,
    load_grid as load_grid,
    load_lab as load_lab,
    load_orchard as load_orchard,
    pick_point as pick_point,
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
    arm_distances as arm_distances,
    pairs_of as pairs_of,
    slave_joints_at as slave_joints_at,
    timetable as timetable,
    ultrasonic_hold as ultrasonic_hold,
    zone_work as zone_work,
)
