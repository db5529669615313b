from .branch import (
    Branch as Branch,
    coupling as coupling,
    load_branch as load_branch,
    natural_frequencies as natural_frequencies,
    pushed as pushed,
    settling_time as settling_time,
    swing as swing,
)
from .camera import (
    DRAWS as DRAWS,
    Camera as Camera,
    camera_frame as camera_frame,
    depth_bias as depth_bias,
    depth_noise as depth_noise,
    detect as detect,
    detection_probability as detection_probability,
    in_image as in_image,
    load_camera as load_camera,
    measured_positions as measured_positions,
    orchard_frame as orchard_frame,
    stereo_depth_noise as stereo_depth_noise,
)
from .canopy import (
    Canopy as Canopy,
    Fruit as Fruit,
    approach_direction as approach_direction,
    depth_behind_face as depth_behind_face,
    face as face,
    foliage_path as foliage_path,
    foliage_transmission as foliage_transmission,
    in_canopy as in_canopy,
    load_canopy as load_canopy,
    sample_fruit as sample_fruit,
)
from .circles import (
    Circles as Circles,
    CircleSearch as CircleSearch,
    fruit_circles as fruit_circles,
    load_circle_search as load_circle_search,
    locate_circles as locate_circles,
)
from .fruit import (
    Clumping as Clumping,
    Detachment as Detachment,
    FruitMap as FruitMap,
    FruitSize as FruitSize,
    Strength as Strength,
    clumping as clumping,
    detached as detached,
    detachment_probability as detachment_probability,
    fit_fruit_map as fit_fruit_map,
    fruit_masses as fruit_masses,
    load_detachment as load_detachment,
    load_fruit_map as load_fruit_map,
    load_fruit_size as load_fruit_size,
    sample_counts as sample_counts,
    sample_diameters as sample_diameters,
    sample_strength as sample_strength,
    stem_ends as stem_ends,
)
from .gripper import (
    CompliantHand as CompliantHand,
    Cup as Cup,
    Gripper as Gripper,
    Misalignment as Misalignment,
    capture_probability as capture_probability,
    load_gripper as load_gripper,
    misalignment as misalignment,
)
from .occlusions import (
    Occlusion as Occlusion,
    Station as Station,
    approach_clear as approach_clear,
    load_station as load_station,
    occlusion as occlusion,
)
from .preset_files import shipped as shipped
from .render import (
    Leaves as Leaves,
    Look as Look,
    StereoPair as StereoPair,
    load_look as load_look,
    render_stereo as render_stereo,
    sample_leaves as sample_leaves,
    turned_leaves as turned_leaves,
)
from .sight import (
    DETECTORS as DETECTORS,
    VISIONS as VISIONS,
    Eyes as Eyes,
    Sight as Sight,
    Viewpoint as Viewpoint,
    foliage as foliage,
    load_eyes as load_eyes,
    see as see,
)
from .sight_errors import (
    Chances as Chances,
    SightErrors as SightErrors,
    draw_chances as draw_chances,
    load_sight_errors as load_sight_errors,
    next_picture as next_picture,
    sighted as sighted,
)
from .vision import (
    Detections as Detections,
    Regions as Regions,
    StereoCamera as StereoCamera,
    fruit_mask as fruit_mask,
    fruit_regions as fruit_regions,
    load_stereo_camera as load_stereo_camera,
    locate as locate,
    match_detections as match_detections,
    project as project,
    red_minus_green as red_minus_green,
    triangulate as triangulate,
)
