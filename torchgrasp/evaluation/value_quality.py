"""How well a critic's values tell success from failure on episodes that it has not learned from."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import rankdata
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase

from torchgrasp import keys
from torchgrasp.errors import ConfigError, check_range
from torchgrasp.rollouts import Episode

# Steps left whose rows are told.
_TOLD = (30, 25, 20, 15, 10, 7, 5, 3, 2, 1)
_BINS = 10


def area_under_curve(scores: NDArray, success: NDArray) -> float | None:
    """Probability that a success scores higher than a failure, of (N,) each; None without one of either.

    0.5 knows nothing. Ties count half (Mann-Whitney).

    >>> area_under_curve(np.array([0.9, 0.4, 0.6, 0.1]), np.array([True, True, False, False]))
    0.75
    """
    wins, count = np.asarray(success, bool), len(success)
    number = int(wins.sum())
    if number in (0, count):
        return None
    ranks = rankdata(scores)
    return float((ranks[wins].sum() - number * (number + 1) / 2) / (number * (count - number)))


class ValueTable:
    """Values along episodes beside their outcomes, by the steps that were left.

    Args:
        gamma: discount of the values; what they are compared with is the discounted success.

    Example:
        >>> table = ValueTable(gamma=1.0)
        >>> table.add(np.array([0.5, 0.9]), success=True)
        >>> table.add(np.array([0.6, 0.2]), success=False)
        >>> [(left, row["auc"]) for left, row in table.summary()["steps_left"].items()]
        [('2', 0.0), ('1', 1.0)]
    """

    def __init__(self, *, gamma: float = 0.95) -> None:
        check_range("gamma", gamma, 0.0, 1.0)
        self.gamma = gamma
        self._values: list[NDArray] = []
        self._success: list[bool] = []

    def add(self, values: NDArray, *, success: bool) -> None:
        """Count an episode: the value (T,) of each action that was taken, and how it ended."""
        numbers = np.asarray(values, np.float64)
        if not np.isfinite(numbers).all():
            raise ConfigError("The values have NaN or infinity among them: look at the critic's weights.")
        self._values.append(numbers)
        self._success.append(bool(success))

    def watch(self, episode: Episode) -> None:
        """Count an episode whose steps have STATE_ACTION_VALUE (T, Q), by the least value of each step."""
        values = episode.steps.get(keys.STATE_ACTION_VALUE, None)
        if values is None:
            raise ConfigError("The episode has no values: let a WatchingCritic follow the policy.")
        self.add(values.amin(dim=-1).numpy(), success=episode.success)

    def summary(self) -> dict[str, Any]:
        """Number of episodes, and by steps left (1 is the last action) the rows of `_describe`.

        Calibration tells, for values of all steps in ten bins, how many there are, their mean, and the mean
        discounted success of the episodes that they belong to.
        """
        success = np.array(self._success, bool)
        longest = max(map(len, self._values), default=0)
        rows = {}
        for left in (left for left in _TOLD if left <= longest):
            there = [number for number, values in enumerate(self._values) if len(values) >= left]
            values = np.array([self._values[number][-left] for number in there])
            rows[str(left)] = self._describe(values, success[there], left)
        told = {"episodes": len(success), "gamma": self.gamma}
        return {**told, "steps_left": rows, "calibration": self._bins()}

    def _describe(self, values: NDArray, success: NDArray, left: int) -> dict[str, float | None]:
        """Area under the curve, mean values by outcome, and the mean squared error.

        `error_of_rate` is the squared error of who knows the rate of success alone: a critic above it
        knows less than nothing.
        """
        expected = success * self.gamma ** (left - 1)
        return {
            "auc": area_under_curve(values, success),
            "value_of_successes": _mean(values[success]),
            "value_of_failures": _mean(values[~success]),
            "error": float(np.square(values - expected).mean()),
            "error_of_rate": float(expected.var()),
        }

    def _bins(self) -> list[dict[str, float]]:
        if not self._values:
            return []
        pairs = zip(self._values, self._success, strict=True)
        expected = [won * self.gamma ** np.arange(len(each) - 1, -1, -1.0) for each, won in pairs]
        values, expected = np.concatenate(self._values), np.concatenate(expected)
        place = np.clip((values * _BINS).astype(int), 0, _BINS - 1)
        return [
            {
                "from": each / _BINS,
                "steps": int((place == each).sum()),
                "value": float(values[place == each].mean()),
                "success": float(expected[place == each].mean()),
            }
            for each in np.unique(place).tolist()
        ]


def _mean(values: NDArray) -> float | None:
    return float(values.mean()) if len(values) else None


class WatchingCritic(TensorDictModuleBase):
    """Lets a policy act while a critic only says what it thinks of it: STATE_ACTION_VALUE (*, Q).

    Args:
        policy: writes ACTION.
        critic: reads the state and ACTION.
    """

    def __init__(self, policy: TensorDictModuleBase, critic: TensorDictModuleBase) -> None:
        super().__init__()
        self.policy, self.critic = policy, critic
        state = [key for key in critic.in_keys if key not in policy.out_keys]
        self.in_keys = list(dict.fromkeys([*policy.in_keys, *state]))  # pyright: ignore
        self.out_keys = [*policy.out_keys, keys.STATE_ACTION_VALUE]  # pyright: ignore

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write what the policy writes, and the values of its action."""
        tensordict = self.policy(tensordict)
        seen = self.critic(tensordict.select(*self.critic.in_keys))
        return tensordict.set(keys.STATE_ACTION_VALUE, seen.get(keys.STATE_ACTION_VALUE))
