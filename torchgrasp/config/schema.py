"""The values of every recipe's configuration, typed; parts with a `_target_` are those of `part_kinds`."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, StringConstraints

from torchgrasp.config.value_types import (
    Count,
    Device,
    Factor,
    FilePath,
    Horizon,
    NotNegative,
    Packages,
    Points,
    Positive,
    Rows,
    Seed,
    Seeds,
    Share,
    Shares,
    Switch,
    SwitchOrAuto,
    Updates,
    Workers,
    Worlds,
    at_least,
    between,
)

Parts = dict[str, Any]  # with a `_target_`, or parts by name: `check_parts` looks at them


class Section(BaseModel):
    """A section, all of whose keys are named."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class OpenSection(BaseModel):
    """A section to which a configuration of one's own may add keys, or whose class knows the others."""

    model_config = ConfigDict(extra="allow", frozen=True)


class Env(OpenSection):
    """conf/env."""

    num_envs: Worlds = 1
    horizon: Horizon = 30


class Demonstrations(Section):
    """A source of demonstrations: D_expert, or one of `demonstrations.more` with all of its options."""

    kind: str
    steps: Positive
    count: str | None = None
    path: FilePath | None = None
    policy: FilePath | None = None
    labels: Switch = True
    expert_start: Switch = False
    weight: NotNegative | None = None
    more: Any = None


class Pretrain(Section):
    """Imitation before the main phase."""

    steps: Count
    batch_size: Rows
    aux_weight: NotNegative
    critic: Switch
    learning_rate: NotNegative


class Online(Section):
    """The main phase."""

    updates: Positive
    policy_delay: Positive
    critic_warmup: Count
    learning_rate: NotNegative
    milestones: Shares
    decay: Factor
    gamma: Share
    tau: Share
    period: Positive
    dagger: Switch = True
    self_imitation: Switch = False
    rollouts: Any = None


class Offline(Section):
    """Updates on demonstrations alone."""

    updates: Updates


class Replay(OpenSection):
    """conf/replay."""

    batch_size: Rows
    online_fraction: Share
    online_capacity: Positive
    folder: FilePath | None = None
    keep_features: Any = None
    feature_dtype: Literal["float16", "bfloat16", "float32"] = "float16"


class Collector(OpenSection):
    """conf/collector and conf/exploration."""

    num_workers: Workers
    episodes: Positive = 14
    overlap: Switch = False
    pool: Parts


class Evaluation(Section):
    """The scenes that a policy is scored on."""

    num_envs: Worlds
    num_objects: Positive | None
    split: str | None = None
    seed: Seed = 0
    episodes: Positive = 1
    baselines: list[Literal["expert", "random"]] = []
    target_motion: Any = None
    grasp_prediction: Switch = False


class Checkpoint(Section):
    """How often a run is saved."""

    iterations: Positive
    steps: Positive


class Network(OpenSection):
    """Actor, critic or goal network; those without a switch leave it at false."""

    goal_input: Switch = False
    goal_prediction: Switch = False
    freeze_encoder: Switch = False


class Residual(Section):
    """Of a ResidualPolicy."""

    scale: Annotated[float, between(0.0, 1.0)] = 0.2
    hidden: Annotated[int, at_least(1, 100_000)] = 256
    last_steps: Positive | None = None
    horizon: Horizon | None = None


class Model(OpenSection):
    """conf/model."""

    table_input: Switch = False
    mirrored: Switch = False
    residual: Residual | None = None
    actor: Network
    critic: Network
    goal_network: Network | None = None


class Video(Section):
    """Films of an evaluation."""

    episodes: Count
    fps: Annotated[float, between(1, 1000)]


class Logger(OpenSection):
    """conf/logger; the others are arguments of the service."""

    kind: str


class Training(Section):
    """td3_bc.py, bc.py, hindsight.py and collect.py."""

    recipe: str
    seed: Seed
    num_points: Points
    device: Device
    compile: Literal["default", "reduce-overhead"] | None = None
    cudagraphs: SwitchOrAuto = "auto"
    resume: FilePath | None
    init: FilePath | None
    output_dir: FilePath
    trust: Packages
    total_env_steps: Count
    env: Env
    engine: Parts | None = None
    objects: Parts
    camera: Parts
    overhead: Parts | None
    transforms: Parts
    expert: Parts
    offline: Offline
    demonstrations: Demonstrations
    pretrain: Pretrain
    online: Online
    replay: Replay
    collector: Collector
    evaluation: Evaluation
    checkpoint: Checkpoint
    model: Model
    loss: Parts
    logger: Logger


class Resumption(OpenSection):
    """What must be right before the configuration of the run to be resumed is read."""

    resume: FilePath
    trust: Packages


class RelaySteps(Section):
    """Of policy=combined and policy=takeover."""

    steps: Any


class Evaluate(Section):
    """evaluate.py; view.py adds its page."""

    policy: FilePath
    learner: FilePath | None
    combined: RelaySteps
    takeover: RelaySteps
    protocol: str
    episodes: Positive
    seed: Seed
    num_points: Points
    output_dir: FilePath
    trust: Packages
    env: Env
    engine: Parts | None = None
    objects: Parts
    camera: Parts
    overhead: Parts | None
    transforms: Parts
    expert: Parts
    planning: Parts
    collector: Collector
    evaluation: Evaluation
    grasp_prediction: Switch
    value_quality: Annotated[float, between(0.0, 1.0)] | None = None
    video: Video
    model: Any = None
    host: Annotated[str, StringConstraints(min_length=1)] | None = None
    port: Annotated[int, at_least(0, 65535)] = 0
    speed: Annotated[float, between(0.1, 10.0)] = 1.0
    robot: Literal["shapes", "meshes"] = "meshes"


class BroughtEnv(OpenSection):
    """The task of trained networks."""

    horizon: Horizon
    action_space: str = "ee_delta"


class BroughtModel(OpenSection):
    """Trained networks; imitation has no critic."""

    mirrored: Switch = False
    residual: Residual | None = None
    actor: Parts
    critic: Parts | None = None
    goal_network: Parts | None = None


class Brought(OpenSection):
    """What the configuration in a weights file must tell, so that its networks can be rebuilt and act."""

    env: BroughtEnv
    camera: Parts
    overhead: Parts | None = None
    transforms: Parts
    model: BroughtModel
    num_points: Points = 1024
    recipe: str | None = None
    replay: Parts | None = None
    demonstrations: Parts | None = None


class Comparison(Section):
    """compare.py."""

    runs: Any
    key: str | None
    title: str | None
    output_dir: FilePath


class Curves(Section):
    """curves.py."""

    runs: Any
    metric: str
    x: str
    output_dir: FilePath


class Pendulum(Section):
    """pendulum.py."""

    seeds: Seeds
    output_dir: FilePath
    num_envs: Worlds
    horizon: Horizon
    random_steps: Positive
    online_steps: Positive
    online_fraction: Share
    updates: Count
    policy_delay: Positive
    batch_size: Rows
    hidden: Annotated[int, at_least(1, 100_000)]
    learning_rate: NotNegative
    milestones: Shares
    decay: Factor
    gamma: Share
    tau: Share
    period: Positive
    exploration: NotNegative
    evaluation_episodes: Positive
    loss: Parts
