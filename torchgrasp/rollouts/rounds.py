"""Rounds of episodes for a training loop: one after another, or one ahead of learning."""

from __future__ import annotations

from collections.abc import Callable, Generator
from itertools import count

from torchgrasp.rollouts.episode_pool import Episode, EpisodeBatches, EpisodePool, Policy


def collect_rounds(
    pool: EpisodePool,
    env: str,
    make_policy: Callable[[int], Policy],
    *,
    first: int,
    length: int,
    overlap: bool = False,
) -> Generator[list[Episode], None, None]:
    """Exploring episodes, a round at a time, for ever; close it when done.

    Without `overlap` a round is collected when it is asked for, by the policy of that moment. With it
    the next round begins when one is handed over, so that workers collect while the caller learns: by the
    policy that has not learned from the round handed over, one round stale (the first two share theirs).
    Which policy runs which episode follows from the number of the round, not from who is faster: the same
    seed gives the same run whatever the workers.

    Args:
        pool: who runs them.
        env: name of the pool's environment.
        make_policy: gives a copy of the policy as it is now, which learning leaves alone, for the round whose
            first episode has that number.
        first: number of the first round's first episode.
        length: episode numbers a round; each is run in every world.
        overlap: whether to collect the next round meanwhile.
    """

    def begin(number: int) -> EpisodeBatches:
        return pool.run(env, make_policy(number), range(number, number + length), explore=True)

    ahead: EpisodeBatches | None = None
    try:
        for number in count(first, length):
            batches = begin(number) if ahead is None else ahead
            episodes = [episode for batch in batches for episode in batch]
            ahead = begin(number + length) if overlap else None
            yield episodes
    finally:
        if ahead is not None:
            ahead.close()
