"""What a run does around the updates of its recipe: draws, rates, logs, saves, goes on."""

import csv
import json
from contextlib import ExitStack

import pytest
import torch
from omegaconf import OmegaConf

from tests.configurations import change_run
from torchgrasp.config import Run, gather_sources, make_actor_critic, make_imitation_learner
from torchgrasp.errors import CheckpointError, StorageError, WorkerError
from torchgrasp.runs import load_checkpoint, seed_everything
from torchgrasp.training import ActorCriticLearner

ENTRIES = {"learner", "noise", "buffer", "random", "progress"}


@pytest.fixture
def begin(composed, demonstrations):
    """Begins a run of a smoke configuration on demonstrations that are there, or goes on with one."""
    begun = []

    def start(*overrides: str, resume=None) -> Run:
        cfg = composed("experiment=smoke", f"demonstrations.path={demonstrations}", *overrides)
        if resume is not None:
            stored = OmegaConf.load(resume / ".config_unresolved.yaml")
            cfg = OmegaConf.merge(stored, OmegaConf.from_dotlist([*overrides]), {"resume": str(resume)})
        seed_everything(cfg.seed)
        learner = make_imitation_learner(cfg) if cfg.recipe == "bc" else make_actor_critic(cfg)
        run = Run(cfg, learner).__enter__()
        with ExitStack() as opened:  # closed where it cannot begin
            opened.push(run)
            run.begin(gather_sources(cfg, run.pool, run.folder))
            begun.append(opened.pop_all())
        return run

    yield start
    for opened in begun:
        opened.close()


def read_metrics(run):
    with (run.folder / "metrics.csv").open() as stream:
        return list(csv.DictReader(stream))


def learn(run, stop_in=None):
    """What recipes/td3_bc.py does with batches; a run stopped in an iteration does not end it."""
    assert isinstance(run.learner, ActorCriticLearner)
    for iteration in run.iterations("updates"):
        for batch in run.batches():
            run.learner.update_critic(batch)
            if run.learner.actor_is_due:
                run.learner.update_actor(batch)
        if iteration == stop_in:
            return


def test_terms_are_logged_as_means_over_the_updates_since_the_last_row(begin):
    run = begin("pretrain.steps=52")
    values = []
    for batch in run.pretraining():
        with torch.no_grad():
            values.append(run.learner.imitation(batch)["loss_bc"].item())
        run.learner.imitate(batch)
    first, second = read_metrics(run)
    assert (first["step"], second["step"]) == ("50", "52")
    assert float(first["actor/loss_bc"]) == pytest.approx(sum(values[:50]) / 50, rel=1e-5)
    assert float(second["actor/loss_bc"]) == pytest.approx(sum(values[50:]) / 2, rel=1e-5)


def test_rates_rise_and_fall_in_imitation_and_step_down_in_the_main_phase(begin):
    given = ["pretrain.steps=20", "pretrain.learning_rate=1", "offline.updates=8", "online.updates=2"]
    run = begin(*given, "online.learning_rate=0.1", "online.milestones=[0.5]", "online.decay=0.5")
    adam = run.learner.optimizers["actor"]
    rates = [adam.param_groups[0]["lr"] for _ in run.pretraining()]
    assert rates[:2] == pytest.approx([0.5, 1.0])  # a tenth of the steps, then half a cosine
    assert rates[2:] == sorted(rates[2:], reverse=True) and rates[-1] < 0.05
    found = []
    for _ in run.iterations("updates"):
        found.append(adam.param_groups[0]["lr"])
        assert len(list(run.batches())) == 2 and run.episodes() == []
    assert found == pytest.approx([0.1, 0.1, 0.05, 0.05])
    assert run.gradient_steps == 20 + 8 and run.env_steps == 0


def test_the_last_iteration_of_an_offline_run_is_as_short_as_it_must_be(begin):
    run = begin("offline.updates=5", "online.updates=3", "pretrain.steps=0")
    run.experience.draw_all()
    assert [len(list(run.batches())) for _ in run.iterations("updates")] == [3, 2]
    assert run.experience.buffer.shares["online"] == 0.0


def test_the_actors_delay_counts_critic_updates_over_the_run_and_survives_a_resume(begin):
    """One critic update an iteration and a delay of 2: the actor learns in every second iteration."""
    given = ["offline.updates=6", "online.updates=1", "online.policy_delay=2", "pretrain.steps=0"]
    whole = begin(*given)
    learn(whole)
    updated = [bool(row["actor/loss_actor_ddpg"]) for row in read_metrics(whole)]
    assert updated == [False, True, False, True, False, True]

    first = begin(*given)
    learn(first, stop_in=1)  # the checkpoint before has a critic with one update
    first.__exit__(None, None, None)
    second = begin(resume=first.folder)
    assert (second.iteration, second.learner.critic_updates) == (1, 1)
    learn(second)
    assert [bool(row["actor/loss_actor_ddpg"]) for row in read_metrics(second)] == updated
    for name, network in whole.learner.networks.items():
        for key, value in network.state_dict().items():
            assert torch.equal(value, second.learner.networks[name].state_dict()[key])


def test_a_checkpoint_holds_all_of_a_run_and_the_next_takes_it_up(begin):
    run = begin("pretrain.steps=4", "checkpoint.steps=2")
    for batch in run.pretraining():
        run.learner.imitate(batch)
    run.note_successes([])
    run.results["random"] = {"success_rate": 0.25}
    run.checkpoint()
    run.__exit__(None, None, None)
    state = load_checkpoint(run.folder / "checkpoint")
    assert set(state) == ENTRIES
    assert json.loads((run.folder / "checkpoint" / "manifest.json").read_text())["format"] == 3
    again = begin(resume=run.folder)
    assert (again.pretrain_steps, again.gradient_steps, again.results) == (4, 4, run.results)
    assert list(again.pretraining()) == [] and again.wall_seconds > state["progress"]["wall_seconds"] > 0
    again.measure_once("random")  # it has it already: nobody is run
    assert torch.equal(again.experience.sample()["points"], run.experience.sample()["points"])


def test_a_checkpoint_of_another_configuration_is_refused(begin):
    run = begin("pretrain.steps=0")
    run.checkpoint()
    run.__exit__(None, None, None)
    change_run(run.folder, **{"model.encoder.width": 0.5})
    with pytest.raises(
        CheckpointError,
        match=r"is of another configuration, or damaged \(.*\): resume the run as it was begun",
    ):
        begin(resume=run.folder)


def test_episodes_of_actors_come_in_turn_and_are_counted(begin):
    run = begin("total_env_steps=48", "pretrain.steps=0")
    acted = []

    class Actor(torch.nn.Module):
        def __init__(self, name):
            super().__init__()
            self.name = name

        def forward(self, td):
            acted.append(self.name)
            return td.set("action", torch.zeros(*td.shape, 6))

        def __deepcopy__(self, memo):
            return self

    run.act(Actor("first"), Actor("second"))
    for iteration in run.iterations("episodes"):
        del acted[:]
        episodes = run.episodes()
        run.note_successes(episodes)
        assert len(episodes) == 2 and set(acted) == {("first", "second")[iteration % 2]}
    assert 48 <= run.env_steps < 48 + 12 and 0.0 <= run.success_rate <= 1.0
    assert [int(row["env_steps"]) for row in read_metrics(run)][-1] == run.env_steps


def test_a_resumed_run_goes_on_with_what_was_given_beside_resume(begin):
    """Without its being given once more, and only where the checkpoint was taken up."""
    run = begin("offline.updates=4", "online.updates=2", "pretrain.steps=0")
    learn(run, stop_in=0)
    run.checkpoint()
    run.__exit__(None, None, None)
    with pytest.raises(CheckpointError, match="another configuration"):
        begin("model.encoder.width=0.5", resume=run.folder)
    again = begin("offline.updates=8", resume=run.folder)
    again.__exit__(None, None, None)
    for file in ("config.yaml", ".config_unresolved.yaml"):
        stored = OmegaConf.load(run.folder / file)
        assert (stored.offline.updates, stored.model.encoder.width, stored.resume) == (8, 0.25, None)
    last = begin(resume=run.folder)
    learn(last)
    assert last.gradient_steps == 8


def test_a_resumed_run_with_shorter_rounds_has_no_episode_twice(begin):
    class Still(torch.nn.Module):
        def forward(self, td):
            return td.set("action", torch.zeros(*td.shape, 6))

    run = begin("total_env_steps=96", "pretrain.steps=0", "collector.episodes=6")
    run.act(Still())
    numbers = []
    for iteration in run.iterations("episodes"):
        numbers += [episode.number for episode in run.episodes()]
        if iteration == 1:
            break
    run.checkpoint()
    run.__exit__(None, None, None)
    again = begin("collector.episodes=2", resume=run.folder)
    again.act(Still())
    for _ in again.iterations("episodes"):
        numbers += [episode.number for episode in again.episodes()]
    assert sorted(numbers) == sorted(2 * [*range(1_000_000, again.next_episode)])  # of two worlds


@pytest.mark.parametrize(
    ("given", "same"),
    [
        ("evaluation.episodes=3", False),
        ("evaluation.seed=5", False),
        ("env.physics.friction=0.5", False),
        ("env.num_envs=1", True),
        ("objects.num_objects=3", True),  # the evaluation has a number of its own
    ],
)
def test_what_was_measured_on_other_scenes_is_left_out(begin, capsys, given, same):
    run = begin("pretrain.steps=0", "evaluation.episodes=2")
    run.measure_once("policy before")
    run.__exit__(None, None, None)
    again = begin(given, resume=run.folder)
    assert list(again.find_comparable()) == ["policy before"] * same
    assert ("policy before was measured on other scenes" in capsys.readouterr().out) is not same
    assert all({"outcomes", "success_rate"} <= set(table) for table in again.find_comparable().values())


def test_metrics_alone_are_logged_by_default(begin):
    run = begin("pretrain.steps=0")
    names = {path.name for path in run.folder.iterdir()}
    assert names == {"config.yaml", ".config_unresolved.yaml", "metrics.csv"}


def test_a_finished_run_that_is_resumed_is_not_saved_again(begin):
    run = begin("offline.updates=2", "online.updates=2", "pretrain.steps=0", "checkpoint.iterations=100")
    learn(run)
    run.__exit__(None, None, None)
    files = [run.folder / "weights.safetensors", run.folder / "checkpoint" / "manifest.json"]
    before = [file.stat().st_mtime_ns for file in files]
    again = begin(resume=run.folder)
    learn(again)
    assert [file.stat().st_mtime_ns for file in files] == before


def test_workers_that_die_and_a_full_disk_say_how_the_run_goes_on(begin):
    run = begin("pretrain.steps=0")
    for error in (WorkerError("3 workers died"), StorageError("no room")):
        run.__exit__(type(error), error, None)
        assert error.__notes__ == [f"The run goes on with resume={run.folder}"]
