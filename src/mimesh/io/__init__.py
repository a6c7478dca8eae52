"""Read and write meshes and clips in any format: `load` and `save`.

Clips are read and written frame by frame, so that memory does not grow with their length.
"""

from .formats import clip_suffixes as clip_suffixes
from .formats import mesh_suffixes as mesh_suffixes
from .load import check_readable as check_readable
from .load import list_animations as list_animations
from .load import load_clip as load_clip
from .load import load_driving as load_driving
from .load import load_mesh as load_mesh
from .load import load_points as load_points
from .load import load_recorded_clip as load_recorded_clip
from .save import check_writable as check_writable
from .save import joints_file as joints_file
from .save import refuse_vrm as refuse_vrm
from .save import save_bvh as save_bvh
from .save import save_clip as save_clip
from .save import save_joint_motion as save_joint_motion
from .save import save_mesh as save_mesh
from .save import save_vrm as save_vrm
from .save import save_vrma as save_vrma
from .save import save_whole as save_whole
