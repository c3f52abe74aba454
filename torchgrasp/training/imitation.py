"""A policy that learns by imitation: L_BC and L_AUX (Sec. 3.3)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, cast

import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor
from torch.optim import Optimizer

from torchgrasp.modules.mirrored_policy import Mirror
from torchgrasp.modules.policy import join_policy
from torchgrasp.objectives import GoalAuxLoss, PoseBCLoss
from torchgrasp.training.acceleration import Acceleration, get_optimizer_state, load_optimizer_state
from torchgrasp.training.loss_terms import MeanTerms


class ImitationLearner:
    """Networks, their losses and optimizers, and the updates of imitation.

    Args:
        networks: by name: `actor`, with `goal_network` beside it where the actor reads goals. Further ones
            are kept and saved, and not trained here.
        imitation: of the actor.
        optimizers: one for each network, under its name.
        grasp_prediction: of the goal network, where there is one (Table 5, Goal-Conditioned).
        acceleration: how updates are run; as they are by default. Its `make_adam` makes optimizers for it.
        mirror: for a policy that acts by the mean over reflections, see `MirroredPolicy`.

    Attributes:
        policy: what acts alone, and is evaluated.

    Example:
        >>> from torchgrasp.modules import GraspActor, PointNet
        >>> from tensordict import TensorDict
        >>> actor = GraspActor(PointNet)
        >>> adam = torch.optim.Adam(actor.parameters(), lr=1e-3)
        >>> loss, adams = PoseBCLoss(actor), {"actor": adam}
        >>> learner = ImitationLearner({"actor": actor}, imitation=loss, optimizers=adams)
        >>> labels = {"expert_action": torch.zeros(2, 6), "has_expert": torch.ones(2, 1, dtype=torch.bool)}
        >>> state = {"points": torch.rand(2, 64, 4), "time_left": torch.ones(2, 1)}
        >>> learner.imitate(TensorDict({**state, **labels}, [2]))
        >>> list(learner.fetch_terms())
        ['actor/loss_bc']
    """

    def __init__(
        self,
        networks: Mapping[str, TensorDictModuleBase],
        *,
        imitation: PoseBCLoss,
        optimizers: Mapping[str, Optimizer],
        grasp_prediction: GoalAuxLoss | None = None,
        acceleration: Acceleration | None = None,
        mirror: Mirror | None = None,
    ) -> None:
        self.networks, self.optimizers = dict(networks), dict(optimizers)
        self.imitation, self.grasp_prediction = imitation, grasp_prediction
        self.acceleration = acceleration or Acceleration()
        self.policy = join_policy(self.networks, mirror)
        self._terms = MeanTerms()
        self._wrap_updates()

    def _wrap_updates(self) -> None:
        """Run the updates as `acceleration` says, on the tensors that are there now."""
        self._imitation_update = self.acceleration.wrap(self._imitate)

    @property
    def actor(self) -> TensorDictModuleBase:
        """The actor alone; a goal that it reads has to be there."""
        return self.networks["actor"]

    def set_rate(self, rate: float) -> None:
        """Give every optimizer this learning rate."""
        for optimizer in self.optimizers.values():
            for group in optimizer.param_groups:
                if isinstance(group["lr"], Tensor):
                    group["lr"].fill_(rate)
                else:
                    group["lr"] = rate

    def imitate(self, batch: TensorDictBase) -> None:
        """One update of L_BC and L_AUX on a batch (B), and one of the goal network where there is one."""
        self._note(self._imitation_update(batch))

    def _imitate(self, batch: TensorDictBase) -> TensorDictBase:
        return TensorDict(
            {"actor": self._descend("actor", self.imitation(batch)), **self._predict_grasps(batch)}
        )

    def fetch_terms(self) -> dict[str, float]:
        """Means of all loss terms over the updates since the last call, by ``<network>/<term>``."""
        return self._terms.fetch()

    def state_dict(self) -> dict[str, Any]:
        """Networks, optimizers and the loss terms that are not fetched yet."""
        return {
            "terms": self._terms.state_dict(),
            "networks": {name: each.state_dict() for name, each in self.networks.items()},
            "optimizers": {name: get_optimizer_state(each) for name, each in self.optimizers.items()},
        }

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Take up what `state_dict` gave; KeyError, RuntimeError or ValueError where it is of others."""
        self._terms.load_state_dict(state["terms"])
        for name, network in self.networks.items():
            network.load_state_dict(state["networks"][name])
            load_optimizer_state(self.optimizers[name], state["optimizers"][name])
            _check_optimizer(self.optimizers[name])
        self._wrap_updates()

    def _predict_grasps(self, batch: TensorDictBase) -> dict[str, TensorDictBase]:
        """An update of grasp prediction alone, on the labels, and its terms; none without a goal network."""
        if self.grasp_prediction is None:
            return {}
        return {"goal_network": self._descend("goal_network", self.grasp_prediction(batch))}

    def _descend(self, name: str, terms: TensorDictBase) -> TensorDictBase:
        """One step of a network's optimizer down the sum of its losses; returns the terms."""
        optimizer = self.optimizers[name]
        optimizer.zero_grad(set_to_none=True)
        losses = [value for key, value in terms.items() if str(key).startswith("loss_")]
        torch.stack(losses).sum().backward()
        optimizer.step()
        return terms.detach()

    def _note(self, terms: TensorDictBase) -> None:
        """Keep the terms that an update gave, by network."""
        for name, each in terms.items():
            self._terms.add(str(name), cast(TensorDictBase, each))


def _check_optimizer(optimizer: Optimizer) -> None:
    """ValueError unless every parameter has the same moments, each as large as it, or a count of steps."""
    names: set[str] = set()
    for parameter, state in optimizer.state.items():
        if not isinstance(parameter, Tensor) or not isinstance(state, dict):
            raise ValueError("the optimizer has moments of no parameter")
        names = names or set(state)
        shapes = (parameter.shape, torch.Size([]))
        fit = all(isinstance(value, Tensor) and value.shape in shapes for value in state.values())
        if not fit or set(state) != names or not all(bool(each.isfinite().all()) for each in state.values()):
            raise ValueError(f"the optimizer has other moments than {sorted(map(str, names))}")
