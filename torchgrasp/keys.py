"""The data dictionary: every tensordict key that torchgrasp reads or writes.

Leading `*` stands for the batch. Metres, radians, seconds; float32 unless said otherwise.

| key | shape | meaning |
|---|---|---|
| DEPTH | *, H, W | metres along z of the wrist camera, 0 = no return |
| MASK | *, H, W bool | pixels of the target object |
| RGB | *, H, W, 3 uint8 | colours, from cameras that render |
| OVERHEAD_DEPTH, OVERHEAD_MASK, OVERHEAD_RGB | as above | the same of the static camera |
| T_BASE_EE, T_BASE_CAMERA, T_BASE_OVERHEAD | *, 4, 4 | poses in the robot base |
| T_BASE_OBJECT | *, 4, 4 | pose of the target; privileged: no policy reads it |
| OBJECT_ID | *, 1 int64 | index of the target in the ObjectSet; privileged |
| WORLD | *, 1 int64 | number of the world; with EPISODE it names an episode |
| EPISODE | *, 1 int64 | the episode's number in its world, from 0 |
| JOINTS, JOINT_VELOCITIES | *, 9 | 7 arm angles, 2 finger positions (m), and their rates |
| TIME_LEFT | *, 1 | (T - t) / T |
| POINTS | *, N, C | network input, ee frame: xyz, then a flag that is 1 for gripper points |
| NUM_POINTS | *, 1 int64 | rows of POINTS that were observed, not filled in; 1, a guess, once all have gone |
| TABLE_PLANE | *, 4 | the table in the ee frame: upward unit normal, then the hand's height (m) |
| WRIST_ANGLE | *, 1 | angle of the arm's last joint (rad) |
| IMAGE | *, C, S, S | network input of image policies: colours in [0, 1], depth in metres, mask 0 or 1 |
| ACTION | *, 6 | relative ee pose: translation, intrinsic XYZ Euler angles; *, 7 in joint spaces |
| BASE_ACTION | *, A | what the base policy of a `ResidualActor` does |
| TRIED_ACTION | *, M, A | further actions that a policy proposes (`NearbyActions`) |
| TRIED_REWARD | *, M, 1 | in "next", what each of them would have brought as the last; NaN: not tried |
| EXPERT_ACTION, HAS_EXPERT | *, 6 and *, 1 bool | label of imitation, and whether there is one |
| GOAL, HAS_GOAL | *, 7 and *, 1 bool | final grasp in the ee frame at t (xyz, quaternion xyzw) |
| PLAN_STATUS | *, 1 int64 | whether there is a plan, or why not: `PlanStatus` by number; -1: no planner |
| TURN | *, 1 int64 | which policy of a `Relay` acted: 0 the first, 1 the second |
| PERTURBED | *, 1 bool | a disturbance, not the policy, moved the arm at this step |
| SOURCE | *, 1 int64 | number of the replay buffer's source that a row belongs to |
| EPISODE_SUCCESS | *, 1 bool | the episode's final reward, on each of its steps |
| GOAL_PREDICTION | *, 7 | written by actor or critic |
| GRASP_PREDICTION | *, 7 | of each network by name, which only watches (`GraspPredictions`) |
| FEATURES | *, F | below it by network: what a frozen encoder makes of a state (`KeepFeatures`) |
| STATE_ACTION_VALUE | *, Q | the critic's values side by side |
"""

from __future__ import annotations

from dataclasses import dataclass

DEPTH = ("camera", "depth")
MASK = ("camera", "mask")
RGB = ("camera", "rgb")
OVERHEAD_DEPTH = ("overhead", "depth")
OVERHEAD_MASK = ("overhead", "mask")
OVERHEAD_RGB = ("overhead", "rgb")
T_BASE_EE = "T_base_ee"
T_BASE_CAMERA = "T_base_camera"
T_BASE_OVERHEAD = "T_base_overhead"
T_BASE_OBJECT = "T_base_object"
OBJECT_ID = "object_id"
WORLD = "world"
EPISODE = "episode"
JOINTS = "joints"
JOINT_VELOCITIES = "joint_velocities"
TIME_LEFT = "time_left"
POINTS = "points"
NUM_POINTS = "num_points"
TABLE_PLANE = "table_plane"
WRIST_ANGLE = "wrist_angle"
IMAGE = "image"
ACTION = "action"
BASE_ACTION = "base_action"
TRIED_ACTION = "tried_action"
TRIED_REWARD = "tried_reward"
EXPERT_ACTION = "expert_action"
HAS_EXPERT = "has_expert"
GOAL = "goal"
HAS_GOAL = "has_goal"
PLAN_STATUS = "plan_status"
TURN = "turn"
PERTURBED = "perturbed"
SOURCE = "source"
EPISODE_SUCCESS = "episode_success"
GOAL_PREDICTION = "goal_prediction"
GRASP_PREDICTION = "grasp_prediction"
FEATURES = "features"
STATE_ACTION_VALUE = "state_action_value"


@dataclass(frozen=True)
class CameraKeys:
    """Where one camera's pictures and its pose in the base are found."""

    depth: tuple[str, str]
    mask: tuple[str, str]
    rgb: tuple[str, str]
    pose: str


WRIST = CameraKeys(DEPTH, MASK, RGB, T_BASE_CAMERA)
OVERHEAD = CameraKeys(OVERHEAD_DEPTH, OVERHEAD_MASK, OVERHEAD_RGB, T_BASE_OVERHEAD)
