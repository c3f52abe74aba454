"""From a configuration to the parts that it names: typed values, checks, builders, and the run of a recipe.

Beside the recipes the only place that sees a `cfg`; nothing here computes a loss or steps a world.
"""

from torchgrasp.config.conclusion import conclude as conclude
from torchgrasp.config.demonstration_folders import collect as collect
from torchgrasp.config.demonstration_folders import gather_sources as gather_sources
from torchgrasp.config.demonstration_folders import given_sources as given_sources
from torchgrasp.config.environments import LEARNED_FROM as LEARNED_FROM
from torchgrasp.config.environments import make_expert as make_expert
from torchgrasp.config.environments import make_pool as make_pool
from torchgrasp.config.environments import make_split_env as make_split_env
from torchgrasp.config.environments import observed_shapes as observed_shapes
from torchgrasp.config.environments import prepare_objects as prepare_objects
from torchgrasp.config.evaluation_config import evaluation_config as evaluation_config
from torchgrasp.config.exploration import DISTURBANCE as DISTURBANCE
from torchgrasp.config.exploration import check_exploration as check_exploration
from torchgrasp.config.exploration import make_demonstrator as make_demonstrator
from torchgrasp.config.fine_tuning import begun_with as begun_with
from torchgrasp.config.grasp_prediction import PREDICTED_FROM as PREDICTED_FROM
from torchgrasp.config.grasp_prediction import make_predictors as make_predictors
from torchgrasp.config.grasp_prediction import predict_grasps as predict_grasps
from torchgrasp.config.learners import find_successor as find_successor
from torchgrasp.config.learners import make_actor_critic as make_actor_critic
from torchgrasp.config.learners import make_first_learner as make_first_learner
from torchgrasp.config.learners import make_imitation_learner as make_imitation_learner
from torchgrasp.config.one_line_errors import one_line_errors as one_line_errors
from torchgrasp.config.overrides import plain as plain
from torchgrasp.config.parts import build as build
from torchgrasp.config.policies import make_policy as make_policy
from torchgrasp.config.recipe_main import recipe_main as recipe_main
from torchgrasp.config.report_page import describe_scenes as describe_scenes
from torchgrasp.config.report_page import write_page as write_page
from torchgrasp.config.run import Run as Run
from torchgrasp.config.run_files import open_run_dir as open_run_dir
from torchgrasp.config.run_files import training_config as training_config
from torchgrasp.config.schema import Comparison as Comparison
from torchgrasp.config.schema import Curves as Curves
from torchgrasp.config.schema import Pendulum as Pendulum
from torchgrasp.config.trained_policy import load_policy as load_policy
from torchgrasp.config.trained_policy import make_env as make_env
from torchgrasp.config.training_checks import check_training as check_training
from torchgrasp.config.transition_storage import make_experience as make_experience
from torchgrasp.config.transition_storage import make_row as make_row
from torchgrasp.config.value_checks import check_values as check_values
from torchgrasp.config.value_quality import watch_values as watch_values
